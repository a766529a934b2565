"""The tip in motion: the static tip passed through the arm's first mode.

tip + tau d(tip)/dt + d2(tip)/dt2 / omega^2 = static tip(pressures)
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import expm
from scipy.optimize import least_squares

import model
from model.dynamics import Dynamics

Array = NDArray[np.float64]

_STEP_S = 0.005
_SPAN_S = 0.6
_SHARE = 0.35
_KICK = 0.02


@dataclass(frozen=True, eq=False)
class TipDynamics:
    """First mode: angular frequency `omega_rad_s`, retardation time `tau_s` (damping ratio omega tau / 2)."""

    omega_rad_s: float
    tau_s: float
    _steps: dict[int, tuple[Array, Array, Array]] = field(default_factory=dict, repr=False)

    @classmethod
    def of(cls, arm: model.Arm, limit_pa: float) -> TipDynamics:
        """Fitted to the step response of the rod model at a bent pose."""
        pressure = np.full(arm.geometry.actuators, 0.1 * limit_pa)
        pressure[0] = _SHARE * limit_pa
        dynamics = Dynamics(arm, _STEP_S)
        before = dynamics.start(pressure).tip_m
        after = pressure.copy()
        after[0] += _KICK * limit_pa
        steps = round(_SPAN_S / _STEP_S)
        tips = dynamics.run(np.tile(after, (steps, 1))).tip_m
        static = Dynamics(arm, _STEP_S).start(after).tip_m
        way = static - before
        response = (tips - before) @ way / (way @ way)
        # The pressure rises linearly within the first time step.
        times = _STEP_S * (np.arange(steps) + 0.5)

        def gaps(x: Array) -> Array:
            decay, turn = 0.5 * x[0] ** 2 * x[1], x[0] * np.sqrt(max(1 - (0.5 * x[0] * x[1]) ** 2, 1e-6))
            wave = np.exp(-decay * times) * (np.cos(turn * times) + decay / turn * np.sin(turn * times))
            gap: Array = response - (1 - wave)
            return gap

        found = least_squares(gaps, np.array([41.0, max(arm.material.damping_s, 1e-3)]), bounds=([1, 0], [1e3, 0.1]))
        return cls(float(found.x[0]), float(found.x[1]))

    def matrices(self, step_s: float) -> tuple[Array, Array, Array]:
        """A (2, 2), b0, b1 (2,): state (tip, velocity) after a step on which the drive goes linearly from u0 to u1."""
        key = round(step_s * 1e7)
        if key not in self._steps:
            square = self.omega_rad_s**2
            system = np.zeros((4, 4))
            system[0, 1] = 1.0
            system[1] = -square, -square * self.tau_s, square, 0.0
            system[2, 3] = 1.0 / step_s
            step = expm(system * step_s)
            self._steps[key] = step[:2, :2], step[:2, 2] - step[:2, 3], step[:2, 3]
        return self._steps[key]

    def advance(self, state: Array, drive: Array, step_s: float) -> Array:
        """States (K + 1, 2, 3) from the state (2, 3) on, for drives (K + 1, 3) [m] that are linear in between."""
        transition, first, last = self.matrices(step_s)
        states = np.empty((len(drive), 2, 3))
        states[0] = state
        for k in range(len(drive) - 1):
            states[k + 1] = transition @ states[k] + np.outer(first, drive[k]) + np.outer(last, drive[k + 1])
        return states

    def responses(self, count: int, step_s: float, lag_s: float) -> Array:
        """Outputs tip - lag * velocity per drive (K + 1, K + 1): row k after k steps, column j the drive at time j."""
        transition, first, last = self.matrices(step_s)
        out = np.zeros((count + 1, count + 1))
        state = np.zeros((2, count + 1))
        for k in range(count):
            state = transition @ state
            state[:, k] += first
            state[:, k + 1] += last
            out[k + 1] = state[0] - lag_s * state[1]
        return out
