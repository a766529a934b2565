"""Poses of one run: measured tips with the pressures and loads that an identification explains them by."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from calibration.identify.errors import NoDataError
from calibration.identify.observations.orientation import Orientations
from calibration.identify.observations.pressure_course import PressureCourse
from calibration.identify.observations.pressure_samples import PressureSamples
from calibration.identify.observations.section_poses import SectionPoses
from model.arrays import Array

# Fewest entries of a quasi-static motion for which the correlation of neighbours can be estimated.
MIN_IN_SEQUENCE = 32
# Kinds of the numbers that a fit compares; those of a section have its name in them.
TIP, TIP_ROTATION = "tip", "tip rotation"


def section_kind(name: str) -> str:
    """The kind of the point of a section."""
    return f"section {name}"


def section_rotation_kind(name: str) -> str:
    """The kind of the rotation of a section."""
    return f"section {name} rotation"


@dataclass(frozen=True)
class Poses:
    """Tips and loads of one run: static (K plateaus) or in motion (K frames, `period_s` apart).

    pressure_pa (K, N) as measured, with independent errors of the standard deviations pressure_std_pa (K, N) beside the
    sensor offsets. weight_kg (K,) is the tip load on the cap. wrench (K, 6): measured force [N] and moment [N m] at the
    measured point, in the frame of the tips. tip_m (K, 3) in the rod-base frame with covariance_m2 (K, 3, 3); both NaN
    in frames without a tip. frames (K,): camera frames per entry. time_s (K,) counts from the start of the run; for a
    plateau it is the end. period_s is zero for static poses. live_m (K, 3): tips of the model that ran beside the
    experiment, NaN where there was none; None if there was no such model. course: of static poses, for models that
    remember; None where it is unknown, and each pose has long been held. orientation: of the tips; None if no entry has
    one. sections: measured sections of the arm; they count in entries with a tip. averaged (K,): the number of
    independent frames whose mean has the error of an entry; None if it is one. samples: the pressures of a motion
    between its frames; None if they follow a smooth curve through those of the frames.
    """

    run_id: str
    source: str
    period_s: float
    pressure_pa: Array
    pressure_std_pa: Array
    weight_kg: Array
    wrench: Array
    tip_m: Array
    covariance_m2: Array
    frames: NDArray[np.int64]
    time_s: Array
    live_m: Array | None = None
    course: PressureCourse | None = None
    orientation: Orientations | None = None
    sections: tuple[SectionPoses, ...] = ()
    averaged: Array | None = None
    samples: PressureSamples | None = None

    def __len__(self) -> int:
        return len(self.weight_kg)

    @property
    def moving(self) -> bool:
        """True for a motion: the entries are a time series."""
        return self.period_s > 0

    @property
    def frame_s(self) -> Array:
        """Times (K,) [s] of the frames of a motion since its first one."""
        out: Array = np.arange(len(self), dtype=np.float64) * self.period_s
        return out

    @property
    def in_sequence(self) -> bool:
        """True if the entries are consecutive frames, whose errors correlate."""
        return self.moving or (len(self) >= MIN_IN_SEQUENCE and bool((self.frames == 1).all()))

    @property
    def has_tip(self) -> NDArray[np.bool_]:
        """Which entries have a measured tip (K,)."""
        found: NDArray[np.bool_] = np.asarray(np.isfinite(self.tip_m).all(axis=1))
        return found

    @property
    def has_orientation(self) -> NDArray[np.bool_]:
        """Which entries have a measured tip with an orientation (K,)."""
        if self.orientation is None:
            return np.zeros(len(self), np.bool_)
        return self.orientation.known & self.has_tip

    @property
    def kinds(self) -> tuple[str, ...]:
        """What each entry compares in a fit, three numbers of each kind.

        They are the tip and its rotation, then point and rotation of each section; rotations only if some entry has
        one.
        """
        found = [TIP] if self.orientation is None else [TIP, TIP_ROTATION]
        for one in self.sections:
            found.append(section_kind(one.name))
            if one.orientation is not None:
                found.append(section_rotation_kind(one.name))
        return tuple(found)

    @property
    def numbers(self) -> int:
        """Numbers of each entry that a fit compares, D."""
        return 3 * len(self.kinds)

    def columns(self, kind: str) -> slice:
        """Where the three numbers of a kind stand among them."""
        first = 3 * self.kinds.index(kind)
        return slice(first, first + 3)

    @property
    def measured(self) -> NDArray[np.bool_]:
        """Which of these numbers (K, D) were measured."""
        seen = self.has_tip
        columns = [seen] if self.orientation is None else [seen, self.has_orientation]
        for one in self.sections:
            columns.append(one.seen & seen)
            if one.orientation is not None:
                columns.append(one.oriented & seen)
        return np.repeat(np.stack(columns, axis=1), 3, axis=1)

    @property
    def independent(self) -> float:
        """How many independent numbers were measured, in frames: those of a mean count for each frame of it."""
        return float((self.measured * (1.0 if self.averaged is None else self.averaged[:, None])).sum())

    @property
    def pose_covariance(self) -> Array:
        """Covariances (K, D, D) of these numbers; that of what was not measured beside a tip is the unit matrix."""
        out = np.zeros((len(self), self.numbers, self.numbers))
        out[:, :3, :3] = self.covariance_m2
        if self.orientation is not None:
            _fill_rotation(out, 0, self.orientation, self.has_orientation)
        for one in self.sections:
            at = self.columns(section_kind(one.name))
            out[:, at, at] = np.where(one.seen[:, None, None], one.covariance_m2, np.eye(3))
            if one.orientation is not None:
                _fill_rotation(out, at.start, one.orientation, one.oriented)
        return out

    @property
    def actuators(self) -> int:
        """Number of actuators N."""
        return int(self.pressure_pa.shape[1])

    def only(self, chosen: NDArray[np.bool_] | NDArray[np.intp]) -> Poses:
        """A subset of the entries; of a motion it must be contiguous."""
        first_s = float(np.arange(len(self))[chosen][0]) * self.period_s if self.samples is not None else 0.0
        return replace(
            self,
            pressure_pa=self.pressure_pa[chosen],
            pressure_std_pa=self.pressure_std_pa[chosen],
            weight_kg=self.weight_kg[chosen],
            wrench=self.wrench[chosen],
            tip_m=self.tip_m[chosen],
            covariance_m2=self.covariance_m2[chosen],
            frames=self.frames[chosen],
            time_s=self.time_s[chosen],
            live_m=None if self.live_m is None else self.live_m[chosen],
            course=None if self.course is None else self.course.only(chosen),
            orientation=None if self.orientation is None else self.orientation.only(chosen),
            sections=tuple(one.only(chosen) for one in self.sections),
            averaged=None if self.averaged is None else self.averaged[chosen],
            samples=None if self.samples is None else self.samples.since(first_s),
        )


def _fill_rotation(out: Array, first: int, orientation: Orientations, known: NDArray[np.bool_]) -> None:
    """Covariances of the rotation that follows the point at numbers `first` on, and of both together."""
    point, turn, seen = slice(first, first + 3), slice(first + 3, first + 6), known[:, None, None]
    cross = np.where(seen, orientation.cross_m_rad, 0.0)
    out[:, point, turn], out[:, turn, point] = cross, np.swapaxes(cross, 1, 2)
    out[:, turn, turn] = np.where(seen, orientation.covariance_rad2, np.eye(3))


def split_at(poses: Poses, until_s: float) -> tuple[Poses, Poses]:
    """Split a run at a time [s] into the poses before it and those from then on.

    Both parts of a motion keep all pressures, because the later motion depends on the earlier one; each has only the
    tips of its own time.

    Raises:
        NoDataError: one of the parts has no tip.
    """
    before = poses.time_s < until_s
    parts = []
    for inside, which in ((before, "before"), (~before, "after")):
        part = replace(poses, tip_m=np.where(inside[:, None], poses.tip_m, np.nan))
        part = part if poses.moving else part.only(inside)
        if not part.has_tip.any():
            raise NoDataError(f"{poses.run_id} shows no tip {which} {until_s:g} s")
        parts.append(part)
    return parts[0], replace(parts[1], run_id=f"{poses.run_id} from {until_s:g} s")
