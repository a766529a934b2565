"""Measured sections of the arm: points of its axis between base and tip that carry boards of their own."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from calibration.identify.errors import NoDataError
from calibration.identify.observations.orientation import (
    MIN_FRAMES,
    RAD_PER_DEG,
    Orientations,
    averaged_orientations,
    averaged_share,
)
from model.arrays import Array
from model.units import M_PER_MM
from runs.columns import Sections
from runs.records import DetectionStatus
from runs.run import Run


@dataclass(frozen=True)
class SectionPoses:
    """One section in the K entries of some `Poses`.

    at_m: its arc length from the rod base, of the arm at rest. point_m (K, 3): its point on the axis in the rod-base
    frame, with covariance_m2 (K, 3, 3); both NaN where it was not measured. orientation: None if no entry has one.
    """

    name: str
    at_m: float
    point_m: Array
    covariance_m2: Array
    orientation: Orientations | None = None

    @property
    def seen(self) -> NDArray[np.bool_]:
        """Which entries have a measured point (K,)."""
        found: NDArray[np.bool_] = np.asarray(np.isfinite(self.point_m).all(axis=1))
        return found

    @property
    def oriented(self) -> NDArray[np.bool_]:
        """Which entries have a measured point with an orientation (K,)."""
        if self.orientation is None:
            return np.zeros(len(self.point_m), np.bool_)
        return self.orientation.known & self.seen

    def only(self, chosen: NDArray[np.bool_] | NDArray[np.intp]) -> SectionPoses:
        """A subset of the entries."""
        orientation = None if self.orientation is None else self.orientation.only(chosen)
        return SectionPoses(self.name, self.at_m, self.point_m[chosen], self.covariance_m2[chosen], orientation)

    def spread(self, rows: NDArray[np.intp], count: int) -> SectionPoses:
        """The entries at some rows of `count`; NaN in the others."""
        point, covariance = np.full((count, 3), np.nan), np.full((count, 3, 3), np.nan)
        point[rows], covariance[rows] = self.point_m, self.covariance_m2
        orientation = None if self.orientation is None else self.orientation.spread(rows, count)
        return SectionPoses(self.name, self.at_m, point, covariance, orientation)


def section_poses(run: Run, frames: NDArray[np.intp]) -> tuple[SectionPoses, ...]:
    """The sections of a run in its frames (K,), -1 for none; without those that no frame shows.

    Raises:
        NoDataError: a covariance is not positive.
    """
    sections = run.sections
    if sections is None:
        return ()
    found = (_section(run, sections, k, frames) for k in range(len(sections.names)))
    return tuple(one for one in found if one.seen.any())


def _section(run: Run, sections: Sections, k: int, frames: NDArray[np.intp]) -> SectionPoses:
    count, name = len(frames), sections.names[k]
    point, covariance = np.full((count, 3), np.nan), np.full((count, 3, 3), np.nan)
    rotation, turning = np.full((count, 3, 3), np.nan), np.full((count, 3, 3), np.nan)
    measured, stated = sections.measured_mm[frames, k], sections.covariance_mm2[frames, k]
    seen = (frames >= 0) & (sections.seen[frames, k] == DetectionStatus.MEASURED)
    seen &= np.isfinite(measured).all(axis=1) & np.isfinite(stated).all(axis=(1, 2))
    point[seen], covariance[seen] = measured[seen] * M_PER_MM, stated[seen] * M_PER_MM**2
    vectors, spread = sections.orientation_deg[frames, k], sections.orientation_covariance_deg2[frames, k]
    oriented = seen & np.isfinite(vectors).all(axis=1) & np.isfinite(spread).all(axis=(1, 2))
    rotation[oriented] = Rotation.from_rotvec(np.deg2rad(vectors[oriented])).as_matrix()
    turning[oriented] = spread[oriented] * RAD_PER_DEG**2
    for known in (covariance[seen], turning[oriented]):
        if (np.linalg.eigvalsh(known)[:, 0] <= 0).any():
            raise NoDataError(
                f"{run.header.run_id}: the uncertainty of section {name} is zero along an axis: no measurement is that "
                "good"
            )
    orientation = Orientations(rotation, turning, np.zeros((count, 3, 3))) if oriented.any() else None
    return SectionPoses(name, float(sections.at_mm[k]) * M_PER_MM, point, covariance, orientation)


def mean_sections(run: Run, plateaus: Sequence[NDArray[np.intp]]) -> tuple[SectionPoses, ...]:
    """The mean pose of each section on each plateau; NaN on plateaus with few frames that show it."""
    ends = np.cumsum([len(k) for k in plateaus])
    ranges = [np.arange(stop - len(k), stop) for k, stop in zip(plateaus, ends, strict=True)]
    found = (_mean(one, ranges) for one in section_poses(run, np.concatenate(plateaus)))
    return tuple(one for one in found if one is not None)


def _mean(section: SectionPoses, ranges: Sequence[NDArray[np.intp]]) -> SectionPoses | None:
    count = len(ranges)
    inside = [rows[section.seen[rows]] for rows in ranges]
    chosen = [n for n, rows in enumerate(inside) if len(rows) >= MIN_FRAMES]
    if not chosen:
        return None
    point, covariance = np.full((count, 3), np.nan), np.full((count, 3, 3), np.nan)
    scatter = []
    for n in chosen:
        frames = section.point_m[inside[n]]
        point[n], covariance[n] = frames.mean(axis=0), section.covariance_m2[inside[n]].mean(axis=0)
        scatter.append(frames - point[n])
    share = np.ones(count)
    share[chosen] = averaged_share(scatter, covariance[chosen])
    orientation = None
    if section.orientation is not None:
        orientation = averaged_orientations(section.orientation, ranges, share)
    return SectionPoses(section.name, section.at_m, point, covariance * share[:, None, None], orientation)
