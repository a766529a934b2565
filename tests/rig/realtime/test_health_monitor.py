"""Each condition that does not stop a run is reported when it begins and when it ends."""

from __future__ import annotations

import numpy as np
import pytest

import rig.config.loader
from rig.realtime.health_monitor import HealthMonitor
from rig.realtime.repeated_warnings import REPEATED_S
from runs.records import DetectionStatus, Event, Level, observation_dtype, sample_dtype

FRAME_NS, CYCLE_NS = 33_333_333, 5_000_000


@pytest.fixture
def monitor() -> HealthMonitor:
    return HealthMonitor(rig.config.loader.load("mock"))


def frames(n: int, first: int = 0, **columns: object) -> np.ndarray:  # type: ignore[type-arg]
    rows = np.zeros(n, observation_dtype(3))
    rows["t_ns"] = 10**9 + (first + np.arange(n)) * FRAME_NS
    rows["model_ok"] = 1
    for name, value in columns.items():
        rows[name] = value
    return rows


def levels(events: list[Event]) -> list[Level]:
    return [event.level for event in events]


def test_a_good_run_reports_nothing(monitor: HealthMonitor) -> None:
    assert list(monitor.observations(frames(300))) == []


def test_one_bad_frame_in_ten_is_not_reported(monitor: HealthMonitor) -> None:
    seen = np.where(np.arange(300) % 10 == 0, DetectionStatus.NO_BOARD, DetectionStatus.MEASURED)
    assert list(monitor.observations(frames(300, seen=seen))) == []


@pytest.mark.parametrize(
    ("trouble", "says"),
    [
        ({"seen": DetectionStatus.NO_BOARD}, "no board"),
        ({"seen": DetectionStatus.NO_FRAME}, "repeats"),
        ({"model_ok": 0}, "model cannot be solved"),
        ({"dropped": 9}, "drops"),
        ({"age_ns": 400_000_000}, "0.40 s old"),
    ],
)
def test_a_condition_is_reported_once_when_it_begins_and_once_when_it_ends(
    monitor: HealthMonitor, trouble: dict[str, object], says: str
) -> None:
    (begun,) = monitor.observations(frames(90, **trouble))
    assert (begun.level, says in begun.message) == (Level.WARNING, True)
    assert begun.message.endswith("the run continues")
    (over,) = monitor.observations(frames(300, 90))
    assert over.level is Level.INFO
    assert "after" in over.message


@pytest.mark.parametrize("pace", [0.8, 1.2])
def test_a_camera_with_another_rate_than_the_rig_states_is_reported(monitor: HealthMonitor, pace: float) -> None:
    rows = frames(150)
    rows["t_ns"] = 10**9 + np.arange(150) * round(pace * FRAME_NS)
    (told,) = monitor.observations(rows)
    assert told.level is Level.WARNING
    assert "pictures a second and the rig says 30" in told.message


def test_a_camera_whose_pictures_are_stamped_unevenly_keeps_its_pace(monitor: HealthMonitor) -> None:
    rows = frames(300)
    rows["t_ns"] += np.random.default_rng(0).integers(-8_000_000, 8_000_000, 300)
    assert list(monitor.observations(rows)) == []


def test_missed_deadlines_and_lost_scans_are_reported(monitor: HealthMonitor) -> None:
    rows = np.zeros(400, sample_dtype(3, 2))
    rows["t_ns"] = 10**9 + np.arange(400) * 3 * CYCLE_NS
    rows["missed"] = 2
    (told,) = monitor.samples(rows)
    assert "deadlines" in told.message
    assert list(monitor.lost(0, 0)) == []
    assert levels(list(monitor.lost(0, 5))) == [Level.WARNING]
    assert list(monitor.damaged(0, 0)) == []
    assert levels(list(monitor.damaged(0, 5))) == [Level.WARNING]
    assert levels(list(monitor.repeated(0, 5))) == [Level.WARNING]


