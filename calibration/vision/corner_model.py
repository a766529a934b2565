"""The grey values round a corner: two blurred edges, fitted to the pixels by compiled Gauss-Newton."""

from __future__ import annotations

import math
from functools import partial
from typing import NamedTuple

import numpy as np

from calibration.images import Image
from calibration.vision import small_systems
from calibration.vision.small_systems import solve
from model.arrays import Array
from model.kernels.jit import kernel

_sources = (__file__, small_systems.__file__)
exact_kernel = partial(kernel, sources=_sources, fastmath=False)
fast_kernel = partial(kernel, sources=_sources, fastmath=True)

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
LARGEST_RADIUS_PX = 9.0

# The pixels of a window lie side by side in one array, a row for each of what is known of them: only with constant
# distances between the rows does a loop over the pixels become vector instructions.
_MOST = (2 * math.ceil(LARGEST_RADIUS_PX + TAPER_PX / 2) + 1) ** 2
_X, _Y, _GREY, _WEIGHT, _REST = (k * _MOST for k in range(5))
_EDGE_1, _EDGE_2 = 5 * _MOST, 9 * _MOST
_DISTANCE, _VALUE, _STEEP, _PLAIN = (k * _MOST for k in range(4))
_SLOPES, _WEIGHTED = 13 * _MOST, (13 + _PARAMETERS) * _MOST
_ROOM = (13 + 2 * _PARAMETERS) * _MOST


class CornerFit(NamedTuple):
    """Corners `px` (n, 2), NaN where there is no fit, with covariance `spread` (n, 2, 2) at unit variance of the grey
    values, that `variance` (n,), steps `contrast` (n,), `misfit` (n,), `levels` (n, 2) mean and half step, and the
    `blur` (n, 2) across either edge.
    """

    px: Array
    spread: Array
    variance: Array
    contrast: Array
    misfit: Array
    levels: Array
    blur: Array


@fast_kernel
def _bell(square: float) -> float:
    """exp(-square) to 1e-9 of it without a branch or a call, so that a loop becomes vector instructions."""
    part = min(square, 40.0) * (-1.0 / 64.0)
    value = 1.0 + part * (1.0 / 11.0)
    for k in range(10, 0, -1):
        value = 1.0 + part * value * (1.0 / k)
    for _ in range(6):
        value = value * value
    return value


@fast_kernel
def _step_edge(distance: float, blur: float) -> tuple[float, float]:
    """A blurred step from -1 to 1 and its slope: erf by Abramowitz and Stegun 7.1.26, good to 1.5e-7."""
    x = distance / (blur * math.sqrt(2.0))
    decay = _bell(x * x)
    t = 1.0 / (1.0 + 0.3275911 * abs(x))
    tail = t * (0.254829592 + t * (-0.284496736 + t * (1.421413741 + t * (-1.453152027 + t * 1.061405429))))
    return math.copysign(1.0 - tail * decay, x), decay * math.sqrt(2.0 / math.pi) / blur


@fast_kernel
def _window(dx: float, dy: float, radius: float) -> float:
    """Weight of a pixel so far from the corner: what ends abruptly lies differently to the pixels of every corner."""
    if dx * dx + dy * dy < _CORE_PX * _CORE_PX:
        return 0.0
    part = (radius + TAPER_PX / 2 - math.sqrt(dx * dx + dy * dy)) / TAPER_PX
    if part >= 1.0:
        return 1.0
    return part * part * (3.0 - 2.0 * part) if part > 0.0 else 0.0


@fast_kernel
def _gather(image: Image, cx: float, cy: float, radius: float, light: Array, room: Array) -> int:
    """Put the pixels of the window round a corner, in even light, into the room; return how many."""
    light_x, light_y = light
    reach = math.ceil(radius + TAPER_PX / 2)
    x0, y0 = round(cx), round(cy)
    count = 0
    for y in range(y0 - reach, y0 + reach + 1):
        for x in range(x0 - reach, x0 + reach + 1):
            w = _window(x - cx, y - cy, radius)
            if w > 0.0:
                room[_X + count], room[_Y + count] = x, y
                room[_GREY + count] = image[y, x] / (1.0 + light_x * (x - cx) + light_y * (y - cy))
                room[_WEIGHT + count] = w
                count += 1
    return count


@fast_kernel
def _gather_disc(image: Image, cx: float, cy: float, radius: float, light: Array, room: Array) -> int:
    """Put the pixels of a disc round a corner, in even light and without weights, into the room; return how many."""
    light_x, light_y = light
    reach = math.ceil(radius)
    x0, y0 = round(cx), round(cy)
    count = 0
    for y in range(y0 - reach, y0 + reach + 1):
        for x in range(x0 - reach, x0 + reach + 1):
            if (x - x0) ** 2 + (y - y0) ** 2 <= radius * radius:
                room[_X + count], room[_Y + count] = x, y
                room[_GREY + count] = image[y, x] / (1.0 + light_x * (x - cx) + light_y * (y - cy))
                count += 1
    return count


