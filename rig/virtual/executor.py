"""Executor in virtual time: bit-for-bit reproducible from its seed.

Plant and control run here; a frame pipeline renders and measures the pictures beside them.
"""

from __future__ import annotations

import gc
import itertools
import time
import traceback
from collections import deque
from collections.abc import Iterator, Sequence
from functools import partial
from typing import TYPE_CHECKING

import numpy as np

from rig.control.control_loop import ControlLoop
from rig.execution.plan import OpenRecord, OperatorInterface, RunPlan, StartError, sample_rows
from rig.hardware.bench import Bench
from rig.hardware.cameras.base import CameraError, FrameSet
from rig.hardware.cards.base import CardError
from rig.hardware.driver_calls import TipSourceError
from rig.hardware.safe_state import armed_sentence
from rig.hardware.trackers.base import TrackerReading
from rig.hardware.vent_verification import VentOutcome, VentVerification
from rig.observation.frame_sources import ReadingSequence, silence
from rig.observation.observer import Observer
from rig.observation.picture_recorder import PictureRecorder
from rig.realtime.data_recorder import DataRecorder
from rig.realtime.outcome import Ending, EndOfRun, outcome
from rig.realtime.shared_state import SharedState
from rig.simulator.mock_camera import Exposure, MockCamera
from rig.simulator.mock_tracker import LEAD_S, MockTracker
from rig.simulator.plant import Plant
from rig.tip_control.monitor import SOURCE, TipControlMonitor, failure_message
from rig.virtual import time_limit
from rig.virtual.frame_pipeline import (
    FramePipeline,
    FrameProcessError,
    FrameRequest,
    FrameStages,
    InlineFrames,
    may_fork,
)
from rig.virtual.triggered_exposures import FrameExposures, TriggeredExposures
from runs.records import Event, Level, RunFooter, Status

if TYPE_CHECKING:
    from rig.tip_control.session import TipControlSession
    from runs.journal.journal import JournalWriter

START_NS = 100_000_000
"""Virtual time between power-up and the first cycle, so that the first cycle has scans."""
BATCH_S = 0.1
"""Time between two batches of rows for the record."""
HISTORY_S = 2.0
"""Samples that stay at hand for the next frame."""
FRAMES_IN_FLIGHT = 30
"""Frames in processing while control continues; a fixed number, so that runs are reproducible bit for bit."""
SHOW_S = 0.1
_COUNTERS = ("missed_deadlines", "dropped_frames", "lost_scans")


def run(plan: RunPlan, open_record: OpenRecord, operator: OperatorInterface) -> RunFooter:
    """Run one plan of a rig of mocks in virtual time; return once the (simulated) valves are safe."""
    virtual = _VirtualRun(plan, operator)
    gc.freeze()  # imported objects are not scanned by the garbage collector
    try:
        stages = virtual.stages()
        with FramePipeline(stages) if may_fork() else InlineFrames(stages) as pipeline:
            return virtual.run(pipeline, open_record)
    finally:
        gc.unfreeze()


