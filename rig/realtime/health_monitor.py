"""Health monitor: warnings to the operator during a run, such as an unmeasured tip, an unsolved model or lost data.

No such condition moves a valve, so none stops the run: the record marks the affected rows and the operator decides.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from rig.config.schema import RigConfig
from runs.records import DATAGRAM_COUNTS, DetectionStatus, Event, Level, SolveStatus

SHARE_TIME_CONSTANT_S = 1.0
"""Time constant of the share of affected rows."""
CLEARED = 0.2
"""A condition ends once its share falls below this part of its threshold (hysteresis)."""
LATE_S = 0.25
RATE_TOLERANCE = 0.05
"""Largest relative error of the camera rate."""
DRIFTING = 0.99
"""At the start a jitter takes the drift to its limit for a few seconds; longer, the clock drifts so fast."""
STALL_S = 0.5
SUSPENSION_S = 0.1
CONTROL_STALL_S = 0.1
DISK_S = 2.0
REPEATED_S = 10.0
"""Shortest time between two warnings about losses of the same kind."""

_CAUSES = {
    DetectionStatus.NO_BOARD: "no board in the picture: light, lens cap, something before the camera?",
    DetectionStatus.AMBIGUOUS: "the board's orientation is ambiguous (half a turn), or the board is cut off",
    DetectionStatus.POOR_FIT: "the board's corners do not fit a plane board",
    DetectionStatus.NO_FRAME: "the camera repeats the same picture bit for bit: it is frozen, or delivers old pictures",
    DetectionStatus.NO_POSE: "the tracker does not see the body: is it covered or out of its range?",
    DetectionStatus.NO_MESSAGE: "no message of the tracker comes in time: does the sender run?",
    DetectionStatus.DISAGREE: "the cameras contradict each other: was one moved, or is its calibration another's?",
}


@dataclass(frozen=True)
class _TipSource:
    """What measures the tip, and what it gives."""

    source: str
    items: str


_CAMERA, _TRACKER = _TipSource("the camera", "pictures"), _TipSource("the tracker", "poses")


@dataclass
class _Condition:
    """One condition with hysteresis; `above` is the share of affected rows that triggers a warning."""

    above: float
    share: float = 0.0
    since_ns: int = 0
    reported: bool = False

    def events(
        self, t_ns: int, period_s: float, part: float, source: str, warning: str, recovery: str
    ) -> Iterator[Event]:
        """Take one row, of which `part` (0 to 1) is affected; report when the condition begins and when it ends.

        `{share}` in `warning` is the share of affected rows.
        """
        if self.share < self.above * CLEARED:
            self.since_ns = t_ns
        self.share += (part - self.share) * min(1.0, period_s / SHARE_TIME_CONSTANT_S)
        if not self.reported and self.share > self.above:
            self.reported = True
            yield _warning(t_ns, source, warning.replace("{share}", f"{self.share:.0%}"))
        elif self.reported and self.share < self.above * CLEARED:
            self.reported = False
            yield _recovered(self, t_ns, source, recovery)


@dataclass
class _Losses:
    """Losses that may come again and again: reported at once, then at most once in `REPEATED_S`, with their number."""

    words: str
    pending: int = 0
    told_ns: int | None = None

    def events(self, t_ns: int, number: int) -> Iterator[Event]:
        """Take the number of losses since the last call; report what is due."""
        self.pending += number
        if self.told_ns is None or t_ns - self.told_ns >= REPEATED_S * 1e9:
            yield from self.rest(t_ns)

    def rest(self, t_ns: int) -> Iterator[Event]:
        """Report what has not been reported."""
        if self.pending:
            yield _warning(t_ns, "card", f"{self.pending} {self.words}")
            self.told_ns, self.pending = t_ns, 0


class HealthMonitor:
    """Monitors the recorded rows and reports when a condition begins and when it ends."""

    def __init__(self, config: RigConfig) -> None:
        self._cycle_s = 1 / config.control.rate_hz
        self._frame_s = 1 / config.observation_hz
        self._unmeasured, self._unsolved = _Condition(0.3), _Condition(0.3)
        self._dropping, self._late, self._missing = _Condition(0.3), _Condition(0.3), _Condition(0.05)
        self._wrong_rate, self._interval_s, self._frame_t_ns = _Condition(0.5), self._frame_s, 0
        self._cameras = [(name, _Condition(0.3)) for name in config.cameras] if len(config.cameras) > 1 else []
        self._tip_source = _TRACKER if config.trackers else _CAMERA
        self._counted = dict.fromkeys(DATAGRAM_COUNTS, 0)
        self._drifting = _Condition(DRIFTING)
        self._largest_drift = config.tracker.largest_drift_ppm * 1e-6 if config.tracker is not None else np.inf
        self._sections = [(name, _Condition(0.3)) for name in config.sections]
        self._triggered = {name: 0 for name, camera in config.cameras.items() if camera.trigger is not None}
        self._disk = _Condition(DISK_S)
        self._lost_scans = _Losses("scans were lost: the card's buffer overran, or what it sent was damaged")
        self._damaged_lines = _Losses("damaged lines between computer and card were dropped")
        self._refused, self._not_solved = _Condition(0.3), _Condition(0.3)
        self._checked_ns = 0
        self._suspended_ns: int | None = None

    def samples(self, rows: NDArray[np.void]) -> Iterator[Event]:
        """Events of control cycles (n,) of `runs.records.sample_dtype`, in order of time."""
        for row in rows:
            missed, t_ns = int(row["missed"]), int(row["t_ns"])
            if row["lateness_ns"] > CONTROL_STALL_S * 1e9:
                yield _warning(
                    t_ns,
                    "control",
                    f"control stalled for {row['lateness_ns'] * 1e-9:.2f} s, the valves at their last outputs; "
                    "the pressures return to their set-points within the rate limit",
                )
            yield from self._missing.events(
                t_ns,
                self._cycle_s * (missed + 1),
                missed / (missed + 1),
                "control",
                "{share} of the deadlines are missed: the machine is too busy",
                "deadlines are met again",
            )

    def observations(self, rows: NDArray[np.void]) -> Iterator[Event]:
        """Events of camera frames (n,) of `runs.records.observation_dtype`, in order of time."""
        for row in rows:
            t_ns, seen, dropped = int(row["t_ns"]), DetectionStatus(int(row["seen"])), int(row["dropped"])
            tip_source = self._tip_source
            camera = seen is not DetectionStatus.NO_CAMERA
            age_s = row["age_ns"] * 1e-9
            old = (
                f"{tip_source.items} are {age_s:.2f} s old when they are measured"
                if camera
                else f"predictions are {age_s:.2f} s late"
            )
            judged = (
                (
                    self._unmeasured,
                    float(camera and seen is not DetectionStatus.MEASURED),
                    f"the tip is not measured: {_CAUSES.get(seen, seen.name)}",
                    "the tip is measured again",
                ),
                (
                    self._unsolved,
                    float(not row["model_ok"]),
                    "the model cannot be solved for these pressures: its tip is the last good one",
                    "the model is solved again",
                ),
                (
                    self._dropping,
                    dropped / (dropped + 1),
                    f"{tip_source.source} drops {tip_source.items}",
                    f"all {tip_source.items} of {tip_source.source} come again",
                ),
                (
                    self._late,
                    float(age_s > LATE_S),
                    old,
                    f"{tip_source.items} come in time again" if camera else "predictions come in time again",
                ),
            )
            for condition, part, warning, recovery in judged:
                yield from condition.events(t_ns, self._frame_s * (dropped + 1), part, "observer", warning, recovery)
            if camera:
                yield from self._camera_rate(t_ns, dropped)
            if self._tip_source is _TRACKER and seen is DetectionStatus.MEASURED:
                yield from self._unused_messages(row)
            if self._cameras:
                yield from self._idle_camera(row)
            if self._sections:
                yield from self._unmeasured_section(row)
            if self._triggered:
                yield from self._untriggered(row)

    def _camera_rate(self, t_ns: int, dropped: int) -> Iterator[Event]:
        """Check the camera rate: a driver may set another rate than requested."""
        before_ns, self._frame_t_ns = self._frame_t_ns, t_ns
        if dropped or not before_ns:
            return
        interval_s = (t_ns - before_ns) * 1e-9
        self._interval_s += (interval_s - self._interval_s) * min(1.0, interval_s / SHARE_TIME_CONSTANT_S)
        off = abs(self._interval_s / self._frame_s - 1) > RATE_TOLERANCE
        source = self._tip_source.source
        yield from self._wrong_rate.events(
            t_ns,
            self._frame_s,
            float(off),
            "observer",
            f"{source} gives {1 / self._interval_s:.1f} {self._tip_source.items} a second and the rig says "
            f"{1 / self._frame_s:g}: set `rate_hz` to what {source} can do",
            f"{source} keeps its pace again",
        )

    def _unused_messages(self, row: NDArray[np.void]) -> Iterator[Event]:
        """Report each step of the sender's clock, and the first message of each kind that no working sender sends."""
        counts = dict(zip(DATAGRAM_COUNTS, row["datagrams"].tolist(), strict=True))
        before, self._counted = self._counted, counts
        if counts["clock_steps"] > before["clock_steps"]:
            yield _warning(int(row["t_ns"]), "observer", "the clock of the tracker's sender was set, or it restarted")
        yield from self._drifting.events(
            int(row["t_ns"]),
            self._frame_s,
            float(abs(row["clock_drift"]) >= self._largest_drift),
            "observer",
            f"the clock of the tracker's sender drifts by more than largest_drift_ppm, {self._largest_drift * 1e6:g}: "
            "times of poses are less certain; is NTP setting it? State a larger limit in the rig file",
            "the clock of the tracker's sender drifts by less than largest_drift_ppm again",
        )
        for reason in ("malformed", "foreign"):
            if counts[reason] and not before[reason]:
                yield _warning(int(row["t_ns"]), "observer", f"{reason} messages reach the tracker's port; not used")

    def _unmeasured_section(self, row: NDArray[np.void]) -> Iterator[Event]:
        """Report a section of the arm that is not measured."""
        t_ns, dropped = int(row["t_ns"]), int(row["dropped"])
        period_s = self._frame_s * (dropped + 1)
        for (name, condition), seen in zip(self._sections, row["section_seen"], strict=True):
            why = _CAUSES.get(DetectionStatus(seen), DetectionStatus(seen).words)
            unmeasured = float(seen != DetectionStatus.MEASURED)
            warning, recovery = f"section {name} is not measured: {why}", f"section {name} is measured again"
            yield from condition.events(t_ns, period_s, unmeasured, "observer", warning, recovery)

    def _untriggered(self, row: NDArray[np.void]) -> Iterator[Event]:
        """Report the first picture of each camera that no pulse of the trigger began."""
        for (name, before), count in zip(self._triggered.items(), row["untriggered"].tolist(), strict=True):
            if count and not before:
                message = f"camera {name} gives pictures that no trigger pulse begins: is it set to external trigger?"
                yield _warning(int(row["t_ns"]), "observer", f"{message} They are not used")
            self._triggered[name] = max(before, count)

    def _idle_camera(self, row: NDArray[np.void]) -> Iterator[Event]:
        """Report a camera that contributes nothing: the tip is then measured by the others."""
        t_ns, dropped = int(row["t_ns"]), int(row["dropped"])
        period_s = self._frame_s * (dropped + 1)
        for (name, condition), seen, skew in zip(self._cameras, row["camera_seen"], row["camera_skew_s"], strict=True):
            if np.isnan(skew):
                why = "gives no pictures"
            elif seen == DetectionStatus.NO_FRAME:
                why = "adds nothing: its pictures repeat, or too many are dropped to estimate motion"
            else:
                why = f"adds nothing: {_CAUSES.get(DetectionStatus(seen), DetectionStatus(seen).name)}"
            unmeasured = float(seen != DetectionStatus.MEASURED)
            warning, recovery = (
                f"camera {name} {why}; the tip is measured without it",
                f"camera {name} sees the board again",
            )
            yield from condition.events(t_ns, period_s, unmeasured, "observer", warning, recovery)

    def plans(self, rows: NDArray[np.void]) -> Iterator[Event]:
        """Events of plans (n,) of `runs.records.tip_control_dtype`, in order of time."""
        for row in rows:
            t_ns, status = int(row["t_ns"]), SolveStatus(int(row["status"]))
            judged = (
                (self._refused, status.refused, f"plans are refused: {status.words}"),
                (
                    self._not_solved,
                    status is SolveStatus.NOT_SOLVED,
                    "the solver finds no plan: the ones before are continued",
                ),
            )
            for condition, affected, message in judged:
                yield from condition.events(
                    t_ns, self._frame_s, float(affected), "tip controller", message, "plans are followed again"
                )

    def pulses(self, rows: NDArray[np.void]) -> Iterator[Event]:
        """Events of pulses (n,) of `runs.records.pulse_dtype`, in order of time."""
        for row in rows[rows["skipped"] > 0]:
            yield _warning(
                int(row["t_ns"]),
                "control",
                f"{row['skipped']} pulses of the camera trigger were left out: control was late",
            )

    def lost(self, t_ns: int, scans: int) -> Iterator[Event]:
        """Event of scans that the cards have dropped since the last call; called also without any."""
        return self._lost_scans.events(t_ns, scans)

    def damaged(self, t_ns: int, lines: int) -> Iterator[Event]:
        """Event of damaged lines between computer and cards since the last call; called also without any."""
        return self._damaged_lines.events(t_ns, lines)

    def rest(self, t_ns: int) -> Iterator[Event]:
        """Events of the losses that are not reported yet, at the end of a run."""
        yield from self._lost_scans.rest(t_ns)
        yield from self._damaged_lines.rest(t_ns)

    def supervisor_stall(self, t_ns: int) -> Iterator[Event]:
        """Report when the last call was long ago; called in every cycle of the supervisor."""
        before, self._checked_ns = self._checked_ns, t_ns
        still_s = (t_ns - before) * 1e-9
        if before and still_s > STALL_S:
            yield _warning(
                t_ns,
                "supervisor",
                f"nothing was recorded for {still_s:.2f} s, all measurements were kept: the machine may have stalled",
            )

    def suspension(self, t_ns: int, suspended_ns: int) -> Iterator[Event]:
        """Report a suspension of the computer since the last call; `suspended_ns` is the time in suspension so far."""
        before, self._suspended_ns = self._suspended_ns, suspended_ns
        if before is not None and suspended_ns - before > SUSPENSION_S * 1e9:
            yield _warning(
                t_ns,
                "supervisor",
                f"the computer was suspended for {(suspended_ns - before) * 1e-9:.1f} s, the valves at their last "
                "outputs; times of the record do not count this",
            )

    def disk(self, t_ns: int, standing_s: float) -> Iterator[Event]:
        """Report when writes to the disk have been blocked for long, and when they continue; called in every cycle."""
        if standing_s > self._disk.above:
            if not self._disk.reported:
                self._disk.reported, self._disk.since_ns = True, t_ns - round(standing_s * 1e9)
                yield _warning(
                    t_ns,
                    "supervisor",
                    f"the disk has not taken the record for {standing_s:.1f} s, which is kept in memory meanwhile: "
                    "is another program writing to it?",
                )
        elif self._disk.reported:
            self._disk.reported = False
            yield _recovered(self._disk, t_ns, "supervisor", "the disk takes the record again")


def _warning(t_ns: int, source: str, message: str) -> Event:
    return Event(t_ns, Level.WARNING, source, f"{message}; the run continues")


def _recovered(condition: _Condition, t_ns: int, source: str, message: str) -> Event:
    return Event(t_ns, Level.INFO, source, f"{message}, after {(t_ns - condition.since_ns) * 1e-9:.2f} s")