@fast_kernel
def _edges(room: Array, edge: int, count: int, cx: float, cy: float, normal: Array, blur: float) -> None:
    """Put distance, value and slope of one edge at every pixel into the room."""
    nx, ny = normal
    for k in range(count):
        distance = nx * (room[_X + k] - cx) + ny * (room[_Y + k] - cy)
        value, slope = _step_edge(distance, blur)
        room[edge + _DISTANCE + k] = distance
        room[edge + _VALUE + k] = value
        room[edge + _STEEP + k] = room[edge + _PLAIN + k] = slope


@fast_kernel
def _shaped(room: Array, edge: int, count: int, shape: Array, knot: float) -> None:
    """Add the edge's own shape to its value and slope; that of the plain step alone stays."""
    last = shape.shape[0] - 1
    if last < 1:
        return
    for k in range(count):
        distance = room[edge + _DISTANCE + k]
        at = abs(distance) / knot
        before = int(at)
        if before < last:
            rise = shape[before + 1] - shape[before]
            more = shape[before] + (at - before) * rise
            room[edge + _VALUE + k] += more if distance >= 0 else -more
            room[edge + _STEEP + k] += rise / knot


@fast_kernel
def _one_sided(room: Array, edge: int, count: int) -> None:
    """Turn steps from -1 to 1 into steps from 0 to the root of 2: the product of both spans 2, as that of a saddle."""
    part = math.sqrt(0.5)
    for k in range(count):
        room[edge + _VALUE + k] = (1.0 + room[edge + _VALUE + k]) * part
        room[edge + _STEEP + k] *= part
        room[edge + _PLAIN + k] *= part


@fast_kernel
def _linear_start(room: Array, count: int) -> tuple[float, float]:
    """Mean and half the step, which follow linearly from the edges of the start."""
    s = s_v = s_e = s_ve = s_ee = 0.0
    for k in range(count):
        w, value = room[_WEIGHT + k], room[_GREY + k]
        e = room[_EDGE_1 + _VALUE + k] * room[_EDGE_2 + _VALUE + k]
        s += w
        s_v += w * value
        s_e += w * e
        s_ve += w * value * e
        s_ee += w * e * e
    half_step = (s_ve - s_v * s_e / s) / (s_ee - s_e * s_e / s)
    return (s_v - half_step * s_e) / s, half_step


@fast_kernel
def _slopes(
    room: Array, count: int, normals: Array, mean: float, half_step: float, blur_1: float, blur_2: float
) -> tuple[float, float]:
    """Put what the model leaves and its derivatives into the room; return the weighted sum of squares and weights."""
    n1x, n1y = normals[0]
    n2x, n2y = normals[1]
    squares = weights = 0.0
    for k in range(count):
        e1, e2 = room[_EDGE_1 + _VALUE + k], room[_EDGE_2 + _VALUE + k]
        rest = room[_GREY + k] - mean - half_step * e1 * e2
        by_1, by_2 = -half_step * room[_EDGE_1 + _STEEP + k] * e2, -half_step * e1 * room[_EDGE_2 + _STEEP + k]
        room[_REST + k] = rest
        room[_SLOPES + k] = by_1 * n1x + by_2 * n2x
        room[_SLOPES + _MOST + k] = by_1 * n1y + by_2 * n2y
        room[_SLOPES + 2 * _MOST + k] = 1.0
        room[_SLOPES + 3 * _MOST + k] = e1 * e2
        d1, d2 = room[_EDGE_1 + _DISTANCE + k], room[_EDGE_2 + _DISTANCE + k]
        room[_SLOPES + 4 * _MOST + k] = -half_step * room[_EDGE_1 + _PLAIN + k] * e2 * d1 / blur_1
        room[_SLOPES + 5 * _MOST + k] = -half_step * room[_EDGE_2 + _PLAIN + k] * e1 * d2 / blur_2
        squares += room[_WEIGHT + k] * rest * rest
        weights += room[_WEIGHT + k]
    return squares, weights


@fast_kernel
def _normal_equations(room: Array, count: int, matrix: Array, right: Array) -> None:
    """Sum the weighted products of the derivatives with each other and with what the model leaves."""
    for i in range(_PARAMETERS):
        total = 0.0
        for k in range(count):
            weighted = room[_WEIGHT + k] * room[_SLOPES + i * _MOST + k]
            room[_WEIGHTED + i * _MOST + k] = weighted
            total += weighted * room[_REST + k]
        right[i] = total
        for j in range(i + 1):
            total = 0.0
            for k in range(count):
                total += room[_WEIGHTED + i * _MOST + k] * room[_SLOPES + j * _MOST + k]
            matrix[i, j] = matrix[j, i] = total


