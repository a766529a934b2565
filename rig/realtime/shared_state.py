"""The shared memory of the processes of one run: a row of flags, and ring buffers.

The rings of events and views serve viewers; the record does not depend on them.
"""

from __future__ import annotations

import itertools
import mmap
import os
import time
from collections.abc import Callable, Iterable, Mapping
from enum import IntEnum
from pathlib import Path
from typing import Any, Generic, TypeVar

import numpy as np
from numpy.typing import NDArray

from rig.config.schema import RigConfig
from rig.control.plan_follower import SetPointSource, plan_dtype
from rig.execution.plan import observation_rows, sample_rows
from rig.realtime.picture_rings import PICTURES, VIEWS, PictureRing, ViewRing, view_dtype
from rig.realtime.ring import RingBuffer, ring_bytes
from rig.realtime.scheduling import Scheduling
from runs.records import Event, Level, adaptation_dtype, pulse_dtype, streamed_dtype, tip_control_dtype

T = TypeVar("T", bound=float)

SAMPLES = 4096
OBSERVATIONS = 1024
MESSAGE_BYTES = 480
EVENTS = 256
PLANS = 256
SETPOINTS = 1024
PULSES = 1024
VENTING = 1024
PATH_BYTES = 4096
TIP_CONTROLLER = "tip_controller"
CLOCKS = 8
"""Number of cards whose sampling clocks are published."""


class Stage(IntEnum):
    """Stage of a process."""

    STARTING = 0
    READY = 1
    RUNNING = 2
    DONE = 3
    FAILED = 4


class Stop(IntEnum):
    """Reason to end every process with the valves safe; SILENT: the supervisor sent no heartbeat."""

    NONE = 0
    SAFE = 1
    SILENT = 2
    TERMINATED = 3
    VENT = 4
    VENT_COMMAND = 5
    """`rig vent`."""


