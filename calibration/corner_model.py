"""The grey values round a corner: two blurred edges, fitted to the pixels by compiled Gauss-Newton."""

from __future__ import annotations

import math
from functools import partial
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from model.compiled import kernel

Floats = NDArray[np.float64]
Image = NDArray[np.uint8]

exact_kernel = partial(kernel, sources=(__file__,), fastmath=False)
fast_kernel = partial(kernel, sources=(__file__,), fastmath=True)

# The window has a soft rim, because pixels lie differently to every corner, and a hole, because no product of two edges
# is what a lens makes of the very middle.
TAPER_PX = 1.6
_CORE_PX = 1.0
# Knots of the edge's own shape, and what holds it to none.
KNOTS = 12
_SHAPE_RIDGE = 0.003
_PARAMETERS = 6
_STEPS = 12
_STILL_PX = 0.02
_BLUR_BOUNDS_PX = (0.3, 6.0)
# Quantisation to whole grey levels: no picture is better than this.
LEAST_VARIANCE = 1 / 12


class Fit(NamedTuple):
    """Corners `px` (n, 2), NaN where there is no fit, with covariance `spread` (n, 2, 2) at unit variance of the grey
    values, that `variance` (n,), steps `contrast` (n,), `misfit` (n,), `levels` (n, 2) mean and half step, and the
    `blur` (n, 2) across either edge.
    """

    px: Floats
    spread: Floats
    variance: Floats
    contrast: Floats
    misfit: Floats
    levels: Floats
    blur: Floats


@fast_kernel
def _step_edge(distance: float, blur: float) -> tuple[float, float]:
    """A blurred step from -1 to 1 and its slope: erf by Abramowitz and Stegun 7.1.26, good to 1.5e-7."""
    x = distance / (blur * math.sqrt(2.0))
    decay = math.exp(-x * x)
    t = 1.0 / (1.0 + 0.3275911 * abs(x))
    tail = t * (0.254829592 + t * (-0.284496736 + t * (1.421413741 + t * (-1.453152027 + t * 1.061405429))))
    value = 1.0 - tail * decay
    return (value if x >= 0 else -value), decay * math.sqrt(2.0 / math.pi) / blur


@fast_kernel
def _shaped_edge(distance: float, blur: float, shape: Floats, knot: float) -> tuple[float, float, float]:
    """A blurred step with its own shape: value, slope, and the slope of the plain step alone."""
    value, slope = _step_edge(distance, blur)
    at = abs(distance) / knot
    k = int(at)
    if k >= shape.shape[0] - 1:
        return value, slope, slope
    part = at - k
    more = shape[k] + part * (shape[k + 1] - shape[k])
    steeper = (shape[k + 1] - shape[k]) / knot
    return value + (more if distance >= 0 else -more), slope + steeper, slope


@fast_kernel
def _window(dx: float, dy: float, radius: float) -> float:
    """Weight of a pixel so far from the corner: what ends abruptly lies differently to the pixels of every corner."""
    if dx * dx + dy * dy < _CORE_PX * _CORE_PX:
        return 0.0
    part = (radius + TAPER_PX / 2 - math.sqrt(dx * dx + dy * dy)) / TAPER_PX
    if part >= 1.0:
        return 1.0
    return part * part * (3.0 - 2.0 * part) if part > 0.0 else 0.0


@exact_kernel
def _solve(matrix: Floats, right: Floats) -> bool:
    """Solve a small symmetric positive system in place by Gauss-Jordan; `matrix` becomes its inverse."""
    n = matrix.shape[0]
    for k in range(n):
        pivot = matrix[k, k]
        if not pivot > 1e-12:
            return False
        matrix[k, k] = 1.0
        for j in range(n):
            matrix[k, j] /= pivot
        right[k] /= pivot
        for i in range(n):
            if i != k:
                factor = matrix[i, k]
                matrix[i, k] = 0.0
                for j in range(n):
                    matrix[i, j] -= factor * matrix[k, j]
                right[i] -= factor * right[k]
    return True


