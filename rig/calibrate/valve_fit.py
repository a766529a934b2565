"""Fit a valve to pressure rates at many voltages: closed voltage, dead zone, hysteresis, leakage, flow curve.

The inflow of a chamber of volume V is q = V dp/dt / p0 at the reference atmosphere p0. ISO 6358 relates q and both
pressures to a conductance, given here as the flow at 6 -> 5 bar, as in data sheets. Leakage is the flow through the
closed valve.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from calibration.camera import CalibrationError
from model.arrays import Array
from rig.valves.iso6358 import ANR_PA, ATMOSPHERE_PA, flow_function, sonic_conductance
from rig.valves.metering import MeteringValve

# Openings in these shares of the full flow lie on the straight part next to the dead zone.
_EDGE_SHARES = (0.004, 0.028)
_LEAST_EDGE_POINTS = 3
# Least uncertainty: the scatter shows neither the steps of the sweep nor rounded edges.
_LEAST_EDGE_STD_V = 0.003
_LEAST_FLOW_SHARE = 0.02
_TAIL_STD_SHARE = 0.15
_JOINING = 3


@dataclass(frozen=True)
class RateMeasurement:
    """One measurement: the valve at `offset_v` from its stated closed voltage (positive fills), `outward` when it came
    from nearer to closed; the chambers at gauge `pressure_pa`, changing by `rate_pa_s` with standard uncertainty
    `std_pa_s`.
    """

    offset_v: float
    outward: bool
    pressure_pa: float
    rate_pa_s: float
    std_pa_s: float


@dataclass(frozen=True)
class FittedValve:
    """What was found; flows in l/min at 6 -> 5 bar, voltages from the closed one that was found.

    `curve_v`, `curve_l_min`, `curve_std_l_min` (n,) begin at zero; beyond `measured_to_v` they are the rig's, scaled.
    `offsets_v`, `flows_l_min`, `stds_l_min`, `residuals_l_min` (m,) are the measurements, signed.
    """

    closed_v: float
    closed_std_v: float
    dead_zone_v: float
    dead_zone_std_v: float
    hysteresis_v: float
    leakage_l_min: float
    leakage_std_l_min: float
    curve_v: Array
    curve_l_min: Array
    curve_std_l_min: Array
    full_l_min: float
    measured_to_v: float
    offsets_v: Array
    flows_l_min: Array
    stds_l_min: Array
    residuals_l_min: Array


def fit(valve: MeteringValve, rates: Sequence[RateMeasurement], volumes_m3: Sequence[float]) -> FittedValve:
    """Fit one valve; `volumes_m3` is the air that each rate moved.

    Raises:
        CalibrationError: the sweep did not leave the dead zone on either side, or has no leakage measurement.
    """
    per_conductance = 1.0 / sonic_conductance(1.0, valve.critical_ratio)
    every = [
        _Flow(r, v * r.rate_pa_s / ANR_PA, v * r.std_pa_s / ANR_PA) for r, v in zip(rates, volumes_m3, strict=True)
    ]
    leakage, leakage_std = _leakage(valve, [f for f in every if f.of.offset_v == 0.0])
    swept = [f for f in every if f.of.offset_v != 0.0]
    offset = np.array([f.of.offset_v for f in swept])
    outward = np.array([f.of.outward for f in swept])
    flow, std = np.array([_opening(valve, f, leakage) for f in swept]).T * per_conductance
    # Drag of the spool moves the edge outward on the way out and inward on the way back.
    edges = {}
    for side in (1, -1):
        for way in (True, False):
            mine = (np.sign(offset) == side) & (outward == way)
            edges[side, way] = _edge(np.abs(offset[mine]), side * flow[mine], std[mine], valve.full_flow_l_min)
    fills, vents = ((edges[s, True][0] + edges[s, False][0]) / 2 for s in (1, -1))
    # Two directions on each side give four estimates of two edges.
    spread = float(np.sqrt(np.mean([e[1] ** 2 for e in edges.values()]) / 2 + _LEAST_EDGE_STD_V**2))
    middle, dead = (fills - vents) / 2, (fills + vents) / 2
    hysteresis = float(np.mean([edges[s, True][0] - edges[s, False][0] for s in (1, -1)]))
    volts, mean, mean_std = _curve(offset, flow, std, middle)
    knots, curve, curve_std, full = _joined(valve, volts, mean, mean_std, dead)
    modelled = np.sign(offset) * np.interp(np.abs(offset - middle), *_from_edge(knots, curve, dead))
    return FittedValve(
        closed_v=valve.closed_V + valve.fill_sign * middle,
        closed_std_v=spread / np.sqrt(2),
        dead_zone_v=dead,
        dead_zone_std_v=spread / np.sqrt(2),
        hysteresis_v=max(hysteresis, 0.0),
        leakage_l_min=leakage * per_conductance,
        leakage_std_l_min=leakage_std * per_conductance,
        curve_v=knots,
        curve_l_min=curve,
        curve_std_l_min=curve_std,
        full_l_min=full,
        measured_to_v=float(volts[-1]),
        offsets_v=offset - middle,
        flows_l_min=flow,
        stds_l_min=std,
        residuals_l_min=flow - modelled,
    )


class _Flow(NamedTuple):
    """A rate as the flow into the chambers [m3/s, reference atmosphere] with its standard uncertainty."""

    of: RateMeasurement
    flow: float
    std: float


def _leak_drive(valve: MeteringValve, pressure_pa: float) -> float:
    """Leakage in per conductance: from the supply into the chamber, less from the chamber into the room."""
    chamber, supply = pressure_pa + ATMOSPHERE_PA, valve.absolute_supply_pa
    into = supply * flow_function(chamber / supply, valve.critical_ratio)
    return into - chamber * flow_function(ATMOSPHERE_PA / chamber, valve.critical_ratio)


def _leakage(valve: MeteringValve, rates: Sequence[_Flow]) -> tuple[float, float]:
    """Conductance of the closed valve and its standard uncertainty, from rates at different pressures."""
    if len(rates) < 2:
        raise CalibrationError("the leakage needs the closed valve at two pressures")
    drive = np.array([_leak_drive(valve, r.of.pressure_pa) for r in rates])
    flow = np.array([r.flow for r in rates])
    std = np.array([r.std for r in rates])
    weight = 1 / np.maximum(std, 1e-12) ** 2
    found = float(np.sum(weight * drive * flow) / np.sum(weight * drive**2))
    chi = float(np.sum(weight * (flow - found * drive) ** 2)) / max(len(rates) - 1, 1)
    return max(found, 0.0), float(np.sqrt(max(chi, 1.0) / np.sum(weight * drive**2)))


def _opening(valve: MeteringValve, seen: _Flow, leakage: float) -> tuple[float, float]:
    """Conductance of the metered path, signed as the offset, and its standard uncertainty."""
    chamber = seen.of.pressure_pa + ATMOSPHERE_PA
    up, down = (valve.absolute_supply_pa, chamber) if seen.of.offset_v > 0 else (chamber, ATMOSPHERE_PA)
    drive = up * flow_function(down / up, valve.critical_ratio)
    return (seen.flow - leakage * _leak_drive(valve, seen.of.pressure_pa)) / drive, seen.std / drive


def _edge(offset: Array, flow: Array, std: Array, full: float) -> tuple[float, float]:
    """Where the straight part next to the dead zone reaches zero, and its standard uncertainty [V]."""
    order = np.argsort(offset)
    offset, flow, std = offset[order], flow[order], std[order]
    straight = (flow > _EDGE_SHARES[0] * full) & (flow < _EDGE_SHARES[1] * full)
    if straight.sum() < _LEAST_EDGE_POINTS:
        raise CalibrationError(
            f"the sweep has {straight.sum()} voltages next to the dead zone, {_LEAST_EDGE_POINTS} are needed: is there "
            "air on the valve, and does full_flow_l_min belong to it?"
        )
    x, y = offset[straight], flow[straight]
    slopes = np.column_stack([np.ones(len(x)), x])
    (a, b), *_ = np.linalg.lstsq(slopes, y, rcond=None)
    if b <= 0:
        raise CalibrationError("the flow does not rise with the voltage: is `fills` the wrong way round?")
    rest = y - slopes @ np.array([a, b])
    variance = max(float(rest @ rest) / max(len(x) - 2, 1), float(np.mean(std[straight] ** 2)))
    covariance = variance * np.linalg.inv(slopes.T @ slopes)
    by = np.array([-1 / b, a / b**2])
    return float(-a / b), float(np.sqrt(by @ covariance @ by))


def _curve(offset: Array, flow: Array, std: Array, middle: float) -> tuple[Array, Array, Array]:
    """Flow against the voltage from the middle, both ways and both sides together; rising."""
    volts, mean, spread = [], [], []
    for size in np.unique(np.round(np.abs(offset), 6)):
        sides = []
        for side in (1, -1):
            mine = np.isclose(offset, side * size, atol=1e-6)
            if mine.any():
                sides.append((size - side * middle, float(np.mean(side * flow[mine])), float(np.mean(std[mine]))))
        at = np.array(sides)
        # The offset of the middle shifts both sides; half of their difference is the uncertainty.
        asymmetry = float(np.ptp(at[:, 1])) / 2 if len(at) > 1 and abs(middle) < 0.01 else 0.0
        volts.append(float(at[:, 0].mean()))
        mean.append(float(at[:, 1].mean()))
        spread.append(float(np.hypot(at[:, 2].mean() / np.sqrt(len(at)), asymmetry)))
    return np.array(volts), np.array(mean), np.array(spread)


def _joined(
    valve: MeteringValve, volts: Array, mean: Array, std: Array, dead: float
) -> tuple[Array, Array, Array, float]:
    """The measured curve, continued by the rig's: knots, flows, standard uncertainties; and the flow fully open."""
    stated_v = np.array(valve.flow_curve_V) + dead - valve.dead_zone_V
    stated = np.array(valve.flow_curve_percent) / 100 * valve.full_flow_l_min
    kept = [(0.0, 0.0, 0.0)]
    for v, f, s in zip(volts, mean, std, strict=True):
        if v > dead and f > max(kept[-1][1], 0.0):
            kept.append((float(v), float(f), float(max(s, _LEAST_FLOW_SHARE * f))))
    if len(kept) < _JOINING + 1:
        raise CalibrationError("the sweep found hardly any flow: is there air on the valve?")
    last = np.array(kept[-_JOINING:])
    scale = float(np.sum(last[:, 1]) / np.sum(np.interp(last[:, 0], stated_v, stated)))
    for v, f in zip(stated_v, stated * scale, strict=True):
        if v > kept[-1][0] and f > kept[-1][1]:
            kept.append((float(v), float(f), _TAIL_STD_SHARE * float(f)))
    knots, curve, spread = np.array(kept).T
    return knots, curve, spread, max(float(scale * valve.full_flow_l_min), float(curve[-1]))


def _from_edge(knots: Array, curve: Array, dead: float) -> tuple[Array, Array]:
    """The curve as a regulator takes it: nothing up to the dead zone's edge."""
    beyond = knots > dead
    return np.concatenate([[0.0, dead], knots[beyond]]), np.concatenate([[0.0, 0.0], curve[beyond]])
