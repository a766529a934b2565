"""The source for a running experiment. It reads the shared memory and keeps a decimated history; it uses no files."""

from __future__ import annotations

import os
import threading
import time
from concurrent.futures import Future, ThreadPoolExecutor
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from model.arrays import Array
from model.units import MM_PER_M, PA_PER_BAR
from rig.execution.plan import StartError
from rig.live.client_session import ClientSession, connect
from rig.live.packets import (
    EstimateView,
    History,
    PressureView,
    ProtocolView,
    RunDescription,
    SectionView,
    TimingView,
    TipView,
    ViewOverlay,
    ViewState,
    ViewUpdate,
    estimates,
    inputs,
    jpeg,
    lateness_cycles,
    path_error,
    sections,
)
from rig.realtime.operator_commands import CommandKind
from rig.realtime.run_totals import RunTotals
from rig.realtime.shared_state import Stage
from runs.columns.tip_control import reference_error_mm
from runs.records import DetectionStatus, Event, Status

CHART_DECIMATION = 10
"""Control cycles per row of the pressure chart."""
EVENTS_KEPT = 500
OBSERVATIONS_KEPT = 64
"""A picture is shown with the row of its frame, which is some frames old when the picture is encoded."""
CONNECT_EVERY_S = 0.1
WATCH_EVERY_S = 1.0
IDLE_PACKET_S = 0.2
"""A packet is due after this time even without a new camera frame."""
FAR = float("-inf")
LOWEST_NICENESS = 19


