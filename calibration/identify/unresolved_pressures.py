"""Courses of the pressures that the sensors do not resolve: an error that all frames of a motion share.

A combination of the pressures that varies by less than its noise counts as constant in a fit, although it may vary: a
bending arm presses the air out of its vented chambers. A camera that measures micrometres shows such a course, and the
fit would explain it by the parameters. So each combination has an unknown course. It follows the pressures that are
resolved, as volumes of chambers do, and their rates, as flows do.
"""

from __future__ import annotations

import itertools

import numpy as np

from model.arrays import Array

# A combination of the pressures is resolved if it varies by more than this share of the one that varies most.
_RESOLVED_SHARE = 1e-3
# A shape that differs by a smaller share from the others is left out.
_NEW_SHARE = 1e-3


def unresolved_courses(pressure_pa: Array, rate_pa_s: Array, noise_pa: Array) -> Array:
    """Errors (K, N, m) [Pa] of the pressures in K frames, per unit of m independent unit normal coefficients.

    pressure_pa, rate_pa_s (K, N): what the sensors resolve. noise_pa (N, c): noise in a frame of c combinations of the
    pressures that they do not resolve. Each course of such a combination has the root mean square that the noise hides:
    the variance of K independent errors is known to a share of sqrt(2 / K).
    """
    shapes = _shapes(pressure_pa, rate_pa_s) * (2 / len(pressure_pa)) ** 0.25
    count = shapes.shape[1] * noise_pa.shape[1]
    out: Array = np.einsum("ks,nc->kncs", shapes, noise_pa).reshape(*pressure_pa.shape, count)
    return out


def _shapes(pressure_pa: Array, rate_pa_s: Array) -> Array:
    """Uncorrelated courses (K, S) of mean zero and variance one: the pressures, their rates, and their products."""
    _, sizes, axes = np.linalg.svd(pressure_pa - pressure_pa.mean(axis=0), full_matrices=False)
    axes = axes[sizes > _RESOLVED_SHARE * sizes.max(initial=0.0)]
    value, rate = ((part - part.mean(axis=0)) @ axes.T for part in (pressure_pa, rate_pa_s))
    pairs = list(itertools.combinations_with_replacement(range(len(axes)), 2))
    products = [value[:, i] * value[:, j] for i, j in pairs]
    products += [value[:, i] * rate[:, j] for i, j in itertools.product(range(len(axes)), repeat=2)]
    columns = np.column_stack([value, rate, *products])
    columns = columns - columns.mean(axis=0)
    norms = np.linalg.norm(columns, axis=0)
    columns = columns[:, norms > 0] / norms[norms > 0]
    basis, found, _ = np.linalg.svd(columns, full_matrices=False)
    out: Array = basis[:, found > _NEW_SHARE * found.max(initial=0.0)] * np.sqrt(len(pressure_pa))
    return out
