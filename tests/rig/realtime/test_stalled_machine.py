"""A stall of the whole machine is no fault of a process; afterwards the pressures return within the rate limit."""

from __future__ import annotations

import os

import numpy as np
import pytest

from rig.config import loader
from rig.control import step as control
from rig.control.control_loop import ControlLoop
from rig.execution.plan import RunPlan
from rig.experiment.options import RunOptions
from rig.experiment.prepare import prepare
from rig.hardware.bench import Bench
from rig.realtime import process_group
from rig.realtime.health_monitor import HealthMonitor
from rig.realtime.process_group import ProcessGroup
from rig.realtime.scheduling import HeartbeatMonitor
from rig.realtime.shared_state import SharedState, Stage
from rig.realtime.timing_limits import TimingLimits, TimingProfile
from rig.simulator import mock_camera
from rig.simulator.mock_camera import MockCamera
from rig.simulator.plant import Plant
from rig.simulator.tip_pose import TipPose
from runs.records import Level, sample_dtype
from tests.support.plant_bench import mock_rig

MS = 1_000_000
CYCLE_NS = 5 * MS
BEGIN_NS = 100 * MS
MOVING = """
title: Both valves in motion
steps:
  - ramp: {actuators: [1, 2, 3], to_bar: 0.3, duration_s: 0.6}
  - sine: {actuators: [1, 2, 3], mean_bar: 0.3, amplitude_bar: 0.2, omega_rad_s: 4, duration_s: 2.2}
"""


@pytest.fixture(scope="module")
def moving(tmp_path_factory: pytest.TempPathFactory) -> RunPlan:
    folder = tmp_path_factory.mktemp("moving")
    (folder / "moving.yaml").write_text(MOVING)
    return prepare(str(folder / "moving.yaml"), "mock", RunOptions(out=folder, fast=True, seed=1)).plan


@pytest.mark.parametrize("at_s", [0.3, 0.9])
@pytest.mark.parametrize("still_s", [0.2, 0.6])
def test_after_a_stall_the_pressures_return_within_the_rate_limit(moving: RunPlan, still_s: float, at_s: float) -> None:
    """The plant continues during the stall with unchanged valves, like a real one."""
    plant = Plant(moving.config, 1, 0, moving_arm=False)
    bench = Bench(moving.config, {name: plant.card(name) for name in moving.config.cards})
    bench.safe_state.arm()
    bench.start()
    loop = ControlLoop(moving, bench)
    still, standing = round(still_s * 1e9) // CYCLE_NS, round(at_s * 1e9) // CYCLE_NS
    number = skipped = 0
    while not loop.finished:
        late_ns = still * CYCLE_NS if number == standing else 0
        now = BEGIN_NS + number * CYCLE_NS + late_ns
        plant.advance(now)
        row, trip = loop.cycle(number, now, 1 + skipped, 0, False, late_ns, skipped)
        assert trip is None
        skipped = still if number == standing else 0
        number += 1 + skipped
    np.testing.assert_allclose(row["measured_pa"], row["setpoint_pa"], atol=1000)


def test_a_stuck_pressure_is_detected_on_a_machine_that_stalls_repeatedly() -> None:
    rig = mock_rig()
    settings = control.prepare(rig)
    state = control.initial(settings)
    rng = np.random.default_rng(0)
    for n in range(1000):
        t_ns = 10**9 + n * 40 * MS
        bar = np.array([0.2, 0.0, 0.0]) + 1e-3 * rng.standard_normal(3)
        sample = control.Sample(t_ns, t_ns, bar, bar * 1e5, 35 * MS)
        state, command = control.step(settings, state, sample, np.array([0.4e5, 0, 0]), np.zeros(3))
        if command.trip is not None:
            break
    assert command.trip is not None
    assert n * 0.04 < 4 * rig.limits.tracking_s