def test_a_tenth_of_the_deadlines_missed_in_a_second_is_reported_during_the_run(monitor: HealthMonitor) -> None:
    """A control process that is stopped for 12 ms repeatedly is reported during the run."""
    rows = np.zeros(200, sample_dtype(3, 2))
    rows["missed"][::10] = 1
    rows["t_ns"] = 10**9 + np.cumsum(1 + rows["missed"]) * CYCLE_NS
    (told,) = monitor.samples(rows)
    assert "of the deadlines are missed" in told.message
    assert told.t_ns < 10**9 + 1_000_000_000


def late(rows: int = 200) -> np.ndarray:  # type: ignore[type-arg]
    """Control cycles of which every other follows a missed deadline."""
    found = np.zeros(rows, sample_dtype(3, 2))
    found["missed"][::2] = 1
    found["t_ns"] = 10**9 + np.cumsum(1 + found["missed"]) * CYCLE_NS
    return found


def test_deadlines_that_a_slow_driver_costs_name_the_driver_and_its_call(monitor: HealthMonitor) -> None:
    monitor.slow_calls(100, 1, 0, 30_000_000)
    (told,) = monitor.samples(late(60))
    assert "`write` of the driver of card daq takes 30.0 ms, the control period is 5 ms" in told.message
    assert "too busy" not in told.message


def test_few_slow_calls_do_not_hide_that_the_machine_is_too_busy(monitor: HealthMonitor) -> None:
    monitor.slow_calls(1, 1, 0, 30_000_000)
    (told,) = monitor.samples(late())
    assert "the machine is too busy" in told.message
    assert "driver" not in told.message


def test_a_single_missed_deadline_is_not_reported(monitor: HealthMonitor) -> None:
    rows = np.zeros(400, sample_dtype(3, 2))
    rows["t_ns"] = 10**9 + np.arange(400) * CYCLE_NS
    rows["missed"][200] = 2
    assert list(monitor.samples(rows)) == []


def test_a_gap_in_the_record_is_reported(monitor: HealthMonitor) -> None:
    looks = [10**9, 10**9 + 20_000_000, 10**9 + 1_220_000_000]
    told = [event for t_ns in looks for event in monitor.supervisor_stall(t_ns)]
    assert [event.message[:32] for event in told] == ["nothing was recorded for 1.20 s,"]


def test_a_stalled_disk_is_reported_once_and_its_end_once(monitor: HealthMonitor) -> None:
    looks = [(0.0, 0.0), (1.0, 0.9), (2.5, 2.4), (3.0, 2.9), (4.0, 0.0), (5.0, 0.1)]
    told = [event for t_s, standing_s in looks for event in monitor.disk(10**9 + round(t_s * 1e9), standing_s)]
    assert [event.message for event in told] == [
        "the disk has not taken the record for 2.4 s, which is kept in memory meanwhile: "
        "is another program writing to it?; the run continues",
        "the disk takes the record again, after 3.90 s",
    ]


def test_losses_that_repeat_are_one_warning_at_once_and_then_one_with_their_number() -> None:
    monitor = HealthMonitor(rig.config.loader.load("mock"))
    said = [
        [event.message for event in monitor.damaged(k * 100_000_000, 3)] for k in range(round(2 * REPEATED_S / 0.1))
    ]
    told = [(k, *messages) for k, messages in enumerate(said) if messages]
    first, second = "3 damaged lines between", f"{3 * round(REPEATED_S / 0.1)} damaged lines between"
    assert [(k, message.startswith(begin)) for (k, message), begin in zip(told, (first, second), strict=True)] == [
        (0, True),
        (round(REPEATED_S / 0.1), True),
    ]
    (rest,) = monitor.rest(10**12)
    assert rest.message.startswith(f"{3 * round(REPEATED_S / 0.1) - 3} damaged lines")
    assert not list(monitor.rest(10**12))


def test_a_loss_long_after_another_is_reported_at_once() -> None:
    monitor = HealthMonitor(rig.config.loader.load("mock"))
    assert len(list(monitor.lost(0, 5))) == 1
    assert not list(monitor.lost(round(REPEATED_S * 1e9), 0))
    assert len(list(monitor.lost(round(REPEATED_S * 1e9), 1))) == 1