class LiveRun:
    """Data of a running experiment in the form that the page needs.

    A run has a control socket once it begins; simulation and compilation may delay that.
    """

    session: ClientSession
    pressure: History

    def __init__(self, path: Path) -> None:
        """Follow the run with this control socket."""
        self._path = path
        self._connected = False
        self._last_attempt_s = 0.0
        self.viewers = 0
        self.track = History(12)
        self.events: list[Event] = []
        self.events_dropped = 0
        self.ended = ""
        self.start_ns = 0
        self.pressures: tuple[float, PressureView] | None = None
        """The newest pressures, with the time since the start."""
        self.aborted = False
        self.results: dict[str, Path] = {}
        """The files that the run has left so far, by what they are."""
        self.observations: dict[int, tuple[NDArray[np.void], float, float]] = {}
        """The last rows by their frame, each with the model's error and its mean so far [mm]."""
        self.totals = RunTotals()
        self._cycles = 0
        self.view: tuple[NDArray[np.void], bytes] | None = None
        """The newest frame that is encoded, with its JPEG; empty without a camera."""
        self._encoder = ThreadPoolExecutor(1, initializer=_lowest_priority)
        self._encoding: Future[tuple[NDArray[np.void], bytes]] | None = None
        self._watched = 0.0
        self._journal: Path | None = None

    @property
    def finished(self) -> bool:
        return bool(self.ended)

    def about(self) -> RunDescription | None:
        if not self._connected:
            return None
        plan = self.session.plan
        return RunDescription(
            title=f"{Path(plan.trajectory.source).stem} on {plan.config.name}",
            simulated=plan.config.simulated,
            variant=plan.variant,
            actuators=plan.config.actuators,
            measured=plan.config.measures_tip,
            duration_s=plan.trajectory.duration_s,
            limit_bar=plan.config.limits.pressure_bar,
            length_mm=plan.config.arm.length_mm,
            tube_mm=tuple(
                2 * segment.geometry.outer_radius_mm
                for segment in plan.config.arm.chain
                for _ in segment.geometry.actuator_angles_deg
            ),
        )

    def viewer(self) -> LiveRunViewer:
        """Return a view for one more browser.

        Raises:
            StartError: the run has not started.
        """
        if not self._connected:
            raise StartError("the run has not started")
        self.viewers += 1
        return LiveRunViewer(self)

    def update(self) -> None:
        """Read the data that the run has written since the last call; connect to a run that has begun."""
        if self.finished:
            self._look_for_results()
            return
        if not (self._connected or self._connect()):
            return
        memory = self.session.memory
        self.session.check_ended()
        now = time.monotonic()
        if self.viewers and now - self._watched > WATCH_EVERY_S:
            self._watched = now
            self.session.watch()
        self.start_ns = memory.start_ns
        self._take_samples(memory.samples.read())
        for row in memory.venting.read():
            self._take_pressures(int(row["t_ns"]), np.full(len(row["measured_pa"]), np.nan), row["measured_pa"])
        self._take_observations(memory.observations.read())
        if len(adaptations := memory.adaptations.read()):
            self.totals.add_adaptations(adaptations)
        self.events += memory.read_events()
        spare = len(self.events) - EVENTS_KEPT
        if spare > 0:
            del self.events[:spare]
            self.events_dropped += spare
        self._encode_newest()
        if self.session.ended:
            message = memory.message("supervisor") if memory.stage("supervisor") is Stage.DONE else ""
            self.aborted = not message or message.startswith(Status.ABORTED)
            self.ended = message or "the supervisor died; the watchdog makes the valves safe"
            self._journal = memory.journal if message else None

    @property
    def awaits_results(self) -> bool:
        """Whether the page has a reason to outlast the run: it leaves an archive, and somebody watches."""
        return self.finished and self._journal is not None and self.viewers > 0

    def _look_for_results(self) -> None:
        if self._journal is not None:
            found = {"report": self._journal.with_suffix(".html"), "archive": self._journal.with_suffix(".h5")}
            self.results = {name: path for name, path in found.items() if path.exists()}

    def _connect(self) -> bool:
        now = time.monotonic()
        if now - self._last_attempt_s < CONNECT_EVERY_S:
            return False
        self._last_attempt_s = now
        if (probe := connect(self._path)) is None:
            return False
        probe.close()
        self.session = ClientSession(self._path)
        config = self.session.plan.config
        self.pressure = History(1 + 2 * config.actuators)
        self._lateness = np.zeros(lateness_cycles(config.control.rate_hz))
        self._connected = True
        return True

    def seconds(self, t_ns: int) -> float:
        """Time since the start of the run."""
        return (t_ns - self.start_ns) * 1e-9 if self.start_ns else 0.0

    @property
    def lateness_max_us(self) -> float:
        """Maximum lateness of the last second."""
        return float(self._lateness.max()) * 1e-3

    def _encode_newest(self) -> None:
        """Have the newest frame encoded, once for all browsers; those that come while one is encoded are dropped."""
        if self._encoding is not None:
            if not self._encoding.done():
                return
            self.view, self._encoding = self._encoding.result(), None
        after = -1 if self.view is None else int(self.view[0]["number"])
        if (view := self.session.memory.views.newest(after)) is not None:
            self._encoding = self._encoder.submit(_encoded, *view)

    def _take_samples(self, rows: NDArray[np.void]) -> None:
        for row in rows:
            self._lateness[self._cycles % len(self._lateness)] = row["lateness_ns"]
            if self._cycles % CHART_DECIMATION == 0:
                self._take_pressures(int(row["t_ns"]), row["setpoint_pa"], row["measured_pa"])
            self._cycles += 1
        if len(rows):
            self.totals.add_samples(rows)
            self.pressures = self._pressures(int(rows["t_ns"][-1]), rows["setpoint_pa"][-1], rows["measured_pa"][-1])

    def _pressures(self, t_ns: int, setpoint_pa: Array, measured_pa: Array) -> tuple[float, PressureView]:
        return self.seconds(t_ns), PressureView(setpoint_pa / PA_PER_BAR, measured_pa / PA_PER_BAR)

    def _take_pressures(self, t_ns: int, setpoint_pa: Array, measured_pa: Array) -> None:
        t_s, view = self.pressures = self._pressures(t_ns, setpoint_pa, measured_pa)
        self.pressure.add(np.concatenate([[t_s], view.setpoint_bar, view.measured_bar]))

    def _take_observations(self, rows: NDArray[np.void]) -> None:
        if not len(rows):
            return
        for row, error_mm, mean_mm in zip(rows, *self.totals.add_observations(rows), strict=True):
            self.observations[int(row["frame"])] = row, float(error_mm), float(mean_mm)
            std_mm = MM_PER_M * np.sqrt(np.diagonal(row["covariance_m2"]))
            measured, model = MM_PER_M * row["measured_m"], MM_PER_M * row["model_m"]
            t_s = self.seconds(int(row["t_ns"]))
            self.track.add(np.concatenate([[t_s], measured, std_mm, model, [error_mm, mean_mm]]))
        for old in list(self.observations)[:-OBSERVATIONS_KEPT]:
            del self.observations[old]


def _lowest_priority() -> None:
    """Give the calling thread the lowest priority; those that pass on an operator's commands keep theirs."""
    os.setpriority(os.PRIO_PROCESS, threading.get_native_id(), LOWEST_NICENESS)


def _encoded(view: NDArray[np.void], image: NDArray[np.uint8]) -> tuple[NDArray[np.void], bytes]:
    return view, jpeg(image) if image.size else b""


