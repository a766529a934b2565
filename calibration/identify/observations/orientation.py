"""Measured orientations of the tips, and what averaging over the frames of a plateau leaves of their errors."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from calibration.identify.errors import NoDataError
from model.arrays import Array
from model.units import M_PER_MM
from runs.run import Run

RAD_PER_DEG = np.pi / 180
# Fewest frames of a plateau.
MIN_FRAMES = 5
# Lens, camera placement and the print of the board give all frames a common error that scatter does not show.
_MIN_COMMON_VARIANCE = 0.1


@dataclass(frozen=True)
class Orientations:
    """Measured orientations of the tips, in the rod-base frame; NaN where there is none.

    rotation (K, 3, 3); covariance_rad2 (K, 3, 3) of a small rotation about the axes of the rod base; cross_m_rad
    (K, 3, 3): covariance of the tip (rows) with that rotation (columns).
    """

    rotation: Array
    covariance_rad2: Array
    cross_m_rad: Array

    @property
    def known(self) -> NDArray[np.bool_]:
        """Which entries have an orientation (K,)."""
        found: NDArray[np.bool_] = np.asarray(np.isfinite(self.rotation).all(axis=(1, 2)))
        return found

    def only(self, chosen: NDArray[np.bool_] | NDArray[np.intp]) -> Orientations:
        """A subset of the entries."""
        return Orientations(self.rotation[chosen], self.covariance_rad2[chosen], self.cross_m_rad[chosen])

    def without(self, entries: NDArray[np.bool_]) -> Orientations:
        """The same without the measurements of some entries (K,)."""
        return Orientations(
            np.where(entries[:, None, None], np.nan, self.rotation), self.covariance_rad2, self.cross_m_rad
        )

    def spread(self, rows: NDArray[np.intp], count: int) -> Orientations:
        """The entries at some rows of `count`; NaN in the others."""
        rotation, covariance, cross = (np.full((count, 3, 3), np.nan) for _ in range(3))
        rotation[rows], covariance[rows], cross[rows] = self.rotation, self.covariance_rad2, self.cross_m_rad
        return Orientations(rotation, covariance, cross)


def turned_by(stated: Orientations, rotation: Array, error_rad: Array, known: NDArray[np.bool_]) -> Orientations:
    """Orientations (K, 3, 3) turned by rotation vectors (K, 3), with stated covariances; NaN where not `known` (K,)."""
    turned = Rotation.from_rotvec(error_rad).as_matrix() @ rotation
    return replace(stated, rotation=np.where(known[:, None, None], turned, np.nan))


def orientations(run: Run, frames: NDArray[np.intp]) -> Orientations | None:
    """The orientations of the frames (K,) of a run, -1 for none; None if no frame has one.

    Raises:
        NoDataError: a covariance is not positive.
    """
    vectors = np.deg2rad(run.tip.orientation_deg[frames])
    known = (frames >= 0) & np.isfinite(vectors).all(axis=1)
    known &= np.isfinite(run.tip.orientation_covariance_deg2[frames]).all(axis=(1, 2))
    if not known.any():
        return None
    chosen = frames[known]
    rotation, covariance, cross = (np.full((len(frames), 3, 3), np.nan) for _ in range(3))
    rotation[known] = Rotation.from_rotvec(vectors[known]).as_matrix()
    covariance[known] = run.tip.orientation_covariance_deg2[chosen] * RAD_PER_DEG**2
    cross[known] = np.nan_to_num(run.tip.cross_covariance_mm_deg[chosen]) * (M_PER_MM * RAD_PER_DEG)
    position = run.tip.covariance_mm2[chosen] * M_PER_MM**2
    own = covariance[known] - np.swapaxes(cross[known], 1, 2) @ np.linalg.solve(position, cross[known])
    if (np.linalg.eigvalsh(own)[:, 0] <= 0).any():
        raise NoDataError(
            f"{run.header.run_id}: the uncertainty of the tips' orientation is zero about an axis: no measurement is "
            "that good"
        )
    return Orientations(rotation, covariance, cross)


def mean_orientations(run: Run, plateaus: Sequence[NDArray[np.intp]], averaged: Array) -> Orientations | None:
    """The mean orientation on each plateau; averaged (K,): share of the tips' covariance that is left in their mean."""
    found = orientations(run, np.concatenate(plateaus))
    if found is None:
        return None
    ends = np.cumsum([len(k) for k in plateaus])
    ranges = [np.arange(stop - len(k), stop) for k, stop in zip(plateaus, ends, strict=True)]
    return averaged_orientations(found, ranges, averaged)


def averaged_orientations(
    found: Orientations, ranges: Sequence[NDArray[np.intp]], averaged: Array
) -> Orientations | None:
    """The mean orientation of each range of entries; averaged: as of `mean_orientations`, one for each range."""
    rotation, covariance, cross = (np.full((len(ranges), 3, 3), np.nan) for _ in range(3))
    scatter, counts = [], []
    for n, entries in enumerate(ranges):
        inside = entries[found.known[entries]]
        if len(inside) < MIN_FRAMES:
            continue
        every = Rotation.from_matrix(found.rotation[inside])
        mean = every.mean()
        rotation[n] = mean.as_matrix()
        covariance[n], cross[n] = found.covariance_rad2[inside].mean(axis=0), found.cross_m_rad[inside].mean(axis=0)
        scatter.append((every * mean.inv()).as_rotvec())
        counts.append(n)
    if not counts:
        return None
    share = np.ones(len(ranges))
    share[counts] = averaged_share(scatter, covariance[counts])
    # Both shares scale the joint covariance as standard deviations do, so that it stays positive.
    return Orientations(rotation, covariance * share[:, None, None], cross * np.sqrt(share * averaged)[:, None, None])


def averaged_share(scatter: Sequence[Array], covariance: Array) -> Array:
    """Share (K,) of the stated covariances (K, 3, 3) of a frame that is left in the mean of a plateau's frames.

    scatter: deviations (n, 3) of the frames of each plateau from their mean.
    """
    count = np.array([len(one) for one in scatter])
    common = _common_variance(scatter, covariance)
    out: Array = common + (1 - common) / count
    return out


def _common_variance(scatter: Sequence[Array], covariance: Array) -> float:
    """Fraction of the stated variance that is common to all frames of a plateau.

    Pooled over the plateaus, minus two standard errors.
    """
    ratio, freedom = 0.0, 0
    for difference, stated in zip(scatter, covariance, strict=True):
        ratio += float((difference * np.linalg.solve(stated, difference.T).T).sum())
        freedom += 3 * (len(difference) - 1)
    random = ratio / freedom
    return float(np.clip(1 - random - 2 * np.sqrt(2 / freedom), _MIN_COMMON_VARIANCE, 1.0))
