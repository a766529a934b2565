"""Records the data of a run, in real time or virtual time: from the ring buffers to the rows of the journal."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import TYPE_CHECKING, TypeVar

import numpy as np
from numpy.typing import NDArray

from rig.execution.plan import UNRECORDED, OperatorInterface, Progress, RunPlan
from rig.realtime.health_monitor import HealthMonitor
from rig.realtime.ring import RingBuffer
from rig.realtime.run_totals import RunTotals
from rig.realtime.scheduling import suspended_ns
from rig.realtime.shared_state import SharedState
from runs.journal.append_only_file import JournalError
from runs.records import Event, Level, Picture

if TYPE_CHECKING:
    from runs.journal.journal import JournalWriter

Record = TypeVar("Record")


class DataRecorder:
    """Moves rows, pictures and events into a journal; keeps the latest rows, counts losses and reports poor health.

    A journal that fails raises no error here: `failure` has its reason, and the run must end. Nothing is recorded after
    that, but events still reach the operator.
    """

    def __init__(
        self,
        plan: RunPlan,
        memory: SharedState,
        journal: JournalWriter,
        operator: OperatorInterface,
        start_ns: int = 0,
        clock: Callable[[], int] = time.monotonic_ns,
    ) -> None:
        """Times in warnings count from `start_ns`; `clock` gives the time of the run."""
        self._plan, self._config, self._memory = plan, plan.config, memory
        self._journal, self._operator, self._clock = journal, operator, clock
        self._health = HealthMonitor(plan.config, start_ns)
        self._lost_scans = self._damaged_lines = self._repeated_scans = self._slow_calls = self._lost_pulses = 0
        self.failure = ""
        """Why the record could not be written; empty if it could."""
        self.totals = RunTotals()

    def poll(self) -> None:
        """Record what the processes have written since the last call, and check supervisor, computer and disk."""
        self.report(*self._health.supervisor_stall(self._clock()))
        self.report(*self._health.suspension(self._clock(), suspended_ns()))
        self.drain()
        self.report(*self._health.disk(self._clock(), self._journal.stalled_s))

    def drain(self) -> None:
        """Record everything that the processes have written since the last call."""
        memory, journal = self._memory, self._journal
        slow, self._slow_calls = memory.slow_calls - self._slow_calls, memory.slow_calls
        if slow:
            self._health.slow_calls(slow, memory.slow_call, memory.slow_card, memory.slow_call_ns)
        if len(samples := self._read(memory.samples, journal.samples)):
            self.totals.add_samples(samples)
            self.report(*self._health.samples(samples))
        lost, self._lost_scans = memory.lost_scans - self._lost_scans, memory.lost_scans
        self.report(*self._health.lost(self._clock(), lost))
        damaged, self._damaged_lines = memory.damaged_lines - self._damaged_lines, memory.damaged_lines
        self.report(*self._health.damaged(self._clock(), damaged))
        repeated, self._repeated_scans = memory.repeated_scans - self._repeated_scans, memory.repeated_scans
        self.report(*self._health.repeated(self._clock(), repeated))
        if len(observations := self._read(memory.observations, journal.observations)):
            self.totals.add_observations(observations)
            self.report(*self._health.observations(observations))
        if len(adaptations := self._read(memory.adaptations, journal.adaptations)):
            self.totals.add_adaptations(adaptations)
        plans = self._read(memory.plans, journal.plans)
        self.totals.plans.add(plans["status"])
        self.report(*self._health.plans(plans))
        self._read(memory.streamed, journal.streamed)
        pulses = memory.pulses.read()
        # Those before the start have warmed the observer up.
        if len(pulses := pulses[pulses["t_ns"] >= memory.start_ns]):
            self._write(journal.pulses, pulses)
            self._lost_pulses += int(pulses["skipped"].sum())
            self.report(*self._health.pulses(pulses))
        for picture in memory.pictures.read(list(self._config.cameras), self._config.recording.encoding):
            self.picture(picture)

    def _read(self, ring: RingBuffer, write: Callable[[NDArray[np.void]], None]) -> NDArray[np.void]:
        """Record the new rows of a ring, and return them."""
        if len(rows := ring.read()):
            self._write(write, rows)
        return rows

    def finish(self) -> None:
        """Record the rest, and report what has repeated and is not reported yet."""
        self.drain()
        self.report(*self._health.rest(self._clock()))

    def progress(self) -> Progress:
        """What the operator is shown."""
        memory, trajectory, waiting = self._memory, self._plan.trajectory, self._memory.waiting_prompt
        totals = self.totals
        return Progress(
            protocol_s=memory.protocol_s,
            duration_s=trajectory.duration_s,
            sample=totals.sample,
            observation=totals.observation,
            missed=totals.missed,
            dropped=totals.dropped if self._config.measures_tip else None,
            prompt=trajectory.prompts[waiting].message if waiting >= 0 else None,
            paused=memory.paused,
            adapted=self._plan.adapted,
            adaptation=totals.adaptation,
            auxiliary=self._plan.auxiliary,
        )

    def counters(self) -> dict[str, int]:
        """Losses of the run by name."""
        memory = self._memory
        return {
            "missed_deadlines": self.totals.missed,
            **({"dropped_frames": self.totals.dropped} if self._config.measures_tip else {}),
            "lost_scans": self._lost_scans,
            "damaged_lines": self._damaged_lines,
            "repeated_scans": self._repeated_scans,
            "slow_driver_calls": self._slow_calls,
            **({"lost_pulses": self._lost_pulses} if self._config.triggered else {}),
            "sample_ring_overflows": memory.samples.lost,
            "observation_ring_overflows": memory.observations.lost,
            "picture_ring_overflows": memory.pictures.lost,
            "adaptation_ring_overflows": memory.adaptations.lost,
            "plan_ring_overflows": memory.plans.lost,
            "streamed_ring_overflows": memory.streamed.lost,
            "pulse_ring_overflows": memory.pulses.lost,
        }

    def event(self, level: Level, source: str, message: str) -> None:
        self.report(Event(self._clock(), level, source, message))

    def picture(self, picture: Picture) -> None:
        """Record a camera picture."""
        self._write(self._journal.picture, picture)

    def report(self, *events: Event) -> None:
        """Record events and show them to the operator and to attached pages."""
        for event in events:
            self._write(self._journal.event, event)
            self._memory.push_event(event)
            self._operator.report(event)

    def _write(self, write: Callable[[Record], None], record: Record) -> None:
        """Write a record into the journal, if it has not failed."""
        if self.failure:
            return
        try:
            write(record)
        except JournalError as error:
            self.failure = f"{UNRECORDED}: {error}"