@fast_kernel
def _spread(room: Array, count: int, inverse: Array, spread: Array) -> None:
    """Covariance (2, 2) of the corner at unit variance of the grey values, from the inverse of the normal equations."""
    xx = xy = yy = 0.0
    for k in range(count):
        dx = dy = 0.0
        for i in range(_PARAMETERS):
            weighted = room[_WEIGHTED + i * _MOST + k]
            dx += inverse[0, i] * weighted
            dy += inverse[1, i] * weighted
        xx += dx * dx
        xy += dx * dy
        yy += dy * dy
    spread[0, 0], spread[0, 1], spread[1, 0], spread[1, 1] = xx, xy, xy, yy


@exact_kernel
def fit(
    image: Image,
    seeds: Array,
    normals: Array,
    radius: float,
    light: Array,
    shape: Array,
    knot: float,
    usual: Array,
    firmness: float,
    quadrant: bool,
) -> CornerFit:
    """Fit grey = light * (mean + half step * edge_1 * edge_2) in a window round each corner by Gauss-Newton.

    Unknowns: the corner (2), mean, half the step, and the blur across either edge (motion blurs one more than the
    other), of which `usual` (2,) and its `firmness` are known. `light` (n, 2) [1/px] is the relative gradient of the
    light at each corner, where it is 1. `shape` (2, knots + 1), every `knot` px, is what the edges of either direction
    are beside a step blurred by a bell; (2, 1) is nothing. `radius` is at most LARGEST_RADIUS_PX.

    Of a `quadrant` only what lies beyond both edges has the other colour, as at the corner of a dark rectangle: the
    edges then step from 0 to 1. Its mean is the level outside.
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
    room = np.empty(_ROOM)
    usual_1, usual_2 = usual[0], usual[1]
    fitted = 0
    for c in range(n):
        cx, cy = seeds[c]
        count = _gather(image, cx, cy, radius, light[c], room)
        blur_1, blur_2 = usual_1, usual_2
        mean, half_step = 0.0, 0.0
        for step in range(_STEPS):
            _edges(room, _EDGE_1, count, cx, cy, normals[c, 0], blur_1)
            _edges(room, _EDGE_2, count, cx, cy, normals[c, 1], blur_2)
            _shaped(room, _EDGE_1, count, shape[0], knot)
            _shaped(room, _EDGE_2, count, shape[1], knot)
            if quadrant:
                _one_sided(room, _EDGE_1, count)
                _one_sided(room, _EDGE_2, count)
            if step == 0:
                mean, half_step = _linear_start(room, count)
            squares, weights = _slopes(room, count, normals[c], mean, half_step, blur_1, blur_2)
            _normal_equations(room, count, matrix, right)
            # The blur is not determined where an edge runs midway between pixels.
            opinion = firmness * (half_step * half_step + 1.0)
            matrix[4, 4] += opinion
            matrix[5, 5] += opinion
            right[4] += opinion * (usual_1 - blur_1)
            right[5] += opinion * (usual_2 - blur_2)
            if not solve(matrix, right):
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
                _spread(room, count, matrix, spread[c])
                contrast[c] = 2 * half_step
                levels[c, 0], levels[c, 1] = mean, half_step
                blurs[c, 0], blurs[c, 1] = blur_1, blur_2
                misfit[c] = math.sqrt(squares / weights) / max(abs(2 * half_step), 1e-3)
                fitted += 1
                usual_1 += (blur_1 - usual_1) / fitted
                usual_2 += (blur_2 - usual_2) / fitted
                break
    return CornerFit(corners, spread, variance, contrast, misfit, levels, blurs)


@exact_kernel
def edge_shape(
    image: Image,
    corners: Array,
    normals: Array,
    radius: float,
    light: Array,
    levels: Array,
    blur: Array,
    knot: float,
) -> Array:
    """What the edges of either direction have in common beside the step blurred by a bell (2, knots + 1).

    Odd functions of the distance, linear between knots that begin with 0 at the edge; least squares of what the
    corners' fits leave in the grey values.
    """
    matrix = np.zeros((2 * KNOTS, 2 * KNOTS))
    right = np.zeros(2 * KNOTS)
    index = np.empty(4, np.int64)
    weight = np.empty(4)
    room = np.empty(_ROOM)
    for c in range(corners.shape[0]):
        cx, cy = corners[c]
        count = _gather_disc(image, cx, cy, radius, light[c], room)
        _edges(room, _EDGE_1, count, cx, cy, normals[c, 0], blur[0])
        _edges(room, _EDGE_2, count, cx, cy, normals[c, 1], blur[1])
        mean, half_step = levels[c]
        for p in range(count):
            e1, e2 = room[_EDGE_1 + _VALUE + p], room[_EDGE_2 + _VALUE + p]
            rest = (room[_GREY + p] - mean) / half_step - e1 * e2
            used = 0
            for side in range(2):
                d, other = (room[_EDGE_1 + _DISTANCE + p], e2) if side == 0 else (room[_EDGE_2 + _DISTANCE + p], e1)
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
    if solve(matrix, right):
        for side in range(2):
            for k in range(KNOTS - 1):
                shape[side, k + 1] = right[side * KNOTS + k]
    return shape