class LiveRunViewer:
    """One browser's view of a run."""

    def __init__(self, source: LiveRun) -> None:
        self._source = source
        self._pressure_s = self._track_s = FAR
        self._events = 0
        self._shown = -1
        self._frame = -1
        self._sent = 0.0
        self._results: tuple[str, ...] | None = None

    def packet(self) -> bytes | None:
        source = self._source
        frame = next(reversed(source.observations), -1)
        number = -1 if source.view is None else int(source.view[0]["number"])
        fresh = number > self._shown or (frame > self._frame and number < 0)
        due = time.monotonic() - self._sent > IDLE_PACKET_S and not source.finished
        ended = source.finished and self._results != tuple(source.results)
        if not (fresh or due or ended):
            return None
        self._results = tuple(source.results) if source.finished else None
        update = ViewUpdate(self._now())
        update.pressure, update.track = source.pressure.after(self._pressure_s), source.track.after(self._track_s)
        if len(update.pressure):
            self._pressure_s = float(update.pressure[-1, 0])
        if len(update.track):
            self._track_s = float(update.track[-1, 0])
        new = source.events[max(0, self._events - source.events_dropped) :]
        self._events = source.events_dropped + len(source.events)
        update.events = [(round(source.seconds(e.t_ns), 3), str(e.level), e.source, e.message) for e in new]
        if number > self._shown and source.view is not None:
            view = source.view[0]
            update.overlay = ViewOverlay(
                view["corners_px"][: int(view["found"])], view["tip_px"], view["model_px"], MM_PER_M * view["lines_m"]
            )
            update.picture = source.view[1]
        self._shown, self._frame, self._sent = number, frame, time.monotonic()
        return update.encoded()

    def act(self, do: CommandKind, who: str) -> dict[str, Any]:
        """Send an operator command to the supervisor."""
        return {"do": do, **self._source.session.request(do, who)}

    def close(self) -> None:
        self._source.viewers -= 1

    def _now(self) -> ViewState:
        source = self._source
        memory, plan = source.session.memory, source.session.plan
        protocol_s, waiting, sample = memory.protocol_s, memory.waiting_prompt, source.totals.sample
        segment = plan.trajectory.segment_at(protocol_s)
        return ViewState(
            state=self._state(waiting),
            time_s=source.pressures[0] if source.pressures else 0.0,
            protocol=ProtocolView(
                time_s=protocol_s,
                left_s=plan.trajectory.duration_s - protocol_s,
                segment=segment.label or segment.kind,
                segment_left_s=max(0.0, segment.stop_s - protocol_s),
            ),
            timing=TimingView(
                missed=source.totals.missed,
                dropped=source.totals.dropped if plan.config.measures_tip else None,
                lateness_us=None if sample is None else float(sample["lateness_ns"]) * 1e-3,
                lateness_max_us=source.lateness_max_us,
            ),
            pressure=source.pressures[1] if source.pressures else None,
            tip=self._tip() if source.observations else None,
            sections=self._sections() if source.observations and plan.config.sections else (),
            inputs=inputs(plan.auxiliary, sample["aux"]) if sample is not None and plan.auxiliary else (),
            estimates=self._estimates(),
            prompt=plan.trajectory.prompts[waiting].message if waiting >= 0 else None,
            ended=source.ended,
            aborted=source.aborted,
            results=tuple(source.results),
        )

    def _estimates(self) -> tuple[EstimateView, ...]:
        row = self._source.totals.adaptation
        if row is None:
            return ()
        return estimates(self._source.session.plan.adapted, row["value"], np.sqrt(np.diagonal(row["covariance"])))

    def _observation(self) -> tuple[NDArray[np.void], float, float]:
        """Row of the frame that is shown, with the model's error and its mean so far [mm]."""
        source = self._source
        newest = next(reversed(source.observations))
        frame = newest if source.view is None else int(source.view[0]["frame"])
        return source.observations.get(frame, source.observations[newest])

    def _sections(self) -> tuple[SectionView, ...]:
        row, _, _ = self._observation()
        return sections(
            self._source.session.plan.config.sections, MM_PER_M * row["section_m"], MM_PER_M * row["section_model_m"]
        )

    def _tip(self) -> TipView:
        row, error_mm, mean_mm = self._observation()
        if self._source.ended:
            # Not every picture is shown: the mean of a run that has ended is that of all its frames.
            *_, mean_mm = next(reversed(self._source.observations.values()))
        return TipView(
            frame=int(row["frame"]),
            seen=DetectionStatus(int(row["seen"])).words,
            model_ok=bool(row["model_ok"]),
            error_mm=error_mm,
            mean_error_mm=mean_mm,
            reprojection_px=float(row["reprojection_px"]),
            age_ms=(time.monotonic_ns() - int(row["t_ns"])) * 1e-6,
            sent_ms=time.time() * 1e3,
            path_error_mm=path_error(float(reference_error_mm(np.array([row]))[0])),
        )

    def _state(self, waiting: int) -> str:
        memory = self._source.session.memory
        if self._source.finished:
            return "ended"
        if not memory.start_ns or self._source.totals.sample is None:
            return "starting"
        if memory.stop_request:
            return "stopping"
        if memory.paused:
            return "paused"
        return "waiting" if waiting >= 0 else "running"
