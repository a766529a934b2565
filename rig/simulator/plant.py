"""The plant: air and arm on one clock, and the cards and the tip that can be seen of it."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from model import NotConverged
from model.dynamics import Dynamics
from model.shape import Shape
from model.units import G_PER_KG, PA_PER_BAR
from rig.config.arm_model import TipLoad, chamber_areas_m2, true_arm, true_segments
from rig.config.drivers import Reality
from rig.config.input_sections import SimulatedInput
from rig.config.schema import RigConfig
from rig.hardware.cards.base import CardError, Scans
from rig.simulator import pneumatics
from rig.simulator.faults import Faults
from rig.simulator.faulty_devices import FaultySensors, FaultyValves
from rig.simulator.pneumatics import STEP_NS
from rig.simulator.registers import quantised_output
from rig.simulator.tip_pose import TipPose, pose_among, pose_dtype
from rig.valves.iso6358 import ATMOSPHERE_PA

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


ARM_STEPS = 50
"""Grid steps of the air per step of the arm: 5 ms."""

ARM_STEP_S = ARM_STEPS * STEP_NS * 1e-9

REMEMBERED_POSES = 256
FIFO_SCANS = 4096


class Plant:
    """A simulated bench from the moment its cards' driver is attached: outputs at 0 V, chambers vented.

    The same seed and the same writes at the same times give the same scans and poses, bit for bit, however the time
    is cut into calls of `advance`.
    """

    def __init__(self, config: RigConfig, seed: int, t0_ns: int, *, moving_arm: bool = True) -> None:
        """`moving_arm` false leaves the arm straight and its chambers at their volume: pneumatics alone.

        Raises:
            CardError: the rig has no simulator section, or its arm has no equilibrium without pressure.
        """
        config = config.as_built
        if config.simulator is None:
            raise CardError(f"rig {config.name} has mock devices but no simulator section")
        self._config, self._t0_ns, self._step = config, t0_ns, 0
        truth = config.simulator
        segments = true_segments(config)
        self._bore_m2 = chamber_areas_m2(segments)
        self._dead_m3 = truth.chamber.dead_volume_ml * 1e-6
        self._dynamics = Dynamics(true_arm(config), ARM_STEP_S) if moving_arm else None
        self._effects = [effect.effect(config.actuators, ARM_STEP_S) for effect in truth.arm_effects]
        lengths = np.repeat(
            [segment.geometry.length_mm * 1e-3 for segment in segments],
            [len(segment.geometry.actuator_angles_deg) for segment in segments],
        )
        position, rotation = np.array([0.0, 0.0, config.arm.length_mm * 1e-3]), np.eye(3)
        self.inputs = SimulatedInputs(config, seed, ARM_STEPS)
        self._weight_kg = 0.0
        self._hook = TipLoad(config)
        self._loads = self._hook.carrying(0.0)
        shape: Shape | None = None
        if self._dynamics is not None:
            try:
                shape = self._dynamics.start(np.zeros(config.actuators))
            except NotConverged as error:
                raise CardError(
                    f"rig {config.name}: the simulated arm cannot carry its own weight and cap ({error})",
                    "look at material, geometry and cap_mass_g of its simulator section",
                ) from error
            lengths, self._points = shape.actuator_lengths_m, shape.actuator_points
        self._section_s_m = np.array([section.at_mm * 1e-3 for section in config.sections.values()])
        self._poses = np.zeros(2 * REMEMBERED_POSES, pose_dtype(len(self._section_s_m)))
        self._kept = 0
        if shape is None:
            count = len(self._section_s_m)
            upright = np.column_stack([np.zeros((count, 2)), self._section_s_m])
            self._remember(0, position, rotation, upright, np.repeat(np.eye(3)[None], count, axis=0))
        else:
            self._remember_shape(0, shape)
        self._valves = pneumatics.valves(config, truth.valve)
        self._chambers = pneumatics.chambers(config, truth)
        self._sensors = pneumatics.sensors(config, truth, seed)
        self.faults = Faults()
        self._faulty_valves = FaultyValves(self.faults, self._valves)
        self._faulty_sensors = FaultySensors(self.faults, self._sensors)
        self._outputs_v: NDArray[np.float64] = np.zeros(len(config.valves))
        self._air = pneumatics.vented(len(config.valves), self._dead_m3 + self._bore_m2 * lengths)
        self.inputs.advance(self.pressure_pa, self._weight_kg)
        self._cards = {
            name: PlantCard(self, config, name)
            for name, card in config.cards.items()
            if card.reality is Reality.SIMULATED
        }

    @property
    def t_ns(self) -> int:
        """The time the plant has reached: the last point of its grid."""
        return self._t0_ns + self._step * STEP_NS

    @property
    def pressure_pa(self) -> NDArray[np.float64]:
        """True gauge pressure (N,) now."""
        return self._air.pressure_pa - ATMOSPHERE_PA

    @property
    def volume_m3(self) -> NDArray[np.float64]:
        """True volume (N,) of the chambers with their tubes now."""
        return self._air.volume_m3.copy()

    def card(self, name: str) -> PlantCard:
        """One of the rig's mock cards. Raises CardError: the rig's card of that name is not a mock."""
        if name not in self._cards:
            raise CardError(f"card {name} of rig {self._config.name} is not simulated")
        return self._cards[name]

    def pose_at(self, t_ns: int) -> TipPose:
        first = max(0, self._kept - REMEMBERED_POSES)
        return pose_among(self._poses[first : self._kept], t_ns)

    def poses_since(self, index: int) -> NDArray[np.void]:
        """Remembered poses (n,) of `pose_dtype` whose index is at least this."""
        kept = self._poses[max(0, self._kept - REMEMBERED_POSES) : self._kept]
        return kept[kept["index"] >= index]

    def advance(self, t_ns: int) -> None:
        """Let time pass until `t_ns`; a time that has passed already changes nothing."""
        target = (t_ns - self._t0_ns) // STEP_NS
        while self._step < target:
            due = (self._step // ARM_STEPS + 1) * ARM_STEPS
            self._pass(min(due, target) - self._step)
            if self._step == due:
                self._move_arm()
                self.inputs.advance(self.pressure_pa, self._weight_kg)

    def skip(self, t_ns: int) -> None:
        """Advance the clock to about `t_ns` without simulation: whole steps of the arm, no scans."""
        first = self._step // ARM_STEPS + 1
        self._step += max(0, (t_ns - self.t_ns) // (ARM_STEPS * STEP_NS)) * ARM_STEPS
        standing = self._poses[self._kept - 1].copy()
        last = self._step // ARM_STEPS
        for index in range(max(first, last - REMEMBERED_POSES + 1), last + 1):
            self._remember(index, *list(standing)[2:])

    def set_tip_weight(self, weight_kg: float) -> None:
        """Replace the weight on the end cap."""
        self._weight_kg = weight_kg
        self._loads = self._hook.carrying(weight_kg)

    def set_output(self, valve: int, volts: float) -> None:
        """Put a valve's output at a voltage, from the present grid point on."""
        self._outputs_v[valve] = volts

    def output(self, valve: int) -> float:
        """The voltage of a valve's output."""
        return float(self._outputs_v[valve])

    def _pass(self, steps: int) -> None:
        scans = np.empty((steps, len(self._air.pressure_pa)))
        self._air.command_v[:] = self._faulty_valves.apply(self._outputs_v, self._air.spool_v)
        pneumatics.advance(self._valves, self._chambers, self._sensors, self._air, self._step, steps, scans)
        self._faulty_sensors.apply(self._step, scans)
        for card in self._cards.values():
            card.take(self._step, scans)
        self._step += steps

    def _move_arm(self) -> None:
        if self._dynamics is None:
            return
        shape = self._dynamics.step(self._effective_pa(), self._loads)
        # The chambers follow within the next step: the arm lags the air by one step, and the volume has no jumps.
        pneumatics.follow(
            shape.s_m, shape.v, shape.u, shape.actuator_xy_m, self._points, self._bore_m2, self._dead_m3, ARM_STEP_S,
            self._air,
        )  # fmt: skip
        self._remember_shape(self._step // ARM_STEPS, shape)

    def _effective_pa(self) -> NDArray[np.float64]:
        """Pressures (N,) that give an arm without effects the push which the arm has now."""
        pressure_pa = self.pressure_pa
        if not self._effects:
            return pressure_pa
        pressure_bar = [pressure / PA_PER_BAR for pressure in pressure_pa.tolist()]
        for effect in self._effects:
            pressure_bar = effect(pressure_bar)
        return np.array(pressure_bar) * PA_PER_BAR

    def _remember_shape(self, index: int, shape: Shape) -> None:
        sections = shape.frames_at(self._section_s_m) if len(self._section_s_m) else ()
        self._remember(index, shape.tip_m, shape.tip_rotation, *sections)

    def _remember(self, index: int, *pose: NDArray[np.float64]) -> None:
        """Keep positions and rotations of the tip and, if the rig has any, of the sections."""
        if self._kept == len(self._poses):
            self._poses[:REMEMBERED_POSES] = self._poses[REMEMBERED_POSES:].copy()
            self._kept = REMEMBERED_POSES
        fields = pose if len(self._section_s_m) else pose[:2]
        self._poses[self._kept] = (index, self._t0_ns + index * ARM_STEPS * STEP_NS, *fields)
        self._kept += 1


class PlantCard:
    """A mock card inside the plant's own process, in virtual time.

    Columns are in the order of `rig.hardware.cards.base.card_setup`.
    """

    def __init__(self, plant: Plant, config: RigConfig, name: str) -> None:
        self._plant = plant
        sensors = [s for s in config.sensors_by_actuator if s.card == name]
        columns = [s.actuator - 1 for s in sensors]
        together = bool(columns) and columns == list(range(columns[0], columns[-1] + 1))
        self._columns = slice(columns[0], columns[-1] + 1) if together else np.array(columns, np.int64)
        self._valves = [i for i, v in enumerate(config.valves) if v.card == name]
        self._ranges = [config.valves[i].output_range for i in self._valves]
        self._device = config.cards[name].device
        self.faults = plant.faults
        """Faults of this card; replaced where another object applies them."""
        self._every = pneumatics.scan_steps(config.cards[name].sampling_hz)
        self._sampling = False
        self._t_ns = np.zeros(FIFO_SCANS, np.int64)
        self._sensors = len(sensors)
        self._auxiliary = [i for i, one in enumerate(config.inputs.values()) if one.card == name]
        self._stops = [stop.channel for stop in config.emergency_stops.values() if stop.card == name]
        self._signals = np.zeros((FIFO_SCANS, len(sensors) + len(self._auxiliary)))
        self.digital_high = False
        """Whether the digital outputs are high."""
        self._rises = self._rise_ns = 0
        self._filled = self._lost = 0

    @property
    def period_ns(self) -> int:
        return self._every * STEP_NS

    def start(self) -> None:
        self._sampling, self._filled, self._lost = True, 0, 0

    def take(self, first_step: int, scans: NDArray[np.float64]) -> None:
        """Put the scans of a stretch of the grid into the card's buffer; what does not fit is lost."""
        if not self._sampling:
            return
        first = -(first_step + 1) % self._every
        count = len(range(first, len(scans), self._every))
        fit = min(count, FIFO_SCANS - self._filled)
        if fit:
            new = slice(self._filled, self._filled + fit)
            oldest_ns = self._plant.t_ns + (first + 1) * STEP_NS
            self._t_ns[new] = range(oldest_ns, oldest_ns + fit * self.period_ns, self.period_ns)
            rows = slice(first, first + fit * self._every, self._every)
            self._signals[new, : self._sensors] = scans[rows, self._columns]
            if self._auxiliary:
                steps = np.arange(rows.start, rows.stop, rows.step) + first_step
                self._signals[new, self._sensors :] = self._plant.inputs.volts(steps, self._auxiliary)
            self._filled += fit
        self._lost += count - fit

    def read(self) -> Scans:
        self.faults.before_read(self._device, waits=False)
        scans = Scans(self._t_ns[: self._filled].copy(), self._signals[: self._filled].copy(), self._lost)
        self._filled = self._lost = 0
        return self.faults.of_scans(scans)

    def read_digital(self) -> NDArray[np.bool_]:
        """Whether the contacts of the emergency stops are closed."""
        return self.faults.contacts_closed(self._stops)

    def write(self, outputs: NDArray[np.float64]) -> None:
        """Set the outputs, as near as 16 bits come."""
        self.faults.before_write(self._device)
        for valve, (low, high), v in zip(self._valves, self._ranges, outputs.tolist(), strict=True):
            self._plant.set_output(valve, quantised_output(v, low, high))

    def write_digital(self, *, high: bool) -> None:
        self.faults.before_write(self._device)
        if high and not self.digital_high:
            self._rises, self._rise_ns = self._rises + 1, self._plant.t_ns
        self.digital_high = high

    def rise(self) -> tuple[int, int]:
        """Number of rising edges of the digital outputs, and the time of the last one."""
        return self._rises, self._rise_ns

    def readback(self) -> NDArray[np.float64]:
        return np.array([self._plant.output(valve) for valve in self._valves])

    def close(self) -> None:
        self._sampling = False
