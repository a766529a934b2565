"""Simulated auxiliary inputs: their true values follow the pressures and the weight on the end cap."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from model.units import G_PER_KG, PA_PER_BAR
from rig.config.input_sections import SimulatedInput
from rig.config.schema import RigConfig

SEED_STREAM = 7
"""Keeps the noise of these inputs apart from that of the pressure sensors, which have the same seed."""


class SimulatedInputs:
    """Voltages of the auxiliary inputs of a rig (I,), renewed at each step of the arm.

    Noise is drawn for every grid step of an arm's step at once, so it does not depend on how time is cut.
    """

    def __init__(self, config: RigConfig, seed: int, steps: int) -> None:
        """`steps`: grid steps of one step of the arm."""
        assert config.simulator is not None
        self._inputs = tuple(config.inputs.values())
        truth = config.simulator.inputs
        self._truth = tuple(
            truth.get(name) or SimulatedInput(rest=(one.span[0] + one.span[1]) / 2)
            for name, one in config.inputs.items()
        )
        self._steps = steps
        self._noise = np.random.default_rng([seed, SEED_STREAM])
        self._volts = np.zeros((steps, len(self._inputs)))

    def advance(self, pressure_pa: NDArray[np.float64], weight_kg: float) -> None:
        """Renew the voltages for the next step of the arm: gauge pressures (N,), weight on the cap."""
        if not self._inputs:
            return
        mean_bar = float(pressure_pa.mean()) / PA_PER_BAR
        noise = self._noise.standard_normal((self._steps, len(self._inputs)))
        for i, (one, truth) in enumerate(zip(self._inputs, self._truth, strict=True)):
            value = truth.rest + truth.per_bar * mean_bar + truth.per_g * weight_kg * G_PER_KG
            self._volts[:, i] = one.volts(value + truth.noise * noise[:, i])

    def volts(self, steps: NDArray[np.int64], inputs: list[int]) -> NDArray[np.float64]:
        """Voltages (n, ..) of some inputs at grid steps (n,) of the present step of the arm."""
        return self._volts[(steps % self._steps)[:, None], inputs]