@exact_kernel
def fit(
    image: Image,
    seeds: Floats,
    normals: Floats,
    radius: float,
    shape: Floats,
    knot: float,
    usual: Floats,
    firmness: float,
) -> Fit:
    """Fit grey = mean + half step * edge_1 * edge_2 in a window round each corner by Gauss-Newton.

    Unknowns: the corner (2), mean, half the step, and the blur across either edge (motion blurs one more than the
    other), of which `usual` (2,) and its `firmness` are known. `shape` (2, knots + 1), every `knot` px, is what the
    edges of either direction are beside a step blurred by a bell.
    """
    n = seeds.shape[0]
    corners = np.full((n, 2), np.nan)
    spread = np.full((n, 2, 2), np.nan)
    variance = np.full(n, np.nan)
    contrast = np.full(n, np.nan)
    misfit = np.full(n, np.nan)
    levels = np.full((n, 2), np.nan)
    blurs = np.full((n, 2), np.nan)
    matrix = np.empty((_PARAMETERS, _PARAMETERS))
    right = np.empty(_PARAMETERS)
    slope = np.empty(_PARAMETERS)
    reach = math.ceil(radius + TAPER_PX / 2)
    doubly = np.empty((_PARAMETERS, _PARAMETERS))
    usual_1, usual_2 = usual[0], usual[1]
    fitted = 0
    for c in range(n):
        cx, cy = seeds[c]
        x0, y0 = round(cx), round(cy)
        n1x, n1y = normals[c, 0]
        n2x, n2y = normals[c, 1]
        blur_1, blur_2 = usual_1, usual_2
        mean, half_step = 0.0, 0.0
        for step in range(_STEPS):
            if step == 0:
                # Mean and step follow linearly from the edges of the start.
                s_v = s_e = s_ve = s_ee = 0.0
                count = 0
                for y in range(y0 - reach, y0 + reach + 1):
                    for x in range(x0 - reach, x0 + reach + 1):
                        if (x - x0) ** 2 + (y - y0) ** 2 <= radius * radius:
                            e1, _, _ = _shaped_edge(n1x * (x - cx) + n1y * (y - cy), blur_1, shape[0], knot)
                            e2, _, _ = _shaped_edge(n2x * (x - cx) + n2y * (y - cy), blur_2, shape[1], knot)
                            value = float(image[y, x])
                            s_v += value
                            s_e += e1 * e2
                            s_ve += value * e1 * e2
                            s_ee += e1 * e2 * e1 * e2
                            count += 1
                half_step = (s_ve - s_v * s_e / count) / (s_ee - s_e * s_e / count)
                mean = (s_v - half_step * s_e) / count
            matrix[:] = 0.0
            right[:] = 0.0
            doubly[:] = 0.0
            squares = 0.0
            weights = 0.0
            for y in range(y0 - reach, y0 + reach + 1):
                for x in range(x0 - reach, x0 + reach + 1):
                    w = _window(x - seeds[c, 0], y - seeds[c, 1], radius)
                    if w == 0.0:
                        continue
                    d1 = n1x * (x - cx) + n1y * (y - cy)
                    d2 = n2x * (x - cx) + n2y * (y - cy)
                    e1, g1, p1 = _shaped_edge(d1, blur_1, shape[0], knot)
                    e2, g2, p2 = _shaped_edge(d2, blur_2, shape[1], knot)
                    rest = float(image[y, x]) - mean - half_step * e1 * e2
                    slope[0] = -half_step * (g1 * n1x * e2 + e1 * g2 * n2x)
                    slope[1] = -half_step * (g1 * n1y * e2 + e1 * g2 * n2y)
                    slope[2] = 1.0
                    slope[3] = e1 * e2
                    slope[4] = -half_step * p1 * e2 * d1 / blur_1
                    slope[5] = -half_step * p2 * e1 * d2 / blur_2
                    squares += w * rest * rest
                    weights += w
                    for i in range(_PARAMETERS):
                        right[i] += w * slope[i] * rest
                        for j in range(i + 1):
                            matrix[i, j] += w * slope[i] * slope[j]
                            doubly[i, j] += w * w * slope[i] * slope[j]
            for i in range(_PARAMETERS):
                for j in range(i + 1, _PARAMETERS):
                    matrix[i, j] = matrix[j, i]
                    doubly[i, j] = doubly[j, i]
            # The blur is not determined where an edge runs midway between pixels.
            opinion = firmness * (half_step * half_step + 1.0)
            matrix[4, 4] += opinion
            matrix[5, 5] += opinion
            right[4] += opinion * (usual_1 - blur_1)
            right[5] += opinion * (usual_2 - blur_2)
            if not _solve(matrix, right):
                break
            cx += min(max(right[0], -1.0), 1.0)
            cy += min(max(right[1], -1.0), 1.0)
            if (cx - seeds[c, 0]) ** 2 + (cy - seeds[c, 1]) ** 2 > 4.0:
                break
            mean += right[2]
            half_step += right[3]
            blur_1 = min(max(blur_1 + min(max(right[4], -0.4), 0.4), _BLUR_BOUNDS_PX[0]), _BLUR_BOUNDS_PX[1])
            blur_2 = min(max(blur_2 + min(max(right[5], -0.4), 0.4), _BLUR_BOUNDS_PX[0]), _BLUR_BOUNDS_PX[1])
            if abs(right[0]) < _STILL_PX and abs(right[1]) < _STILL_PX:
                variance[c] = max(squares / max(weights - _PARAMETERS, 1.0), LEAST_VARIANCE)
                corners[c, 0], corners[c, 1] = cx, cy
                for i in range(2):
                    for j in range(2):
                        total = 0.0
                        for k in range(_PARAMETERS):
                            for m in range(_PARAMETERS):
                                total += matrix[i, k] * doubly[k, m] * matrix[m, j]
                        spread[c, i, j] = total
                contrast[c] = 2 * half_step
                levels[c, 0], levels[c, 1] = mean, half_step
                blurs[c, 0], blurs[c, 1] = blur_1, blur_2
                misfit[c] = math.sqrt(squares / weights) / max(abs(2 * half_step), 1e-3)
                fitted += 1
                usual_1 += (blur_1 - usual_1) / fitted
                usual_2 += (blur_2 - usual_2) / fitted
                break
    return Fit(corners, spread, variance, contrast, misfit, levels, blurs)


