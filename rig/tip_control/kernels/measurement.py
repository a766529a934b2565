"""Measurement model of the estimator: predicted tip, and its Jacobian by the estimates.

Estimates z (n,) of an arm with V valves: strengths (V,), softness, retardation, lag, payload, offset (3,), then three
coefficients of the cosine and three of the sine of each harmonic.
"""

from __future__ import annotations

import math

import numpy as np

from model.arrays import Array
from rig.tip_control.kernels.arguments import TipMap
from rig.tip_control.kernels.compilation import compiled, internal
from rig.tip_control.kernels.tip_map import evaluate, payload_terms, weighted


@internal
def regressors(t_s: float, period_s: float, found: Array) -> None:
    """Write 1, cosine and sine of each harmonic (1 + 2 H,) at a time; without a period (0) the harmonics are zero."""
    found[:] = 0.0
    found[0] = 1.0
    if period_s > 0:
        for harmonic in range(len(found) // 2):
            phase = 2 * math.pi * (harmonic + 1) * t_s / period_s
            found[1 + 2 * harmonic], found[2 + 2 * harmonic] = math.cos(phase), math.sin(phase)


@internal
def disturbance(z: Array, valves: int, t_s: float, period_s: float) -> tuple[float, float, float]:
    """The estimated disturbance [m] at a time."""
    offset = valves + 4
    known = np.empty((len(z) - offset) // 3)
    regressors(t_s, period_s, known)
    x, y, height = 0.0, 0.0, 0.0
    for k in range(len(known)):
        x += known[k] * z[offset + 3 * k]
        y += known[k] * z[offset + 3 * k + 1]
        height += known[k] * z[offset + 3 * k + 2]
    return x, y, height


@internal
def loaded_map(tip_map: TipMap, z: Array, valves: int) -> Array:
    """The map (8^V, 3) under the estimated payload, which pulls a soft arm farther: (1 + softness) of its effect."""
    terms, softness = tip_map.coefficients.shape[1] // 3, z[valves]
    hung = payload_terms(z[valves + 3] / tip_map.largest_payload_kg, terms)[0]
    without = payload_terms(0.0, terms)[0]
    found: Array = weighted(tip_map.coefficients, (1 + softness) * hung - softness * without)
    return found


@compiled
def predicted_measurement(
    tip_map: TipMap, z: Array, motion: Array, pressure_pa: Array, t_s: float, period_s: float
) -> tuple[Array, Array]:
    """Predicted measurement (3,) [m] and its Jacobian (3, n), for the model's motion (3, 4) and pressures (V,).

    The motion has the estimated retardation already.
    """
    coefficients, limit_pa, largest_payload_kg = tip_map.coefficients, tip_map.limit_pa, tip_map.largest_payload_kg
    valves, columns = len(pressure_pa), coefficients.shape[1]
    terms, softness, lag_s = columns // 3, z[valves], z[valves + 2]
    strong, values, slopes = np.empty(valves), np.empty(columns), np.empty((columns, valves))
    for valve in range(valves):
        strong[valve] = pressure_pa[valve] * (1 + z[valve] + softness)
    evaluate(coefficients, strong, limit_pa, True, values, slopes)
    own, no_slopes = np.empty(columns), np.empty((0, 0))
    evaluate(coefficients, pressure_pa, limit_pa, False, own, no_slopes)
    hung, by_payload = payload_terms(z[valves + 3] / largest_payload_kg, terms)
    without = payload_terms(0.0, terms)[0]
    offset = valves + 4
    known = np.empty((len(z) - offset) // 3)
    regressors(t_s, period_s, known)
    shift = disturbance(z, valves, t_s, period_s)
    predicted, jacobian = np.empty(3), np.zeros((3, len(z)))
    for axis in range(3):
        predicted[axis] = motion[axis, 0] - lag_s * motion[axis, 1] + shift[axis]
        for n in range(terms):
            load = (1 + softness) * hung[n] - softness * without[n]
            predicted[axis] += load * values[3 * n + axis] - without[n] * own[3 * n + axis]
            for valve in range(valves):
                jacobian[axis, valve] += load * slopes[3 * n + axis, valve] * pressure_pa[valve]
            jacobian[axis, valves] += (hung[n] - without[n]) * values[3 * n + axis]
            jacobian[axis, valves + 3] += (1 + softness) * by_payload[n] / largest_payload_kg * values[3 * n + axis]
        for valve in range(valves):
            jacobian[axis, valves] += jacobian[axis, valve]
        jacobian[axis, valves + 1] = motion[axis, 2]
        jacobian[axis, valves + 2] = -motion[axis, 1]
        for k in range(len(known)):
            jacobian[axis, offset + 3 * k + axis] = known[k]
    return predicted, jacobian