class _VirtualRun:
    def __init__(self, plan: RunPlan, operator: OperatorInterface) -> None:
        config = plan.config
        self._plan = plan
        self._operator = operator
        self._plant = Plant(config, plan.seed, t0_ns=0)
        cards = {name: self._plant.card(name) for name in config.cards}
        self._bench = Bench(config, cards, lambda: self._plant.t_ns)
        self._cameras = {name: self._camera(name) for name in config.cameras}
        self._memory = SharedState.create(config, len(plan.adapted), shared=False)
        self._memory.start_ns = START_NS
        self._trigger: TriggeredExposures | None = None
        if config.triggered:
            pulses = self._memory.pulses
            self._trigger = TriggeredExposures(config, self._bench, self._plant, self._cameras, pulses)
        self._tracker: MockTracker | None = None
        for name in config.trackers:
            before_ns = START_NS - round(LEAD_S * 1e9)
            self._tracker = MockTracker(config, self._plant, name, plan.seed, self._plant.faults, before_ns)
        self._sequence: ReadingSequence | None = None
        scene = config.simulator.scene if config.simulator else None
        skew_ms = scene.skew_ms if scene else 0.0
        self._skews_ns = [round(k * skew_ms * 1e6) for k in range(len(self._cameras))]
        self._loop = ControlLoop(plan, self._bench)
        self._frame_ns = round(1e9 / config.observation_hz)
        self._delay_ns = round(config.tip_control.delay_ms * 1e6)
        self._frame = -1 if config.trackers or config.triggered else 0
        self._answered = 0
        self._unseen = 0
        rate_hz = config.control.rate_hz
        self._batch_cycles = max(1, round(BATCH_S * rate_hz))
        self._history_cycles = max(1, round(HISTORY_S * rate_hz))
        self._tip_control = _tip_control(plan)
        self._tip_monitor, self._tip_failure = TipControlMonitor(), ""
        self._exposed: deque[tuple[int, float]] = deque()
        """Times of the frames that wait for the tip controller: of the exposure [ns], and in the protocol [s]."""
        self._shown = 0.0
        self._vents = False
        """True where the end of the run vents every valve, also those that the rig holds."""
        self._journal: JournalWriter
        self._record: DataRecorder
        self._pipeline: FramePipeline | InlineFrames

    def _camera(self, name: str) -> MockCamera:
        config, plant = self._plan.config, self._plant
        trigger = config.cameras[name].trigger
        edges = None if trigger is None else plant.card(trigger.card).rise
        return MockCamera(config, plant, name, self._plan.seed, plant.faults, edges)

    def stages(self) -> FrameStages:
        """The stages of the frame pipeline of this run."""
        plan = self._plan
        adapted = [quantity.name for quantity in plan.adapted]
        observer = Observer(plan.config, plan.variant, adapted, plan.trajectory.tip)
        cameras = tuple(self._cameras.values())
        return FrameStages(cameras, observer, PictureRecorder(plan.config), sample_rows(plan.config))

    def run(self, pipeline: FramePipeline | InlineFrames, open_record: OpenRecord) -> RunFooter:
        """Arm, run cycles until the run ends, write the safe state."""
        self._pipeline = pipeline
        ending: Ending | None = None
        unsafe = ""
        try:
            with self._bench.armed(vent=lambda: self._vents) as unverified:
                self._plant.advance(START_NS)
                self._journal = open_record(START_NS)
                self._record = DataRecorder(
                    self._plan, self._memory, self._journal, self._operator, START_NS, lambda: self._plant.t_ns
                )
                self._event(START_NS, Level.INFO, "control", armed_sentence(len(unverified)))
                now, ending = self._cycles()
        except CardError as error:
            if ending is None:
                raise
            unsafe = str(error)
        self._receive_all_but(0)
        self._record.finish()
        ended = outcome(ending, EndOfRun(partial(self._vented, now), unsafe=unsafe), partial(self._event, now))
        counters = self._record.counters()
        shown = {name: counters[name] for name in _COUNTERS if name in counters}
        return RunFooter(now, *ended.aborted(self._record.failure), shown)

    def _cycles(self) -> tuple[int, Ending]:
        """Run cycles until the run ends; return when, and how."""
        cycle, now = 0, START_NS
        try:
            while (ending := self._cycle(cycle, now)) is None:
                cycle += 1
                now = START_NS + cycle * self._loop.period_ns
        except (CardError, TipSourceError, FrameProcessError) as error:
            source = "control" if isinstance(error, CardError) else "observer"
            self._event(now, Level.FAULT, source, str(error))
            for note in getattr(error, "__notes__", ()):
                self._journal.event(Event(now, Level.FAULT, source, note))
            ending = Ending(Status.ABORTED, str(error))
        return now, ending

    def _vented(self, now: int) -> VentOutcome:
        """Watch the chambers vent from the time of the safe state."""

        def clock() -> Iterator[float]:
            for t_ns in itertools.count(now, self._loop.period_ns):
                self._plant.advance(t_ns)
                yield t_ns * 1e-9

        return VentVerification(self._plan.config, self._bench, vent=self._vents, since_ns=now).outcome(clock())

    def _cycle(self, cycle: int, now: int) -> Ending | None:
        """Run one cycle and its frames; return how the run ends, None while it continues."""
        self._plant.set_tip_weight(self._plan.trajectory.weight_kg(self._loop.position.protocol_s))
        self._plant.advance(now)
        if self._trigger is not None:
            self._trigger.cycle(cycle)
        row, trip = self._loop.cycle(cycle, now, 1, self._answered, False, 0, 0)
        self._memory.samples.push(row)
        self._memory.lost_scans, self._memory.protocol_s = self._loop.readings.lost, self._loop.position.protocol_s
        self._unseen = min(self._unseen + 1, self._history_cycles)
        if self._tracker is not None:
            self._follow(self._tracker, now)
        for exposed in () if self._tracker is not None else self._exposures(now):
            self._observe(exposed, float(row["protocol_s"]))
            if self._tip_control is not None:
                self._exposed.append((exposed.t_ns, float(row["protocol_s"]) - (now - exposed.t_ns) * 1e-9))
        if self._tip_control is not None:
            self._steer(self._tip_control, now)
        if self._plan.controls_tip:
            source = self._loop.setpoint_source
            for event in self._tip_monitor.events(now, float(row["protocol_s"]), source, self._tip_failure):
                self._record.report(event)
        if trip is not None:
            self._vents = trip.vent
            self._event(now, Level.FAULT, "control", trip.message)
            return Ending(Status.ABORTED, trip.message).aborted(self._tip_monitor.loss)
        if self._loop.finished:
            self._record.drain()
            return Ending(Status.FINISHED, self._tip_monitor.message(self._record.totals.plans))
        if self._loop.position.waiting and self._answered == self._loop.position.prompts_passed:
            message = self._plan.trajectory.prompts[self._answered].message
            self._answered += 1
            self._event(now, Level.INFO, "operator", f"done (virtual time answers by itself): {message}")
        if cycle % self._batch_cycles == self._batch_cycles - 1:
            self._receive_all_but(FRAMES_IN_FLIGHT)
            self._record.drain()
            if failure := self._record.failure:
                return Ending(Status.ABORTED, failure)
            if time.monotonic() - self._shown > SHOW_S:
                self._shown = time.monotonic()
                if reason := self._operator.stop_requested():
                    return Ending(Status.INTERRUPTED, reason)
                self._operator.show(self._record.progress())
        return None

    def _follow(self, tracker: MockTracker, now: int) -> None:
        """Pass the tracker's readings on as they arrive, and the times at which it is silent."""
        if self._sequence is None:
            # What the sender sent before the run has given its clock.
            tracker.readings(now - 1)
            self._sequence = ReadingSequence(self._plan.config, now)
        readings = [reading for reading in tracker.readings(now) if reading.t_ns >= START_NS]
        frame_sets = [self._sequence.take(reading, now) for reading in readings]
        while (empty := self._sequence.overdue(now)) is not None:
            tracker.pass_over(empty.t_ns)
            frame_sets.append(empty)
        for frame_set in frame_sets:
            self._submit_reading(frame_set)
        if self._sequence.silent_s(now) > self._plan.config.limits.no_tip_s:
            (name,) = self._plan.config.trackers
            raise silence(name, self._plan.config.limits.no_tip_s, tracker.counts())

    def _submit_reading(self, frame_set: FrameSet) -> None:
        """Pass a frame set of the tracker to the pipeline, with the protocol time of the cycle before it."""
        history = self._memory.samples.last(self._history_cycles)
        latest = history[max(0, int(history["t_ns"].searchsorted(frame_set.t_ns, side="right")) - 1)]
        self._submit(frame_set.index, frame_set.t_ns, float(latest["protocol_s"]), reading=frame_set.reading)
        if self._tip_control is not None:
            since_s = (history["t_ns"] - frame_set.t_ns) * 1e-9
            self._exposed.append((frame_set.t_ns, float(np.interp(0.0, since_s, history["protocol_s"]))))

    def _submit(
        self,
        index: int,
        t_ns: int,
        protocol_s: float,
        exposures: Sequence[Exposure | None] = (),
        reading: TrackerReading | None = None,
    ) -> None:
        """Pass a frame set to the pipeline, with the samples since the last one."""
        dropped = max(0, index - self._frame - 1) if self._frame >= 0 else 0
        self._frame = index
        rows, self._unseen = self._memory.samples.last(self._unseen).tobytes(), 0
        weight_kg = self._plan.trajectory.weight_kg(protocol_s)
        self._pipeline.submit(FrameRequest(index, t_ns, rows, protocol_s, weight_kg, dropped, exposures, reading))

    def _exposures(self, now: int) -> Iterator[FrameExposures]:
        """Expose the frames that are due, in the order of cycles."""
        if self._trigger is not None:
            yield from self._trigger.finished(now)
            return
        # A frame is processed once there are samples before and after its time, and the last camera has exposed.
        late_ns = max((camera.stamped_after_ns for camera in self._cameras.values()), default=0)
        while (t_ns := START_NS + (self._frame + 1) * self._frame_ns) + max(self._skews_ns, default=0) + late_ns <= now:
            exposures: list[Exposure | None] = []
            failures = []
            for camera, skew_ns in zip(self._cameras.values(), self._skews_ns, strict=True):
                try:
                    exposures.append(camera.expose(self._frame + 1, t_ns + skew_ns))
                except CameraError as error:
                    exposures.append(None)
                    failures.append(error)
            yield FrameExposures(self._frame + 1, t_ns + late_ns, exposures, failures)

    def _observe(self, exposed: FrameExposures, protocol_s: float) -> None:
        """Pass a frame to the pipeline that renders and measures it."""
        failures = exposed.failures
        if failures and len(exposed.exposures) - len(failures) < self._plan.config.limits.least_cameras:
            raise failures[0]
        self._submit(exposed.index, exposed.t_ns, protocol_s, exposures=exposed.exposures)

    def _steer(self, controller: TipControlSession, now: int) -> None:
        """Give the controller each frame once its delay has passed, and the control loop the plan."""
        while self._exposed and self._exposed[0][0] + self._delay_ns <= now:
            _, protocol_s = self._exposed.popleft()
            self._receive()
            samples = self._memory.samples.last(round(HISTORY_S * 1e9 / self._loop.period_ns))
            try:
                with time_limit.time_limit(time_limit.LONGEST_CALL_S):
                    found = controller.step(self._memory.observations.last(1)[0], protocol_s, samples)
            except (Exception, SystemExit) as error:
                # It may be code of the user. As in real time the run continues without it.
                self._tip_control, self._tip_failure = None, failure_message(error)
                self._journal.event(Event(now, Level.WARNING, SOURCE, traceback.format_exc()))
                return
            if found is not None:
                row = self._loop.take_plan(*found)
                self._memory.plans.push(row)

    def _receive(self) -> None:
        """Wait for the result of the oldest frame in flight."""
        result = self._pipeline.result()
        memory = self._memory
        memory.observations.push(np.frombuffer(result.observation, memory.observations.dtype)[0])
        if result.adaptation is not None:
            memory.adaptations.push(np.frombuffer(result.adaptation, memory.adaptations.dtype)[0])
        for picture in result.pictures:
            self._record.picture(picture)

    def _receive_all_but(self, in_flight: int) -> None:
        while self._pipeline.in_flight > in_flight:
            self._receive()

    def _event(self, t_ns: int, level: Level, source: str, message: str) -> None:
        self._record.report(Event(t_ns, level, source, message))


def _tip_control(plan: RunPlan) -> TipControlSession | None:
    """The tip controller, if the run has one: it takes a solver and the model's kernels.

    Raises:
        StartError: the controller fails before the run begins.
    """
    if not plan.controls_tip:
        return None
    from rig.tip_control.session import TipControlSession

    try:
        with time_limit.time_limit(time_limit.WARM_UP_S):
            session = TipControlSession(plan)
            session.warm_up()
    except (Exception, SystemExit) as error:
        raise StartError(failure_message(error)) from error
    return session
