"""Health monitor: warnings to the operator during a run, such as an unmeasured tip, an unsolved model or lost data.

No such condition moves a valve, so none stops the run: the record marks the affected rows and the operator decides.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from rig.config.schema import RigConfig
from rig.hardware.bench import DRIVER_CALLS
from rig.hardware.trackers.base import other_sender
from rig.realtime.repeated_warnings import SHARE_TIME_CONSTANT_S, Condition, LossWarning, RepeatedWarning, warning_event
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
FORGOTTEN = 0.9
"""What a late cycle leaves of the weight of the ones before."""
LEAST_SLOW = 0.5
"""Slow calls for each late cycle from which they, not the machine, are the cause."""

_CAUSES = {
    DetectionStatus.NO_BOARD: "no board in the picture: light, lens cap, something before the camera?",
    DetectionStatus.AMBIGUOUS: "the board's orientation is ambiguous (half a turn), or the board is cut off",
    DetectionStatus.POOR_FIT: "the board's corners do not fit a plane board",
    DetectionStatus.NO_FRAME: "the camera repeats the same picture bit for bit: it is frozen, or delivers old pictures",
    DetectionStatus.NO_POSE: "the tracker does not see the body: is it covered or out of its range?",
    DetectionStatus.NO_MESSAGE: "no message of the tracker comes in time: does the sender run?",
    DetectionStatus.DISAGREE: "the cameras contradict each other: was one moved, or is its calibration another's?",
}


class HealthMonitor:
    """Monitors the recorded rows and reports when a condition begins and when it ends."""

    def __init__(self, config: RigConfig, start_ns: int = 0) -> None:
        """Times in messages count from `start_ns`."""
        self._start_ns = start_ns
        self._repeated: list[RepeatedWarning] = []
        self._cycle_s = 1 / config.control.rate_hz
        self._frame_s = 1 / config.observation_hz
        self._tip_source, self._items = ("the tracker", "poses") if config.trackers else ("the camera", "pictures")
        self._unmeasured, self._unsolved = self._condition(0.3), self._condition(0.3)
        self._dropping, self._late = self._condition(0.3), self._condition(0.3)
        self._missing = self._condition(0.05, "control")
        self._wrong_rate, self._interval_s, self._frame_t_ns = self._condition(0.5), self._frame_s, 0
        cameras = config.cameras if len(config.cameras) > 1 else ()
        self._cameras = [(name, self._condition(0.3)) for name in cameras]
        self._counted = dict.fromkeys(DATAGRAM_COUNTS, 0)
        self._clock_steps = self._warning("observer")
        self._drifting = self._condition(DRIFTING)
        self._largest_drift = None if config.tracker is None else config.tracker.largest_drift_ppm * 1e-6
        self._sections = [(name, self._condition(0.3)) for name in config.sections]
        self._inputs = [(name, self._condition(0.05, "card")) for name in config.inputs]
        self._triggered = {name: 0 for name, camera in config.cameras.items() if camera.trigger is not None}
        self._disk = self._condition(DISK_S, "supervisor")
        self._lost_scans = self._losses("scans were lost: the card's buffer overran, or what it sent was damaged")
        self._damaged_lines = self._losses("damaged lines between computer and card were dropped")
        self._repeated_scans = self._losses("scans came twice from the driver of a card, and were left out")
        self._drivers = _DriverTimes(config)
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

    def _losses(self, words: str, source: str = "card") -> LossWarning:
        self._repeated.append(losses := LossWarning(source, words, self._start_ns))
        return losses

    def samples(self, rows: NDArray[np.void]) -> Iterator[Event]:
        """Events of control cycles (n,) of `runs.records.sample_dtype`, in order of time."""
        for row in rows:
            missed, t_ns, late_s = int(row["missed"]), int(row["t_ns"]), row["lateness_ns"] * 1e-9
            if missed or late_s > CONTROL_STALL_S:
                self._drivers.missed()
            stall = (
                f"control stalled for {late_s:.2f} s{self._drivers.cause}, the valves at their last outputs; "
                "the pressures return to their set-points within the rate limit"
            )
            yield from self._control_stalls.events(t_ns, stall if late_s > CONTROL_STALL_S else "")
            yield from self._missing.row(
                t_ns,
                self._cycle_s * (missed + 1),
                missed / (missed + 1),
                f"{{share}} of the deadlines are missed{self._drivers.cause or self._drivers.otherwise}",
                "deadlines are met again",
            )
            for (name, condition), value in zip(self._inputs, row["aux"] if self._inputs else (), strict=True):
                warning = f"input {name} is outside its span_V and recorded as NaN: is the sensor or its wire broken?"
                recovery = f"input {name} is inside its span_V again"
                yield from condition.row(t_ns, self._cycle_s, float(np.isnan(value)), warning, recovery)

    def slow_calls(self, number: int, call: int, card: int, took_ns: int) -> None:
        """Take the number of control cycles with a slow call into a driver since the last one, and the last such call.

        Called before the rows of these cycles are passed to `samples`; `card` is -1 for several.
        """
        self._drivers.slow(number, call, card, took_ns)

    def observations(self, rows: NDArray[np.void]) -> Iterator[Event]:
        """Events of camera frames (n,) of `runs.records.observation_dtype`, in order of time."""
        for row in rows:
            yield from self._tip(row)
            if row["seen"] != DetectionStatus.NO_CAMERA:
                yield from self._rate(int(row["t_ns"]), int(row["dropped"]))
            if self._largest_drift is not None and row["seen"] == DetectionStatus.MEASURED:
                yield from self._sender(row, self._largest_drift)
            if self._cameras:
                yield from self._idle_camera(row)
            if self._sections:
                yield from self._unmeasured_section(row)
            if self._triggered:
                yield from self._untriggered(row)

    def _tip(self, row: NDArray[np.void]) -> Iterator[Event]:
        """Report a tip that is not measured, not predicted, or late, and dropped pictures."""
        t_ns, seen, dropped = int(row["t_ns"]), DetectionStatus(int(row["seen"])), int(row["dropped"])
        source, items, age_s, period_s = self._tip_source, self._items, row["age_ns"] * 1e-9, self._period_s(row)
        unmeasured = seen not in (DetectionStatus.MEASURED, DetectionStatus.NO_CAMERA)
        warning = f"the tip is not measured: {_cause(seen)}"
        yield from self._unmeasured.row(t_ns, period_s, float(unmeasured), warning, "the tip is measured again")
        warning = "the model cannot be solved for these pressures: its tip is the last good one"
        yield from self._unsolved.row(t_ns, period_s, float(not row["model_ok"]), warning, "the model is solved again")
        warning, recovery = f"{source} drops {items}", f"all {items} of {source} come again"
        yield from self._dropping.row(t_ns, period_s, dropped / (dropped + 1), warning, recovery)
        warning, recovery = f"{items} are {age_s:.2f} s old when they are measured", f"{items} come in time again"
        if seen is DetectionStatus.NO_CAMERA:
            warning, recovery = f"predictions are {age_s:.2f} s late", "predictions come in time again"
        yield from self._late.row(t_ns, period_s, float(age_s > LATE_S), warning, recovery)

    def _period_s(self, row: NDArray[np.void]) -> float:
        """Time that a frame stands for, with those that were dropped before it."""
        return self._frame_s * (int(row["dropped"]) + 1)

    def _rate(self, t_ns: int, dropped: int) -> Iterator[Event]:
        """Check the rate of the frames: a driver may set another rate than requested."""
        before_ns, self._frame_t_ns = self._frame_t_ns, t_ns
        if dropped or not before_ns:
            return
        interval_s = (t_ns - before_ns) * 1e-9
        self._interval_s += (interval_s - self._interval_s) * min(1.0, interval_s / SHARE_TIME_CONSTANT_S)
        off = abs(self._interval_s / self._frame_s - 1) > RATE_TOLERANCE
        source = self._tip_source
        yield from self._wrong_rate.row(
            t_ns,
            self._frame_s,
            float(off),
            f"{source} gives {1 / self._interval_s:.1f} {self._items} a second and the rig says "
            f"{1 / self._frame_s:g}: set `rate_hz` to what {source} can do",
            f"{source} keeps its pace again",
        )

    def _sender(self, row: NDArray[np.void], largest_drift: float) -> Iterator[Event]:
        """Report steps and drift of the sender's clock, and the first message of each kind that is never used."""
        t_ns, counts = int(row["t_ns"]), dict(zip(DATAGRAM_COUNTS, row["datagrams"].tolist(), strict=True))
        before, self._counted = self._counted, counts
        stepped = counts["clock_steps"] > before["clock_steps"]
        message = "the clock of the tracker's sender was set, or it restarted" if stepped else ""
        yield from self._clock_steps.events(t_ns, message)
        yield from self._drifting.row(
            t_ns,
            self._frame_s,
            float(abs(row["clock_drift"]) >= largest_drift),
            f"the clock of the tracker's sender drifts by more than largest_drift_ppm, {largest_drift * 1e6:g}: "
            "times of poses are less certain; is NTP setting it? State a larger limit in the rig file",
            "the clock of the tracker's sender drifts by less than largest_drift_ppm again",
        )
        if counts["malformed"] and not before["malformed"]:
            yield warning_event(t_ns, "observer", "malformed messages reach the tracker's port; not used")
        if counts["foreign"] and not before["foreign"]:
            yield warning_event(t_ns, "observer", f"{other_sender(int(row['foreign_ipv4']))}; they are not used")

    def _unmeasured_section(self, row: NDArray[np.void]) -> Iterator[Event]:
        """Report a section of the arm that is not measured."""
        for (name, condition), seen in zip(self._sections, row["section_seen"], strict=True):
            unmeasured = float(seen != DetectionStatus.MEASURED)
            warning = f"section {name} is not measured: {_cause(DetectionStatus(seen))}"
            recovery = f"section {name} is measured again"
            yield from condition.row(int(row["t_ns"]), self._period_s(row), unmeasured, warning, recovery)

    def _untriggered(self, row: NDArray[np.void]) -> Iterator[Event]:
        """Report the first picture of each camera that no pulse of the trigger began."""
        for (name, before), count in zip(self._triggered.items(), row["untriggered"].tolist(), strict=True):
            if count and not before:
                message = f"camera {name} gives pictures that no trigger pulse begins: is it set to external trigger?"
                yield warning_event(int(row["t_ns"]), "observer", f"{message} They are not used")
            self._triggered[name] = max(before, count)

    def _idle_camera(self, row: NDArray[np.void]) -> Iterator[Event]:
        """Report a camera that contributes nothing: the tip is then measured by the others."""
        for (name, condition), seen, skew in zip(self._cameras, row["camera_seen"], row["camera_skew_s"], strict=True):
            if np.isnan(skew):
                why = "gives no pictures"
            elif seen == DetectionStatus.NO_FRAME:
                why = "adds nothing: its pictures repeat, or too many are dropped to estimate motion"
            else:
                why = f"adds nothing: {_cause(DetectionStatus(seen))}"
            unmeasured = float(seen != DetectionStatus.MEASURED)
            warning = f"camera {name} {why}; the tip is measured without it"
            recovery = f"camera {name} sees the board again"
            yield from condition.row(int(row["t_ns"]), self._period_s(row), unmeasured, warning, recovery)

    def plans(self, rows: NDArray[np.void]) -> Iterator[Event]:
        """Events of plans (n,) of `runs.records.tip_control_dtype`, in order of time."""
        again = "plans are followed again"
        for row in rows:
            t_ns, status = int(row["t_ns"]), SolveStatus(int(row["status"]))
            refused, warning = float(status.refused), f"plans are refused: {status.words}"
            yield from self._refused.row(t_ns, self._frame_s, refused, warning, again)
            unsolved = float(status is SolveStatus.NOT_SOLVED)
            warning = "the solver finds no plan: the ones before are continued"
            yield from self._not_solved.row(t_ns, self._frame_s, unsolved, warning, again)

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

    def repeated(self, t_ns: int, scans: int) -> Iterator[Event]:
        """Event of scans that came twice since the last call; called also without any."""
        return self._repeated_scans.add(t_ns, scans)

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