class TestSilence:
    """A heartbeat monitor with a period of 2 ms and a limit of 25 ms."""

    @staticmethod
    def looked(until_ns: int, heartbeat_ns: int, every_ns: int = 2 * MS) -> tuple[HeartbeatMonitor, int]:
        """Monitor one heartbeat until then; return the result of the last check."""
        silence, said = HeartbeatMonitor(2 * MS, 8 * MS), 0
        for now in range(heartbeat_ns, until_ns + 1, every_ns):
            said = silence.silent_ns(now, heartbeat_ns)
        return silence, said

    def test_a_hung_process_is_silent_since_its_last_heartbeat(self) -> None:
        assert self.looked(1026 * MS, 1000 * MS)[1] == pytest.approx(26 * MS, abs=2 * MS)

    def test_time_in_which_the_monitor_stalled_is_not_counted_as_silence(self) -> None:
        silence, _ = self.looked(1004 * MS, 1000 * MS)
        assert silence.silent_ns(2004 * MS, 1000 * MS) < 8 * MS
        assert silence.silent_ns(2006 * MS, 2005 * MS) < 2 * MS

    def test_a_heartbeat_from_just_before_the_stall_is_not_old(self) -> None:
        silence, _ = self.looked(1004 * MS, 1000 * MS)
        assert silence.silent_ns(2004 * MS, 1005 * MS) <= 2 * MS

    def test_a_process_that_hangs_through_a_stall_is_detected_soon_after_it(self) -> None:
        silence, _ = self.looked(1004 * MS, 1000 * MS)
        looks = [silence.silent_ns(now, 1000 * MS) for now in range(2004 * MS, 2030 * MS, 2 * MS)]
        assert looks[-1] > 25 * MS

    def test_a_process_that_hangs_on_a_busy_machine_is_detected(self) -> None:
        assert self.looked(1060 * MS, 1000 * MS, every_ns=12 * MS)[1] > 25 * MS


def test_the_supervisor_blames_no_process_for_a_stall_unless_it_stays_silent_afterwards(
    moving: RunPlan, monkeypatch: pytest.MonkeyPatch
) -> None:
    timing, now = TimingLimits(TimingProfile.STRICT, control_hung_ns=30 * MS), 10**9
    memory = SharedState.create(moving.config)
    processes = ProcessGroup(moving, memory, None, 20 * MS * 1e-9)
    memory.publish_stage("control", Stage.RUNNING)
    monkeypatch.setattr(process_group.time, "monotonic_ns", lambda: now)
    try:
        for name in ("observer", "control", "watchdog"):
            memory.heartbeat(name, now)
        for still_ns in (5 * MS, 1500 * MS, *(20 * MS for _ in range(20))):
            now += still_ns
            assert processes.fault(timing) is None
        for _ in range(20):
            now += 20 * MS
            memory.heartbeat("watchdog", now)
            if (fault := processes.fault(timing)) is not None:
                break
        assert fault is not None
        assert fault[:2] == ("control", "the control process has been silent for 0.5 s")
    finally:
        os.close(memory.fd)


def test_a_stall_is_reported_once_with_its_length() -> None:
    monitor = HealthMonitor(mock_rig())
    rows = np.zeros(3, sample_dtype(3, 2))
    rows["t_ns"] = np.array([0, 5, 610]) * MS
    rows["lateness_ns"][1], rows["missed"][2] = 600 * MS, 120
    told = [event for event in monitor.samples(rows) if "stalled" in event.message]
    assert [event.level for event in told] == [Level.WARNING]
    assert "control stalled for 0.60 s" in told[0].message


def test_a_suspension_of_the_computer_is_reported_once_with_its_length() -> None:
    """The clock of the run does not advance meanwhile: only this report shows the suspension."""
    monitor = HealthMonitor(mock_rig())
    before_ns = 7_000 * MS  # suspended before the run
    told = [
        event
        for t_ns, suspended_ns in (
            (1, before_ns),
            (2, before_ns),
            (3, before_ns + 12_500 * MS),
            (4, before_ns + 12_500 * MS),
        )
        for event in monitor.suspension(t_ns, suspended_ns)
    ]
    assert [(event.t_ns, event.level) for event in told] == [(3, Level.WARNING)]
    assert "the computer was suspended for 12.5 s" in told[0].message


class Clock:
    """Replaces the module `time`: every sleep returns 1.5 s late."""

    now_ns = 10**12

    def monotonic_ns(self) -> int:
        return self.now_ns

    def sleep(self, seconds: float) -> None:
        self.now_ns += round(seconds * 1e9) + 1_500_000_000


def test_a_camera_whose_reader_stalled_takes_the_newest_picture_and_blames_no_simulator(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    class Forgetful:
        """The last second of the tip, as the mock card remembers it."""

        def pose_at(self, t_ns: int) -> TipPose:
            if t_ns < clock.now_ns - 1_100_000_000:
                raise LookupError("forgotten")
            return TipPose(t_ns, np.array([0.0, 0.0, 0.17]), np.eye(3))

    clock = Clock()
    monkeypatch.setattr(mock_camera, "time", clock)
    camera = MockCamera(loader.load("mock"), Forgetful())
    exposed: list[int] = []
    monkeypatch.setattr(camera, "develop", lambda exposure: exposed.append(exposure.t_ns))
    camera.read(1.0)
    assert clock.now_ns - exposed[0] < 2e9 / 30
