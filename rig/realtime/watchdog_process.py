"""The watchdog process: opens the cards itself and writes the safe state when control dies or hangs.

It depends on the shared memory and the cards only, not on the supervisor, the camera, the disk or the live page.
"""

from __future__ import annotations

import contextlib
import os
import select
import signal
import time
from collections.abc import Callable

from rig.hardware.cards.base import CardError
from rig.hardware.safe_state import RigSafeState, combined_fault, failure_of
from rig.hardware.vent_verification import LONGEST_VENTING_S, verify_venting
from rig.realtime.child_process import (
    await_device_access,
    exit_process,
    receive_job,
    report,
    report_end,
    supervisor_monitor,
    vent_at_signal,
)
from rig.realtime.process_monitor import ProcessMonitor
from rig.realtime.scheduling import (
    WATCHDOG_PRIORITY,
    HeartbeatMonitor,
    disable_realtime_scheduling,
    enable_realtime_scheduling,
)
from rig.realtime.shared_state import SharedState, Stage, Stop
from rig.realtime.timing_limits import TimingLimits, timing_limits

PERIOD_MS = 2
RETRY_S = 0.5
EXIT_S = 0.25
"""How long a killed process may take to begin to exit, on a busy machine."""


def main() -> int:
    """Monitor control until it has exited; write the safe state if control has not."""
    signal.signal(signal.SIGTERM, signal.SIG_IGN)
    job, memory = receive_job()
    vent_at_signal(memory)
    supervisor = supervisor_monitor(job)
    if not await_device_access(memory, supervisor, lambda: not memory.simulator_starting):
        memory.publish_stage("watchdog", Stage.DONE)
        return 0
    safe_state = RigSafeState(job.plan.config)
    try:
        safe_state.keep_open()
    except CardError as error:
        memory.publish_stage("watchdog", Stage.FAILED, str(error))
        return 1
    memory.watchdog_granted = enable_realtime_scheduling(WATCHDOG_PRIORITY)
    memory.heartbeat("watchdog", time.monotonic_ns())
    memory.publish_stage("watchdog", Stage.READY)
    reason = "the watchdog failed"
    ended = 0
    try:
        reason = _watch(memory, job.supervisor_pid, safe_state, lambda: timing_limits(job.plan.config, memory.granted))
    finally:
        if reason and not safe_state.kept_open:
            ended = memory.card_holder_pid
            _kill(ended or memory.control_pid)  # only its exit releases the card
        # A safe state that control has written is not written again: another program may have vented held valves since.
        failure = "" if not reason and memory.safe_ns else _make_safe(safe_state, memory)
    # The outputs are safe; the rest is not urgent.
    if reason:
        memory.watchdog_trip_ns = time.monotonic_ns()
        _kill(memory.control_pid)
        time.sleep(0.005)
        # A control process that was only slow may have written once more before it died.
        failure = _make_safe(safe_state, memory)
    message = combined_fault(reason, failure) if failure else reason
    memory.publish_stage("watchdog", Stage.FAILED if failure else Stage.DONE, message)
    if ended:
        report(f"{reason}: the process that held the card was ended to make the valves safe")
    safe_state.close()
    disable_realtime_scheduling()
    if (reason and _supervisor_exits(memory, supervisor)) or (not memory.safe_ns and supervisor.exited):
        report_end(failure and message, lambda: verify_venting(job.plan.config, vent=memory.vents))
    return 1 if failure else 0


def _make_safe(safe_state: RigSafeState, memory: SharedState, patience_s: float = RETRY_S) -> str:
    """Write the safe state; retry a failing card for `patience_s`. Returns the reason of a failure, else empty."""
    return failure_of(lambda: safe_state.make_safe(vent=memory.vents), patience_s)


