"""Valves, chambers and sensors: the air of the plant, one compiled kernel on a fixed grid of small steps.

Absolute pressures in Pa, volumes in m3, flow as volume at the reference atmosphere (see `rig.valves.iso6358`). The
equations are in docs/explanation/simulator.md. The grid is part of the truth: the same steps are taken however they
are requested.
"""

from __future__ import annotations

import cmath
import math
from dataclasses import fields
from functools import partial
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from model.arrays import Array
from model.kernels.jit import kernel
from model.units import PA_PER_BAR
from rig.config.schema import RigConfig
from rig.config.simulator_sections import Simulator
from rig.valves import iso6358
from rig.valves.base import SimulatedValve, ValveTruth
from rig.valves.iso6358 import ANR_K, ANR_PA, ATMOSPHERE_PA

STEP_NS = 100_000
REGULATOR_S = 0.03
"""Lag of a simulated electro-pneumatic regulator."""

Integers = NDArray[np.int64]


compiled = partial(kernel, sources=(__file__, iso6358.__file__))


class ValveTable(NamedTuple):
    """Truth of the valves; arrays over valves. `spool` (V, 2, 2) carries (position - target, rate) over a step."""

    regulates: NDArray[np.bool_]
    closed_v: Array
    fill_sign: Array
    half_hysteresis_v: Array
    spool: Array
    curve_v: Array
    curve_fraction: Array
    conductance: Array
    leak: Array
    supply_pa: Array
    critical_ratio: Array
    pa_at_zero: Array
    pa_per_unit: Array
    lowest_pa: Array
    highest_pa: Array


class ChamberTable(NamedTuple):
    """Truth of the chambers: `valve` (N,) of each, and `sharing` (V,), the number of chambers on each valve."""

    valve: Integers
    sharing: Integers
    tube: float
    stiffness_pa: float
    polytropic: float
    regulator_gain: float


class SensorTable(NamedTuple):
    """Truth of the sensors and of the card inputs behind them; arrays over actuators.

    `every` is the number of grid steps between two scans of the sensor's card.
    """

    seed: int
    every: Integers
    lag_gain: float
    noise_pa: Array
    offset_pa: Array
    zero_pa: Array
    v_per_pa: Array
    span_low_v: Array
    span_high_v: Array
    range_low_v: Array
    range_high_v: Array


class PneumaticState(NamedTuple):
    """State of the plant's air; changed in place by `advance`."""

    command_v: Array
    target_v: Array
    spool_v: Array
    spool_rate: Array
    pressure_pa: Array
    volume_m3: Array
    volume_rate: Array
    lagged_pa: Array


_OF_TRUTH = tuple(field.name for field in fields(ValveTruth))


def valves(config: RigConfig, truth: SimulatedValve) -> ValveTable:
    """The true valves of a rig, each as its type describes it."""
    true = [valve.simulated(truth) for valve in config.valves]
    n, points = len(true), max(len(valve.curve_v) for valve in true) + 1
    curves: dict[str, Array] = {
        "curve_v": np.full((n, points), 1e9) + np.arange(points),
        "curve_fraction": np.zeros((n, points)),
    }
    scalars: dict[str, Array] = {
        name: np.array([getattr(valve, name) for valve in true]) for name in _OF_TRUTH if name not in curves
    }
    regulates = np.array([valve.pa_per_unit != 0.0 for valve in true])
    arrays = ValveTable(regulates=regulates, spool=np.tile(_spool(truth), (n, 1, 1)), **curves, **scalars)
    for i, valve in enumerate(true):
        if valve.curve_v:
            arrays.curve_v[i, : len(valve.curve_v)] = valve.curve_v
            arrays.curve_fraction[i] = valve.curve_fraction[-1]
            arrays.curve_fraction[i, : len(valve.curve_fraction)] = valve.curve_fraction
    return arrays