@exact_kernel
def edge_shape(
    image: Image, corners: Floats, normals: Floats, radius: float, levels: Floats, blur: Floats, knot: float
) -> Floats:
    """What the edges of either direction have in common beside the step blurred by a bell (2, knots + 1).

    Odd functions of the distance, linear between knots that begin with 0 at the edge; least squares of what the
    corners' fits leave in the grey values.
    """
    matrix = np.zeros((2 * KNOTS, 2 * KNOTS))
    right = np.zeros(2 * KNOTS)
    index = np.empty(4, np.int64)
    weight = np.empty(4)
    reach = math.ceil(radius)
    for c in range(corners.shape[0]):
        cx, cy = corners[c]
        x0, y0 = round(cx), round(cy)
        mean, half_step = levels[c]
        for y in range(y0 - reach, y0 + reach + 1):
            for x in range(x0 - reach, x0 + reach + 1):
                if (x - x0) ** 2 + (y - y0) ** 2 > radius * radius:
                    continue
                d1 = normals[c, 0, 0] * (x - cx) + normals[c, 0, 1] * (y - cy)
                d2 = normals[c, 1, 0] * (x - cx) + normals[c, 1, 1] * (y - cy)
                e1, _ = _step_edge(d1, blur[0])
                e2, _ = _step_edge(d2, blur[1])
                rest = (float(image[y, x]) - mean) / half_step - e1 * e2
                used = 0
                for side in range(2):
                    d, other = (d1, e2) if side == 0 else (d2, e1)
                    if d < 0:
                        other = -other
                    at = abs(d) / knot
                    k = int(at)
                    if k >= KNOTS:
                        continue
                    part = at - k
                    for j in range(2):
                        # Knot 0, at the edge itself, is nothing; the shape ends with nothing, too.
                        if 0 < k + j < KNOTS:
                            index[used] = side * KNOTS + k + j - 1
                            weight[used] = other * (part if j == 1 else 1 - part)
                            used += 1
                for a in range(used):
                    right[index[a]] += weight[a] * rest
                    for b in range(used):
                        matrix[index[a], index[b]] += weight[a] * weight[b]
    total = 0.0
    for k in range(2 * KNOTS):
        total += matrix[k, k]
    for k in range(2 * KNOTS):
        matrix[k, k] += _SHAPE_RIDGE * total / (2 * KNOTS) + 1e-6
    shape = np.zeros((2, KNOTS + 1))
    if _solve(matrix, right):
        for side in range(2):
            for k in range(KNOTS - 1):
                shape[side, k + 1] = right[side * KNOTS + k]
    return shape
