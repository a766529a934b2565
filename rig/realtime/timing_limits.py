"""Time limits of the processes of a run, derived from the hardware and the granted scheduling.

See docs/explanation/processes-and-safety.md, "What counts as hung". Every threshold in wall-clock time that can end a
real-time run because the machine is slow is a field of `TimingLimits`.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from enum import StrEnum

from rig.config.drivers import Reality
from rig.config.schema import RigConfig
from rig.control.step import UNMEASURED_PERIODS
from rig.realtime.scheduling import REAL_TIME, Scheduling

MS = 1_000_000
STRICT_HUNG_S = 0.03
"""Longer than any lateness measured under SCHED_FIFO with locked memory."""
HUNG_PERIODS = 3
"""Control sends one heartbeat per cycle; the rig file may not state a shorter `hung_s` either."""
ORDINARY_HUNG_S = 0.1
"""The longest silence allowed for real valves at ordinary priority; see `timing_limits`."""
SIMULATED_HUNG_S = 5.0
"""Longer than any measured delay by compilers, downloads and disk writes beside a run."""


class TimingProfile(StrEnum):
    """The set of limits that applies."""

    STRICT = "strict"
    ORDINARY = "ordinary priority"
    SIMULATED = "simulated bench"


@dataclass(frozen=True)
class TimingLimits:
    """Thresholds of the processes that monitor each other, in real time.

    `late_check_ns`: a watchdog interval that counts as late (see `HeartbeatMonitor`). `grace_ns`: time for control to
    write the safe state after the supervisor has gone. `failsafe_*`: the observer's failsafe thread. `supervised_*`:
    the supervisor. `frame_s`, `disk_s`, `vented_s`: longest wait for a picture, for the disk, for a chamber to vent.
    `ending_s`: time for each process to exit. `simulator_ns`: largest delay of the simulator; `simulation_waits_ns`:
    how long it continues without a write to an open valve; both None if simulated hardware is treated as real hardware.
    """

    profile: TimingProfile
    control_hung_ns: int
    late_check_ns: int = 8 * MS
    watchdog_silent_ns: int = 1000 * MS
    supervisor_silent_ns: int = 2000 * MS
    grace_ns: int = 100 * MS
    failsafe_silent_ns: int = 200 * MS
    failsafe_supervisor_ns: int = 500 * MS
    failsafe_checks: int = 25
    supervised_control_s: float = 0.5
    supervised_watchdog_s: float = 1.2
    frame_s: float = 1.0
    disk_s: float = 10.0
    vented_s: float = 1.0
    ending_s: float = 2.0
    simulator_ns: int | None = None
    simulation_waits_ns: int | None = None

    @property
    def supervised_observer_s(self) -> float:
        """Longest silence of the observer, which sends one heartbeat per picture."""
        return 2 * self.frame_s


def timing_limits(config: RigConfig, granted: Scheduling) -> TimingLimits:
    """The limits of one run; `granted` is what both control and the watchdog were granted.

    `limits.hung_s` of the rig file applies with all other limits strict; a machine that may stand still for so long
    delays the other processes as well, so no process counts as silent earlier. Without it: strict for real valves with
    SCHED_FIFO and locked memory. Real valves at ordinary priority: control may be silent for the rig's limit of the age
    of the newest sample (`stale_s`), at most 0.1 s. Neither is shorter than three control periods. Simulated valves:
    seconds, because no hardware can be damaged.
    """
    limits = config.limits
    shortest_s = max(STRICT_HUNG_S, HUNG_PERIODS / config.control.rate_hz)
    if limits.hung_s is not None or (config.has_real_valves and REAL_TIME in granted):
        strict_ns = round((limits.hung_s or shortest_s) * 1e9)
        strict = TimingLimits(TimingProfile.STRICT, strict_ns, frame_s=limits.no_tip_s)
        return replace(
            strict,
            watchdog_silent_ns=max(strict.watchdog_silent_ns, strict_ns),
            supervisor_silent_ns=max(strict.supervisor_silent_ns, strict_ns),
            supervised_control_s=max(strict.supervised_control_s, strict_ns * 1e-9),
            supervised_watchdog_s=max(strict.supervised_watchdog_s, strict_ns * 1e-9),
        )
    if config.has_real_valves:
        hung_s = max(shortest_s, min(limits.stale_s, ORDINARY_HUNG_S))
        return TimingLimits(TimingProfile.ORDINARY, round(hung_s * 1e9), frame_s=limits.no_tip_s)
    real_sources = any(source.reality is not Reality.SIMULATED for source in config.tip_sources)
    silent_ns = round(SIMULATED_HUNG_S * 1e9)
    return TimingLimits(
        TimingProfile.SIMULATED,
        control_hung_ns=silent_ns,
        late_check_ns=50 * MS,
        watchdog_silent_ns=2 * silent_ns,
        supervisor_silent_ns=2 * silent_ns,
        grace_ns=silent_ns,
        failsafe_silent_ns=2 * silent_ns,
        failsafe_supervisor_ns=3 * silent_ns,
        supervised_control_s=2 * SIMULATED_HUNG_S,
        supervised_watchdog_s=2 * SIMULATED_HUNG_S,
        frame_s=limits.no_tip_s if real_sources else max(limits.no_tip_s, 2 * SIMULATED_HUNG_S),
        disk_s=60.0,
        vented_s=10.0,
        ending_s=20.0,
        simulator_ns=2 * silent_ns,
        simulation_waits_ns=round(UNMEASURED_PERIODS / config.control.rate_hz * 1e9),
    )


def timing_sentence(config: RigConfig, granted: Scheduling) -> str:
    """One sentence for the operator: when control counts as hung on this bench, and which guarantees are missing."""
    timing = timing_limits(config, granted)
    hung_s = timing.control_hung_ns * 1e-9
    if timing.profile is TimingProfile.SIMULATED:
        return (
            f"simulated bench, no valve at stake: a process that does nothing for {hung_s:g} s ends the run "
            f"({STRICT_HUNG_S:g} s with real valves and real-time scheduling)"
        )
    reaction = f"the watchdog takes the valves {hung_s * 1e3:.0f} ms after control hangs"
    if REAL_TIME in granted:
        return reaction
    return (
        f"{reaction}, but on a busy machine later by an unknown time: without real-time scheduling no reaction time "
        f"can be promised, and control may count as hung though it only waits for a processor"
    )