def _spool(truth: SimulatedValve) -> Array:
    """Transition over one grid step of a second-order system at rest at zero."""
    omega = 2 * math.pi * truth.spool_hz
    system = np.array([[0.0, 1.0], [-(omega**2), -2 * truth.spool_damping * omega]])
    # The exponential of a 2 x 2 matrix about its mean eigenvalue; one formula for spools that ring and that creep.
    mean, dt = -truth.spool_damping * omega, STEP_NS * 1e-9
    turn = cmath.sqrt(truth.spool_damping**2 - 1) * omega * dt
    grows = dt * (cmath.sinh(turn) / turn).real if turn else dt
    still = cmath.cosh(turn).real * np.eye(2)
    return np.asarray(math.exp(mean * dt) * (still + grows * (system - mean * np.eye(2))), dtype=np.float64)


def chambers(config: RigConfig, truth: Simulator) -> ChamberTable:
    """The true chambers of a rig."""
    valve = np.array(config.valve_of, np.int64)
    return ChamberTable(
        valve=valve,
        sharing=np.bincount(valve, minlength=len(config.valves)),
        tube=truth.chamber.tube_l_s_bar * 1e-3 / PA_PER_BAR,
        stiffness_pa=truth.chamber.polytropic * ANR_PA * truth.chamber.temperature_k / ANR_K,
        polytropic=truth.chamber.polytropic,
        regulator_gain=-math.expm1(-STEP_NS * 1e-9 / REGULATOR_S),
    )


def sensors(config: RigConfig, truth: Simulator, seed: int) -> SensorTable:
    """The true sensors of a rig; their offsets are drawn from the seed."""
    ordered = config.sensors_by_actuator
    span_v = np.array([s.signal_span for s in ordered])
    span_pa = np.array([s.span_bar for s in ordered]) * PA_PER_BAR
    lag_s = truth.sensor.lag_ms * 1e-3
    rng = np.random.default_rng([seed, 0x5E450])
    per_pa = (span_v[:, 1] - span_v[:, 0]) / (span_pa[:, 1] - span_pa[:, 0])
    return SensorTable(
        seed=seed,
        every=np.array([scan_steps(config.cards[s.card].sampling_hz) for s in ordered], np.int64),
        lag_gain=-math.expm1(-STEP_NS * 1e-9 / lag_s) if lag_s > 0 else 1.0,
        noise_pa=np.full(len(ordered), truth.sensor.noise_bar * PA_PER_BAR),
        offset_pa=rng.standard_normal(len(ordered)) * truth.sensor.offset_bar * PA_PER_BAR,
        zero_pa=span_pa[:, 0] - span_v[:, 0] / per_pa + ATMOSPHERE_PA,
        v_per_pa=per_pa,
        span_low_v=span_v.min(axis=1),
        span_high_v=span_v.max(axis=1),
        range_low_v=np.array([s.signal_range[0] for s in ordered]),
        range_high_v=np.array([s.signal_range[1] for s in ordered]),
    )


def scan_steps(sampling_hz: float) -> int:
    """Grid steps between scans: a mock card's clock divides the grid, as a real card's divides its crystal."""
    return max(1, round(1e9 / sampling_hz / STEP_NS))


def vented(n_valves: int, volume_m3: Array) -> PneumaticState:
    """Air at rest: every chamber (N,) [m3] at the atmosphere, every output at 0 V as a driver's attach leaves it."""
    n = len(volume_m3)
    zeros = np.zeros
    return PneumaticState(
        command_v=zeros(n_valves),
        target_v=zeros(n_valves),
        spool_v=zeros(n_valves),
        spool_rate=zeros(n_valves),
        pressure_pa=np.full(n, ATMOSPHERE_PA),
        volume_m3=volume_m3.copy(),
        volume_rate=zeros(n),
        lagged_pa=np.full(n, ATMOSPHERE_PA),
    )


_flow_function = compiled(iso6358.flow_function)


