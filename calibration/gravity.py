"""Direction of gravity from the readings of a load cell, by linear least squares and a block jackknife."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from scipy import stats

from model.arrays import Array

# Blocks of consecutive readings that are left out in turn. Readings are correlated within a pose.
_BLOCKS = 10
_LEAST_READINGS = 2 * _BLOCKS
# Relative singular value below which a combination of unknowns has no effect on the readings.
_NO_EFFECT = 1e-3
# A direction with a larger standard uncertainty is not determined.
_WIDEST_RAD = math.radians(30.0)


class GravityUndeterminedError(Exception):
    """The readings do not determine the direction of gravity."""


@dataclass(frozen=True)
class GravityDirection:
    """Direction of gravity, a unit vector (3,), and its standard uncertainty about each axis across it [rad].

    carried_kg: mass that the cell carries beside the known weights; NaN where its zero hides it. m_s2: acceleration
    that known weights show, NaN without them. readings: their number.
    """

    direction: Array
    std_rad: float
    carried_kg: float
    m_s2: float
    readings: int


def gravity_direction(
    force_n: Array, turn: Array, weight_kg: Array, standard_m_s2: float, zero_n: Array | None = None
) -> GravityDirection:
    """Direction of gravity in a frame, from the force (n, 3) [N] that a load cell reads along its own axes.

    A cell whose axes are rotated by `turn` (n, 3, 3) to those of the frame reads zero + turn' (m0 + weight) g: its
    zero, the mass m0 that it always carries, and known weights (n,) [kg]. The direction is that of g where the weights
    differ, else that of m0 g. `zero_n` (3,) is a known zero; without it the zero is estimated, too. The standard
    uncertainty is that of a jackknife over blocks of consecutive readings (Kuensch 1989), widened by Student's t for
    their number. Rows with NaN are left out.

    Raises:
        GravityUndeterminedError: too few readings, or nothing changes that tells the weight from the zero.
    """
    turn = np.broadcast_to(turn, (len(force_n), 3, 3))
    known = np.isfinite(force_n).all(axis=1) & np.isfinite(turn).all(axis=(1, 2)) & np.isfinite(weight_kg)
    force, back, weight = force_n[known], turn[known].transpose(0, 2, 1), weight_kg[known]
    if len(force) < _LEAST_READINGS:
        raise GravityUndeterminedError(f"{len(force)} readings at rest, {_LEAST_READINGS} or more are needed")
    weighed = bool(np.ptp(weight) > 0)
    parts = [back] if zero_n is not None else [np.broadcast_to(np.eye(3), back.shape), back]
    if zero_n is None and not _separable(np.concatenate(parts, axis=2)):
        parts = parts[:1]
        if not weighed:
            raise GravityUndeterminedError(
                "neither the orientation of the cell nor a known weight changes enough to tell weight from zero"
            )
    if weighed:
        parts.append(weight[:, None, None] * back)
    design = np.concatenate(parts, axis=2)
    if not _separable(design):
        raise GravityUndeterminedError(
            "the readings do not change enough to tell the weights from what the cell carries"
        )
    force = force if zero_n is None else force - zero_n
    found = _solved(design, force)
    pull = found[-3:]
    blocks = np.array_split(np.arange(len(force)), _BLOCKS)
    without = np.array([_solved(np.delete(design, block, 0), np.delete(force, block, 0))[-3:] for block in blocks])
    direction = pull / np.linalg.norm(pull)
    std_rad = _spread(without, direction)
    if not std_rad < _WIDEST_RAD:
        raise GravityUndeterminedError(f"the readings leave {math.degrees(std_rad):.0f} degrees of uncertainty")
    carries = len(parts) > 1 + weighed or zero_n is not None
    carried = float(np.linalg.norm(found[-6:-3] if weighed else pull)) / standard_m_s2 if carries else math.nan
    return GravityDirection(
        direction, std_rad, carried, float(np.linalg.norm(pull)) if weighed else math.nan, len(force)
    )


def _solved(design: Array, force: Array) -> Array:
    """Least-squares solution of design (n, 3, k) x = force (n, 3)."""
    return np.asarray(np.linalg.lstsq(design.reshape(-1, design.shape[2]), force.reshape(-1), rcond=None)[0], float)


def _separable(design: Array) -> bool:
    """Whether each combination of the unknowns of design (n, 3, k) has an effect."""
    rows = design.reshape(-1, design.shape[2])
    scale = np.linalg.norm(rows, axis=0)
    if not (scale > 0).all():
        return False
    values = np.linalg.svd(rows / scale, compute_uv=False)
    return bool(values[-1] > _NO_EFFECT * values[0])


def _spread(without: Array, direction: Array) -> float:
    """Standard deviation [rad] across a direction (3,) by its estimates (B, 3) without each block; the larger axis."""
    count = len(without)
    units = without / np.linalg.norm(without, axis=1, keepdims=True)
    across = units - np.outer(units @ direction, direction)
    across -= across.mean(axis=0)
    covariance: Array = (count - 1) / count * across.T @ across
    student = float(stats.t.ppf(0.975, count - 1) / stats.norm.ppf(0.975))
    return student * math.sqrt(float(np.linalg.eigvalsh(covariance)[-1]))