_PROCESS = np.dtype([("stage", "<i8"), ("heartbeat_ns", "<i8"), ("message", f"S{MESSAGE_BYTES}")], align=True)
_ROW_BYTES = -(-_PROCESS.itemsize // 64) * 64
_EVENT = np.dtype([("t_ns", "<i8"), ("level", "S8"), ("source", "S32"), ("message", f"S{MESSAGE_BYTES}")])
_TEXT_FIELDS = ("source", "message")


class _Flag(Generic[T]):
    """A typed property of `SharedState`, and the field of `flags` of the same name."""

    def __init__(self, kind: Callable[[Any], T]) -> None:
        """`kind` makes the value of type T from the stored number."""
        self._kind = kind
        self.format = "<f8" if kind is float else "<i8"

    def __set_name__(self, owner: type[SharedState], name: str) -> None:
        self._name = name

    def __get__(self, state: SharedState, owner: type[SharedState]) -> T:
        return self._kind(state.flags[self._name].item())

    def __set__(self, state: SharedState, value: T) -> None:
        state.flags[self._name][0] = value


class SharedState:
    """A view of the shared memory of one run. It exists as long as a process holds its file descriptor.

    `flags` is one structured row; each flag is read and written through the property of the same name. Times are
    CLOCK_MONOTONIC [ns], 0 before the event; a process id is 0 before the process exists.
    `samples`, `observations`, `adaptations`, `plans`, `streamed` and `pulses` are rings of the records of
    `runs.records`; `new_setpoints` are those of another program that control has not taken yet. `pictures` are for the
    recorder; `views`, and the pressures `venting` that control reads in the safe state, are for viewers.

    The process of the tip controller may run code of the user: it can write to pages of its own only, which hold its
    stage, its heartbeat and `new_plans` (rows of `plan_dtype`).

    A write through a read-only mapping raises ValueError.
    """

    control_pid = _Flag(int)
    watchdog_pid = _Flag(int)
    card_holder_pid = _Flag(int)
    """The process that has the cards open, where that is not the process that the watchdog monitors as control."""
    control_granted = _Flag(Scheduling)
    watchdog_granted = _Flag(Scheduling)
    simulator_starting = _Flag(bool)
    start_ns = _Flag(int)
    stop_request = _Flag(Stop)
    vent_requested = _Flag(bool)
    """Set once by a request to vent, which another process cannot take back by a stop reason of the same moment."""
    vented = _Flag(bool)
    """True where valves that the safe state would hold are vented: by another program, or for an emergency stop."""
    paused = _Flag(bool)
    skips = _Flag(int)
    """Requests to skip the rest of a segment, since the start."""
    viewer_ns = _Flag(int)
    """When a viewer last requested data."""
    prompts_answered = _Flag(int)
    waiting_prompt = _Flag(int)
    """Index of the prompt that the protocol waits for; -1 when it waits for none."""
    protocol_s = _Flag(float)
    safe_ns = _Flag(int)
    """When the safe state was written by another process than the watchdog."""
    watchdog_trip_ns = _Flag(int)
    """When the watchdog wrote the safe state because control had died or hung."""
    lost_scans = _Flag(int)
    damaged_lines = _Flag(int)
    """Lines between computer and cards that were damaged."""
    repeated_scans = _Flag(int)
    """Scans that the cards have delivered twice."""
    slow_calls = _Flag(int)
    """Control cycles with a call into a card's driver that took longer than the control period; of the last one:"""
    slow_call = _Flag(int)
    """Its number in `rig.hardware.bench.DRIVER_CALLS`."""
    slow_card = _Flag(int)
    """Number of the card in the rig file, -1 for several."""
    slow_call_ns = _Flag(int)
    """How long it took."""
    setpoint_source = _Flag(SetPointSource)
    unverified_cards = _Flag(int)
    """Cards without read-back, found when the bench was armed."""

    def __init__(
        self, fd: int, config: RigConfig, adapted: int = 0, *, readonly: bool = False, tip_controller: bool = False
    ) -> None:
        """Map the memory of a run on a rig with `adapted` estimated parameters; viewers map it `readonly`.

        With `tip_controller` all is read-only but the pages of the tip controller. `fd` -1: memory of one process.
        """
        self.fd = fd
        valves, streamed, view = len(config.valves), streamed_dtype(config.actuators), view_dtype(config)
        rings = (
            (sample_rows(config), SAMPLES),
            (observation_rows(config), OBSERVATIONS),
            (adaptation_dtype(adapted), OBSERVATIONS),
            (tip_control_dtype(valves), PLANS),
            (streamed, SETPOINTS),
            (streamed, SETPOINTS),
            (pulse_dtype(), PULSES),
            (_EVENT, EVENTS),
            (np.dtype([("t_ns", "<i8"), ("measured_pa", "<f8", (config.actuators,))]), VENTING),
        )
        # A slot holds the largest picture of a camera, with its marks. One process alone passes none on.
        cameras = config.cameras.values() if fd >= 0 else ()
        slot = max((c.width_px * c.height_px for c in cameras), default=0) * 3 + 4096
        sizes = (
            -(-_FLAGS.itemsize // 64) * 64,
            PictureRing.row_bytes(),
            slot * PICTURES,
            ring_bytes(view, VIEWS),
            slot * VIEWS,
            *(ring_bytes(rows, capacity) for rows, capacity in rings),
        )
        edges = [0, *itertools.accumulate(sizes)]
        own_start = -(-edges[-1] // mmap.ALLOCATIONGRANULARITY) * mmap.ALLOCATIONGRANULARITY
        own_size = _ROW_BYTES + ring_bytes(plan_dtype(valves), PLANS)
        if fd >= 0 and os.fstat(fd).st_size == 0:
            os.ftruncate(fd, own_start + own_size)
        access = mmap.ACCESS_READ if readonly or tip_controller else mmap.ACCESS_WRITE
        memory = memoryview(mmap.mmap(fd, edges[-1], access=access))
        own_access = mmap.ACCESS_READ if readonly else mmap.ACCESS_WRITE
        own = memoryview(mmap.mmap(fd, own_size, access=own_access, offset=own_start))
        flags, pictures, picture_slots, views, view_slots, *parts = (memory[a:b] for a, b in itertools.pairwise(edges))
        self.flags: NDArray[np.void] = np.frombuffer(flags, _FLAGS, 1)
        self.pictures = PictureRing(pictures, picture_slots, slot)
        self.views = ViewRing(views, view_slots, slot, view)
        (
            self.samples,
            self.observations,
            self.adaptations,
            self.plans,
            self.new_setpoints,
            self.streamed,
            self.pulses,
            self._events,
            self.venting,
        ) = (RingBuffer(part, *ring) for part, ring in zip(parts, rings, strict=True))
        self.new_plans = RingBuffer(own[_ROW_BYTES:], plan_dtype(valves), PLANS)
        self._tip_controller: NDArray[np.void] = np.frombuffer(own, _PROCESS, 1)

    @classmethod
    def create(cls, config: RigConfig, adapted: int = 0, *, shared: bool = True) -> SharedState:
        """Create the memory of a new run, all zero; no prompt is waiting. Not `shared`: of a run in one process."""
        memory = cls(os.memfd_create("softrig", 0) if shared else -1, config, adapted)
        memory.waiting_prompt = -1
        return memory

    @property
    def confirmation(self) -> str:
        """How control's pressures confirm the safe state; empty before they do."""
        return bytes(self.flags["confirmation"][0]).decode(errors="replace")

    @confirmation.setter
    def confirmation(self, sentence: str) -> None:
        self.flags["confirmation"][0] = sentence.encode()[:MESSAGE_BYTES]

    @property
    def journal(self) -> Path | None:
        """The journal of the run; None before it is open."""
        name = bytes(self.flags["journal"][0])
        return Path(os.fsdecode(name)) if name else None

    @journal.setter
    def journal(self, path: Path) -> None:
        self.flags["journal"][0] = os.fsencode(path.absolute())

    def request_stop(self, reason: Stop) -> None:
        """Request that every process ends with the valves safe. The first stop reason is kept; VENT overrides it."""
        vents = reason in (Stop.VENT, Stop.VENT_COMMAND)
        if vents:
            self.vent_requested = True
        if vents or self.stop_request is Stop.NONE:
            self.stop_request = reason

    def publish_safe(self) -> None:
        """Publish that this process has written the safe state now."""
        self.safe_ns = time.monotonic_ns()

    @property
    def vents(self) -> bool:
        """True where the safe state vents every valve, also those that the rig holds."""
        return self.vent_requested or self.vented

    @property
    def granted(self) -> Scheduling:
        """The scheduling that both control and the watchdog were granted; none before both have published theirs."""
        return self.control_granted & self.watchdog_granted

    def stage(self, process: str) -> Stage:
        """Stage of a process."""
        return Stage(int(self._process(process)["stage"][0]))

    def message(self, process: str) -> str:
        """The last message of a process."""
        return bytes(self._process(process)["message"][0]).decode(errors="replace")

    def publish_stage(self, process: str, stage: Stage, message: str = "") -> None:
        """Publish a process's stage; the message is written before the stage that it explains."""
        row = self._process(process)
        row["message"][0] = message.encode()[:MESSAGE_BYTES]
        row["stage"][0] = stage

    def heartbeat(self, process: str, t_ns: int) -> None:
        """Publish a heartbeat."""
        self._process(process)["heartbeat_ns"][0] = t_ns

    def heartbeat_ns(self, process: str) -> int:
        """Time of the last heartbeat of a process."""
        return int(self._process(process)["heartbeat_ns"][0])

    def _process(self, name: str) -> NDArray[np.void]:
        """Row (1,) of a process: stage, heartbeat and message."""
        return self._tip_controller if name == TIP_CONTROLLER else self.flags[name]

    def publish_clocks(self, clocks: Mapping[int, tuple[float, float]]) -> None:
        """Publish period [ns] and drift [ppm] of the sampling clock of each card by number, of at most CLOCKS cards."""
        for number, clock in clocks.items():
            if number < CLOCKS:
                self.flags["scan_period_ns"][0, number], self.flags["scan_drift_ppm"][0, number] = clock

    def clock_counters(self, cards: Iterable[str]) -> dict[str, int]:
        """Counters of each card with its own sampling clock; their names begin with the name of the card.

        `scan_period_ns` is the period as rounded by the driver; `scan_drift_ppb` its estimated relative error by the
        computer's clock in parts per billion (1e-9).
        """
        counters = {}
        for name, period_ns, drift_ppm in zip(
            cards, *self.flags[0][["scan_period_ns", "scan_drift_ppm"]], strict=False
        ):
            if period_ns > 0:
                counters[f"{name}_scan_period_ns"] = round(period_ns)
                counters[f"{name}_scan_drift_ppb"] = round(drift_ppm * 1e3)
        return counters

    def push_event(self, event: Event) -> None:
        """Publish an event to viewers."""
        row = np.zeros((), _EVENT)
        row["t_ns"], row["level"], row["source"] = event.t_ns, event.level.encode(), event.source.encode()[:32]
        row["message"] = event.message.encode()[:MESSAGE_BYTES]
        self._events.push(row)

    def read_events(self) -> list[Event]:
        """Return the events published since the last call."""
        return [
            Event(
                int(row["t_ns"]), Level(row["level"].decode()), *(row[n].decode(errors="replace") for n in _TEXT_FIELDS)
            )
            for row in self._events.read()
        ]


_FLAGS = np.dtype(
    [
        *((process, _PROCESS) for process in ("control", "observer", "watchdog", "supervisor")),
        *((name, flag.format) for name, flag in vars(SharedState).items() if isinstance(flag, _Flag)),
        ("confirmation", f"S{MESSAGE_BYTES}"),
        ("journal", f"S{PATH_BYTES}"),
        ("scan_period_ns", "<f8", (CLOCKS,)),
        ("scan_drift_ppm", "<f8", (CLOCKS,)),
    ],
    align=True,
)