@compiled
def _flow(conductance: float, a_pa: float, b_pa: float, critical_ratio: float) -> float:
    """Flow from a to b through one restriction; negative when b is at the higher pressure."""
    if a_pa >= b_pa:
        return float(conductance * a_pa * _flow_function(b_pa / a_pa, critical_ratio))
    return float(-conductance * b_pa * _flow_function(a_pa / b_pa, critical_ratio))


@compiled
def _opening(offset_v: float, volts: Array, fractions: Array) -> float:
    if offset_v <= volts[0]:
        return 0.0
    for i in range(1, len(volts)):
        if offset_v < volts[i]:
            slope = (fractions[i] - fractions[i - 1]) / (volts[i] - volts[i - 1])
            return float(fractions[i - 1] + (offset_v - volts[i - 1]) * slope)
    return float(fractions[-1])


@compiled
def _rates(
    v: ValveTable, c: ChamberTable, path: Array, volume: Array, volume_rate: Array, p: Array, out: Array
) -> None:
    """dp/dt (N,) of every chamber on a flow-metering valve; `path` (V,) is the opening, negative towards exhaust."""
    n = len(p)
    for a in range(n):
        i = c.valve[a]
        if v.regulates[i]:
            out[a] = 0.0
            continue
        b = v.critical_ratio[i]
        leak = v.leak[i] / c.sharing[i]
        flow = _flow(leak, v.supply_pa[i], p[a], b) - _flow(leak, p[a], ATMOSPHERE_PA, b)
        if path[i] > 0.0:
            flow += _flow(path[i], v.supply_pa[i], p[a], b)
        elif path[i] < 0.0:
            flow -= _flow(-path[i], p[a], ATMOSPHERE_PA, b)
        for other in range(n):
            if other != a and c.valve[other] == i:
                # Two tubes in series join two chambers; more than two form a star.
                flow += _flow(c.tube * math.sqrt(2.0) / c.sharing[i], p[other], p[a], b)
        out[a] = (c.stiffness_pa * flow - c.polytropic * p[a] * volume_rate[a]) / volume[a]