def _supervisor_exits(memory: SharedState, supervisor: ProcessMonitor) -> bool:
    """Return True once the supervisor has exited, False if it is alive: it then verifies the safe state itself."""
    began_ns = time.monotonic_ns()
    while not supervisor.exited:
        now_ns = time.monotonic_ns()
        if memory.heartbeat_ns("supervisor") > began_ns or now_ns - began_ns > EXIT_S * 1e9:
            return False
        time.sleep(PERIOD_MS * 1e-3)
    return True


def _watch(
    memory: SharedState, supervisor_pid: int, safe_state: RigSafeState, decide: Callable[[], TimingLimits]
) -> str:
    """Return why the watchdog has to write the safe state; empty if control has written it.

    `decide` returns the limits; they are final once control is running, because its scheduling is known then.
    """
    poll = select.poll()
    supervisor = _watched(poll, supervisor_pid)
    while not (control_pid := memory.control_pid):
        memory.heartbeat("watchdog", time.monotonic_ns())
        if supervisor in _exited(poll, PERIOD_MS) or memory.stop_request != Stop.NONE:
            return ""
    control = _watched(poll, control_pid)
    monitor = ProcessMonitor(control_pid)
    supervisor_gone_ns = 0
    vented = False
    timing, final = decide(), False
    control_monitor, supervisor_heartbeat = _heartbeat_monitors(timing)
    while True:
        exited = _exited(poll, PERIOD_MS)
        now = time.monotonic_ns()
        memory.heartbeat("watchdog", now)
        if control in exited or monitor.exited:
            return "" if memory.stage("control") in (Stage.DONE, Stage.FAILED) else "the control process died"
        if not vented and memory.vents:
            # At once: control does the same, but in its next cycle only.
            _make_safe(safe_state, memory, patience_s=0.0)
            vented = True
        running = memory.stage("control") == Stage.RUNNING
        if running and not final:
            timing, final = decide(), True
            control_monitor, supervisor_heartbeat = _heartbeat_monitors(timing)
        silent_ns = control_monitor.silent_ns(now, memory.heartbeat_ns("control"))
        supervisor_silent_ns = supervisor_heartbeat.silent_ns(now, memory.heartbeat_ns("supervisor"))
        if running and silent_ns > timing.control_hung_ns:
            return "the control process hung"
        if supervisor >= 0 and supervisor in exited:
            poll.unregister(supervisor)  # it would wake this process continuously
            supervisor = -1
        if not supervisor_gone_ns and (
            supervisor < 0 or (running and supervisor_silent_ns > timing.supervisor_silent_ns)
        ):
            supervisor_gone_ns = now
            memory.request_stop(Stop.SILENT)
        # Once the outputs are safe, control watches the chambers vent; a slow bench takes long.
        vented_s = max(timing.vented_s, LONGEST_VENTING_S) if memory.safe_ns else 0.0
        grace_ns = timing.grace_ns + round(vented_s * 1e9)
        if supervisor_gone_ns and now - supervisor_gone_ns > grace_ns:
            return "the supervisor died or hung, and control did not stop"


def _heartbeat_monitors(timing: TimingLimits) -> tuple[HeartbeatMonitor, HeartbeatMonitor]:
    """A heartbeat monitor for control and one for the supervisor."""
    first, second = (HeartbeatMonitor(PERIOD_MS * 1_000_000, timing.late_check_ns) for _ in range(2))
    return first, second


def _watched(poll: select.poll, pid: int) -> int:
    """Register the exit of a process; return its descriptor, or -1 if it has exited."""
    try:
        fd = os.pidfd_open(pid)
    except ProcessLookupError:
        return -1
    poll.register(fd, select.POLLIN)
    return fd


def _exited(poll: select.poll, timeout_ms: int) -> set[int]:
    """Descriptors of the processes that have exited; -1 stands for one that had exited before it was registered."""
    return {-1} | {fd for fd, _ in poll.poll(timeout_ms)}


def _kill(pid: int) -> None:
    with contextlib.suppress(ProcessLookupError):
        os.kill(pid, signal.SIGKILL)


if __name__ == "__main__":
    exit_process(main())