def _cause(seen: DetectionStatus) -> str:
    """Why nothing was measured, and what to look at."""
    return _CAUSES.get(seen, seen.words)


class _DriverTimes:
    """Whether the drivers of the cards explain the deadlines that are missed: each slow call may cost one or more."""

    def __init__(self, config: RigConfig) -> None:
        self._cards, self._period_ms = list(config.cards), 1e3 / config.control.rate_hz
        self._slow = self._missed = 0.0
        self._words = ""
        own = any(card.driver not in card.registry.built_in for card in config.cards.values())
        self.otherwise = ": the machine is too busy" + (", or a thread of a driver holds the interpreter" * own)
        """What explains them where slow calls do not."""

    def slow(self, number: int, call: int, card: int, took_ns: int) -> None:
        """Take slow calls, and the last of them."""
        self._slow += number
        of = f"card {self._cards[card]}" if card >= 0 else f"the cards {', '.join(self._cards)}"
        period = f"the control period is {self._period_ms:g} ms"
        self._words = f": `{DRIVER_CALLS[call]}` of the driver of {of} takes {took_ns * 1e-6:.1f} ms, {period}"

    def missed(self) -> None:
        """Take a cycle that began late or after missed deadlines."""
        self._missed = FORGOTTEN * self._missed + 1
        self._slow = FORGOTTEN * self._slow

    @property
    def cause(self) -> str:
        """The call that takes too long; empty where slow calls are too few to explain the late cycles."""
        return self._words if self._slow > LEAST_SLOW * self._missed else ""