@compiled
def _scatter(key: int) -> np.uint64:
    """SplitMix64's output function: 64 well-mixed bits of a counter."""
    z = np.uint64(key)
    z = (z ^ (z >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
    z = (z ^ (z >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
    return z ^ (z >> np.uint64(31))


@compiled
def _normal(seed: int, sensor: int, step: int) -> float:
    """A standard normal number that depends on its arguments only (Box and Muller over a hashed counter)."""
    golden = np.uint64(0x9E3779B97F4A7C15)
    stream = _scatter(np.uint64(seed) * golden + np.uint64(sensor + 1))
    first = _scatter(stream + np.uint64(2 * step) * golden)
    second = _scatter(stream + np.uint64(2 * step + 1) * golden)
    u = (np.float64(first >> np.uint64(11)) + 0.5) / 9007199254740992.0
    angle = np.float64(second >> np.uint64(11)) * (2.0 * math.pi / 9007199254740992.0)
    return math.sqrt(-2.0 * math.log(u)) * math.cos(angle)


@compiled
def _read(s: SensorTable, a: int, step: int, pressure_pa: float) -> float:
    """Volts that the card's 16 bits give for one sensor."""
    seen = pressure_pa + s.offset_pa[a] + s.noise_pa[a] * _normal(s.seed, a, step)
    volts = min(max((seen - s.zero_pa[a]) * s.v_per_pa[a], s.span_low_v[a]), s.span_high_v[a])
    low, width = s.range_low_v[a], s.range_high_v[a] - s.range_low_v[a]
    code = min(max(round((volts - low) / width * 65535.0), 0.0), 65535.0)
    return float(low + code / 65535.0 * width)


@compiled
def advance(
    v: ValveTable, c: ChamberTable, s: SensorTable, air: PneumaticState, first_step: int, steps: int, scans: Array
) -> None:
    """Take `steps` grid steps from grid point `first_step`, changing `air`.

    A sensor that is scanned at grid point j writes its volts to `scans[j - first_step - 1, a]` (steps, N); the others
    leave their entry as it was.
    """
    dt = STEP_NS * 1e-9
    n = len(air.pressure_pa)
    path = np.zeros(len(air.command_v))
    rate = np.zeros(n)
    middle = np.zeros(n)
    volume = np.zeros(n)
    for j in range(first_step + 1, first_step + steps + 1):
        for i in range(len(path)):
            # Friction: the spool's target follows the command only once it is dragged by the hysteresis' half width.
            low, high = air.command_v[i] - v.half_hysteresis_v[i], air.command_v[i] + v.half_hysteresis_v[i]
            air.target_v[i] = min(max(air.target_v[i], low), high)
            x, w = air.spool_v[i] - air.target_v[i], air.spool_rate[i]
            air.spool_v[i] = air.target_v[i] + v.spool[i, 0, 0] * x + v.spool[i, 0, 1] * w
            air.spool_rate[i] = v.spool[i, 1, 0] * x + v.spool[i, 1, 1] * w
            offset = v.fill_sign[i] * (air.spool_v[i] - v.closed_v[i])
            opened = v.conductance[i] * _opening(abs(offset), v.curve_v[i], v.curve_fraction[i])
            # Valve and tubes in series: the squares of their resistances add. The chambers share what passes.
            share = c.sharing[i]
            path[i] = math.copysign(opened / math.sqrt(1.0 + (opened / (c.tube * share)) ** 2) / share, offset)
        _rates(v, c, path, air.volume_m3, air.volume_rate, air.pressure_pa, rate)
        for a in range(n):
            middle[a] = air.pressure_pa[a] + 0.5 * dt * rate[a]
            volume[a] = air.volume_m3[a] + 0.5 * dt * air.volume_rate[a]
        _rates(v, c, path, volume, air.volume_rate, middle, rate)
        for a in range(n):
            i = c.valve[a]
            if v.regulates[i]:
                demanded = v.pa_at_zero[i] + v.pa_per_unit[i] * air.spool_v[i]
                target = min(max(demanded, v.lowest_pa[i]), v.highest_pa[i])
                air.pressure_pa[a] += c.regulator_gain * (target - air.pressure_pa[a])
            else:
                air.pressure_pa[a] += dt * rate[a]
            air.volume_m3[a] += dt * air.volume_rate[a]
            air.lagged_pa[a] += s.lag_gain * (air.pressure_pa[a] - air.lagged_pa[a])
            if j % s.every[a] == 0:
                scans[j - first_step - 1, a] = _read(s, a, j, air.lagged_pa[a])


@compiled
def follow(
    s_m: Array,
    v: Array,
    u: Array,
    at_m: Array,
    points: Integers,
    bore_m2: Array,
    dead_m3: float,
    within_s: float,
    air: PneumaticState,
) -> None:
    """Have the chambers' volumes go, within some time, to those that they have in a bent arm.

    `s_m` (n,), shear and stretch `v` (n, 3) and curvature `u` (n, 3) along its axis; `at_m` (N, 2): where the chambers
    lie in its section; `points` (N, 2): the first point of each, and the one after its last. A chamber is a bore
    `bore_m2` (N,) along its segment of the arm, and the dead volume beside it.
    """
    for a in range(at_m.shape[0]):
        x, y = at_m[a]
        length = before = 0.0
        for j in range(points[a, 0], points[a, 1]):
            v1, v2, v3 = v[j, 0] - u[j, 2] * y, v[j, 1] + u[j, 2] * x, v[j, 2] + u[j, 0] * y - u[j, 1] * x
            stretch = math.sqrt(v1 * v1 + v2 * v2 + v3 * v3)
            if j > points[a, 0]:
                length += 0.5 * (s_m[j] - s_m[j - 1]) * (before + stretch)
            before = stretch
        air.volume_rate[a] = (dead_m3 + bore_m2[a] * length - air.volume_m3[a]) / within_s
