"""Arguments and results of the kernels."""

from __future__ import annotations

from typing import NamedTuple

from model.arrays import Array


class TipMap(NamedTuple):
    """Map of the tip at rest: `coefficients` (8^V, 3 n) for n payload terms, `nominal` (8^V, 3) without payload."""

    coefficients: Array
    nominal: Array
    limit_pa: float
    largest_payload_kg: float


class ModalStep(NamedTuple):
    """One time step of the modes: A (3, 2, 2), b0 and b1 (3, 2), see `step_matrices`."""

    transition: Array
    first: Array
    last: Array


class TimedSetPoints(NamedTuple):
    """Set-points (k, V) at ascending times (k,), linear in between."""

    times_s: Array
    pressure_pa: Array


class ReferenceSamples(NamedTuple):
    """Positions (h, 3), NaN where a coordinate is free, and feed-forward (h, V) at times (h,); period 0 for none."""

    times_s: Array
    position_m: Array
    feedforward_pa: Array
    period_s: float


class FilteredState(NamedTuple):
    """The model's motion (3, 4) at the time of a frame, and the estimates (n,) after it.

    The motion of a coordinate is tip, velocity, and their sensitivities by the retardation time tau, all with the
    estimated tau.
    """

    motion: Array
    time_s: float
    z: Array


class TipPrediction(NamedTuple):
    """Tips (K, 3) at times (K,) under the last plan, and sensitivities (K, 3, n) by the free deviations [m/Pa]."""

    times_s: Array
    tips_m: Array
    sensitivities: Array


class QuadraticProgram(NamedTuple):
    """Hessian (n, n), gradient (n,) and bounds (m,) of the constraints; unknowns in bar, cost in mm^2.

    `deviation_pa` (k, V): deviations of the last plan at the knots, about which it is linearised.
    """

    hessian: Array
    gradient: Array
    lowest: Array
    highest: Array
    deviation_pa: Array
    prediction: TipPrediction
