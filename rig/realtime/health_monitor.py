"""Health monitor: warnings to the operator during a run, such as an unmeasured tip, an unsolved model or lost data.

No such condition moves a valve, so none stops the run: the record marks the affected rows and the operator decides.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from rig.config.schema import RigConfig
from rig.realtime.repeated_warnings import SHARE_TIME_CONSTANT_S, Condition, Losses, RepeatedWarning
from runs.records import DATAGRAM_COUNTS, DetectionStatus, Event, SolveStatus

LATE_S = 0.25
RATE_TOLERANCE = 0.05
"""Largest relative error of the camera rate."""
DRIFTING = 0.99
"""At the start a jitter takes the drift to its limit for a few seconds; longer, the clock drifts so fast."""
STALL_S = 0.5
SUSPENSION_S = 0.1
CONTROL_STALL_S = 0.1
DISK_S = 2.0

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


class HealthMonitor:
    """Monitors the recorded rows and reports when a condition begins and when it ends."""

    def __init__(self, config: RigConfig, start_ns: int = 0) -> None:
        """Times in messages count from `start_ns`."""
        self._start_ns = start_ns
        self._repeated: list[Condition | RepeatedWarning] = []
        self._cycle_s = 1 / config.control.rate_hz
        self._frame_s = 1 / config.observation_hz
        self._unmeasured, self._unsolved = self._condition(0.3), self._condition(0.3)
        self._dropping, self._late = self._condition(0.3), self._condition(0.3)
        self._missing = self._condition(0.05, "control")
        self._wrong_rate, self._interval_s, self._frame_t_ns = self._condition(0.5), self._frame_s, 0
        cameras = config.cameras if len(config.cameras) > 1 else ()
        self._cameras = [(name, self._condition(0.3)) for name in cameras]
        self._tip_source = _TRACKER if config.trackers else _CAMERA
        self._counted = dict.fromkeys(DATAGRAM_COUNTS, 0)
        self._clock_steps = self._warning("observer")
        self._drifting = self._condition(DRIFTING)
        self._largest_drift = config.tracker.largest_drift_ppm * 1e-6 if config.tracker is not None else np.inf
        self._sections = [(name, self._condition(0.3)) for name in config.sections]
        self._inputs = [(name, self._condition(0.05, "card")) for name in config.inputs]
        self._triggered = {name: 0 for name, camera in config.cameras.items() if camera.trigger is not None}
        self._disk = self._condition(DISK_S, "supervisor")
        self._lost_scans = self._losses("scans were lost: the card's buffer overran, or what it sent was damaged")
        self._damaged_lines = self._losses("damaged lines between computer and card were dropped")
        self._lost_pulses = self._losses("pulses of the camera trigger were left out: control was late", "control")
        self._refused, self._not_solved = (self._condition(0.3, "tip controller") for _ in range(2))
        self._control_stalls, self._stalls = self._warning("control"), self._warning("supervisor")
        self._suspensions = self._warning("supervisor")
        self._checked_ns = 0
        self._suspended_ns: int | None = None

    def _condition(self, above: float, source: str = "observer") -> Condition:
        self._repeated.append(condition := Condition(above, source, self._start_ns))
        return condition

    def _warning(self, source: str) -> RepeatedWarning:
        self._repeated.append(warning := RepeatedWarning(source, self._start_ns))
        return warning

    def _losses(self, words: str, source: str = "card") -> Losses:
        self._repeated.append(losses := Losses(source, words, self._start_ns))
        return losses

    def samples(self, rows: NDArray[np.void]) -> Iterator[Event]:
        """Events of control cycles (n,) of `runs.records.sample_dtype`, in order of time."""
        for row in rows:
            missed, t_ns = int(row["missed"]), int(row["t_ns"])
            stall = ""
            if row["lateness_ns"] > CONTROL_STALL_S * 1e9:
                stall = (
                    f"control stalled for {row['lateness_ns'] * 1e-9:.2f} s, the valves at their last outputs; "
                    "the pressures return to their set-points within the rate limit"
                )
            yield from self._control_stalls.events(t_ns, stall)
            yield from self._missing.events(
                t_ns,
                self._cycle_s * (missed + 1),
                missed / (missed + 1),
                "{share} of the deadlines are missed: the machine is too busy",
                "deadlines are met again",
            )
            if self._inputs:
                yield from self._input_outside(row)

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
                yield from condition.events(t_ns, self._frame_s * (dropped + 1), part, warning, recovery)
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
            f"{source} gives {1 / self._interval_s:.1f} {self._tip_source.items} a second and the rig says "
            f"{1 / self._frame_s:g}: set `rate_hz` to what {source} can do",
            f"{source} keeps its pace again",
        )

    def _unused_messages(self, row: NDArray[np.void]) -> Iterator[Event]:
        """Report each step of the sender's clock, and the first message of each kind that no working sender sends."""
        counts = dict(zip(DATAGRAM_COUNTS, row["datagrams"].tolist(), strict=True))
        before, self._counted = self._counted, counts
        stepped = counts["clock_steps"] > before["clock_steps"]
        message = "the clock of the tracker's sender was set, or it restarted" if stepped else ""
        yield from self._clock_steps.events(int(row["t_ns"]), message)
        yield from self._drifting.events(
            int(row["t_ns"]),
            self._frame_s,
            float(abs(row["clock_drift"]) >= self._largest_drift),
            f"the clock of the tracker's sender drifts by more than largest_drift_ppm, {self._largest_drift * 1e6:g}: "
            "times of poses are less certain; is NTP setting it? State a larger limit in the rig file",
            "the clock of the tracker's sender drifts by less than largest_drift_ppm again",
        )
        for reason in ("malformed", "foreign"):
            if counts[reason] and not before[reason]:
                message = f"{reason} messages reach the tracker's port; not used"
                yield from RepeatedWarning("observer", self._start_ns).events(int(row["t_ns"]), message)

    def _input_outside(self, row: NDArray[np.void]) -> Iterator[Event]:
        """Report an auxiliary input whose voltage is outside its span."""
        for (name, condition), value in zip(self._inputs, row["aux"], strict=True):
            warning = f"input {name} is outside its span_V and recorded as NaN: is the sensor or its wire broken?"
            outside, recovery = float(np.isnan(value)), f"input {name} is inside its span_V again"
            yield from condition.events(int(row["t_ns"]), self._cycle_s, outside, warning, recovery)

    def _unmeasured_section(self, row: NDArray[np.void]) -> Iterator[Event]:
        """Report a section of the arm that is not measured."""
        t_ns, dropped = int(row["t_ns"]), int(row["dropped"])
        period_s = self._frame_s * (dropped + 1)
        for (name, condition), seen in zip(self._sections, row["section_seen"], strict=True):
            why = _CAUSES.get(DetectionStatus(seen), DetectionStatus(seen).words)
            unmeasured = float(seen != DetectionStatus.MEASURED)
            warning, recovery = f"section {name} is not measured: {why}", f"section {name} is measured again"
            yield from condition.events(t_ns, period_s, unmeasured, warning, recovery)

    def _untriggered(self, row: NDArray[np.void]) -> Iterator[Event]:
        """Report the first picture of each camera that no pulse of the trigger began."""
        for (name, before), count in zip(self._triggered.items(), row["untriggered"].tolist(), strict=True):
            if count and not before:
                message = f"camera {name} gives pictures that no trigger pulse begins: is it set to external trigger?"
                message = f"{message} They are not used"
                yield from RepeatedWarning("observer", self._start_ns).events(int(row["t_ns"]), message)
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
            yield from condition.events(t_ns, period_s, unmeasured, warning, recovery)

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
                yield from condition.events(t_ns, self._frame_s, float(affected), message, "plans are followed again")

    def pulses(self, rows: NDArray[np.void]) -> Iterator[Event]:
        """Events of pulses (n,) of `runs.records.pulse_dtype`, in order of time."""
        for row in rows:
            yield from self._lost_pulses.add(int(row["t_ns"]), int(row["skipped"]))

    def lost(self, t_ns: int, scans: int) -> Iterator[Event]:
        """Event of scans that the cards have dropped since the last call; called also without any."""
        return self._lost_scans.add(t_ns, scans)

    def damaged(self, t_ns: int, lines: int) -> Iterator[Event]:
        """Event of damaged lines between computer and cards since the last call; called also without any."""
        return self._damaged_lines.add(t_ns, lines)

    def rest(self, t_ns: int) -> Iterator[Event]:
        """Events of what has repeated and is not reported yet, at the end of a run."""
        for repeated in self._repeated:
            yield from repeated.rest(t_ns)

    def supervisor_stall(self, t_ns: int) -> Iterator[Event]:
        """Report when the last call was long ago; called in every cycle of the supervisor."""
        before, self._checked_ns = self._checked_ns, t_ns
        still_s, message = (t_ns - before) * 1e-9, ""
        if before and still_s > STALL_S:
            message = (
                f"nothing was recorded for {still_s:.2f} s, all measurements were kept: the machine may have stalled"
            )
        return self._stalls.events(t_ns, message)

    def suspension(self, t_ns: int, suspended_ns: int) -> Iterator[Event]:
        """Report a suspension of the computer since the last call; `suspended_ns` is the time in suspension so far."""
        before, self._suspended_ns = self._suspended_ns, suspended_ns
        message = ""
        if before is not None and suspended_ns - before > SUSPENSION_S * 1e9:
            message = (
                f"the computer was suspended for {(suspended_ns - before) * 1e-9:.1f} s, the valves at their last "
                "outputs; times of the record do not count this"
            )
        return self._suspensions.events(t_ns, message)

    def disk(self, t_ns: int, standing_s: float) -> Iterator[Event]:
        """Report when writes to the disk have been blocked for long, and when they continue; called in every cycle."""
        standing = standing_s > self._disk.above
        if standing and not self._disk.active:
            self._disk.since_ns = t_ns - round(standing_s * 1e9)
        return self._disk.changed(
            t_ns,
            standing,
            f"the disk has not taken the record for {standing_s:.1f} s, which is kept in memory meanwhile: "
            "is another program writing to it?",
            "the disk takes the record again",
        )
