"""A rig whose tip a tracker measures, in virtual time: no camera, a sender with its own clock, losses and silence."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from rig.config import loader
from rig.simulator.faults import CameraFault, Faults
from rig.simulator.mock_tracker import LEAD_S
from runs.records import DATAGRAM_COUNTS, DetectionStatus, Status
from runs.run import Run
from tests.support.virtual_runs import protocol_file, virtual_run

pytestmark = pytest.mark.slow

STEPS = "  - ramp: {actuators: [1], to_bar: 0.3, duration_s: 1}\n  - hold: {duration_s: 0.5}\n"
TEXT = loader.text("mock-tracker")


def run_tracked(folder: Path, tracker: str = "", steps: str = STEPS, adapt: bool = False) -> Run:
    """A run of the rig mock-tracker, with more keys of its tracker."""
    folder.mkdir(parents=True, exist_ok=True)
    rig = folder / "rig.yaml"
    rig.write_text(
        TEXT.replace("drift_ppm: 50, " if "drift_ppm" in tracker else "", "").replace(
            "jitter_ms: 1}", f"jitter_ms: 1{tracker}}}"
        ),
        encoding="utf-8",
    )
    return virtual_run(protocol_file(folder, steps), rig, folder=folder / "data", seed=2, adapt=adapt)


def messages(run: Run) -> dict[str, int]:
    """The counts at the end of a run."""
    assert run.tracker is not None
    told = run.tracker.messages[run.tip.seen == DetectionStatus.MEASURED]
    return dict(zip(DATAGRAM_COUNTS, told[-1].tolist(), strict=True))


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> Run:
    """A ramp whose tip the tracker measures."""
    return run_tracked(tmp_path_factory.mktemp("tracker"))


def test_a_tracker_measures_the_tip_of_a_rig_without_cameras(run: Run) -> None:
    assert run.status is Status.FINISHED
    assert run.header.cameras == ()
    assert run.header.tracker == "pose"
    assert (run.tip.seen == DetectionStatus.MEASURED).all()
    assert np.median(np.diff(run.tip.time_s)) == pytest.approx(0.01, abs=1e-4)
    assert run.simulated is not None
    error_mm = np.linalg.norm(run.tip.measured_mm - run.simulated.tip_mm, axis=1)
    assert np.sqrt(np.mean(error_mm**2)) == pytest.approx(0.1 * np.sqrt(3), rel=0.3)
    assert run.tip.model_ok.all()
    assert np.isfinite(run.tip.error_mm).all()


def test_the_archive_keeps_offset_and_drift_of_the_senders_clock(run: Run) -> None:
    clock = run.tracker
    assert clock is not None
    assert abs(clock.clock_drift_ppm[-1] + 50) < 40
    # The offset contains the constant delay of 2 ms: one-way messages cannot tell them apart.
    since_first_s = clock.time_s + LEAD_S
    true_s = run.header.started_t_ns * 1e-9 - LEAD_S - 1_700_000_000 - 50e-6 * since_first_s + 2e-3
    assert np.all(np.abs(clock.clock_offset_s - true_s) < 6 * clock.clock_uncertainty_us * 1e-6 + 2e-6)
    assert np.all(clock.time_uncertainty_us >= 200)


def test_the_archive_keeps_the_stated_delay_with_its_uncertainty(run: Run) -> None:
    (delay,) = [q for q in run.header.quantities if q.name == "pose_delay"]
    assert (delay.value, delay.unit, delay.uncertainty) == ((2.0,), "ms", 0.2)


def test_two_runs_with_the_same_seed_are_equal_bit_for_bit(run: Run, tmp_path: Path) -> None:
    again = run_tracked(tmp_path)
    assert np.array_equal(again.tip.measured_mm, run.tip.measured_mm, equal_nan=True)
    assert np.array_equal(again.tip.time_s, run.tip.time_s)
    assert again.tracker is not None
    assert run.tracker is not None
    assert np.array_equal(again.tracker.clock_offset_s, run.tracker.clock_offset_s)


def test_lost_and_doubled_messages_are_counted(tmp_path: Path) -> None:
    run = run_tracked(tmp_path, ", lost: 0.2, doubled: 0.1")
    counts = messages(run)
    assert run.status is Status.FINISHED
    sent = (LEAD_S + run.tip.time_s[-1]) * 100
    assert counts["lost"] == pytest.approx(0.2 * sent, abs=4 * np.sqrt(0.16 * sent))
    assert counts["doubled"] > 0
    assert run.tip.dropped.sum() > 0
    assert (np.diff(run.tip.time_s) > 0).all()


def test_a_step_of_the_senders_clock_is_found(tmp_path: Path) -> None:
    run = run_tracked(tmp_path, ", step_ms: -300, step_s: 2.5", steps="  - hold: {duration_s: 4}\n")
    assert messages(run)["clock_steps"] == 1
    assert [e.message for e in run.events if "clock of the tracker" in e.message]
    assert run.simulated is not None
    measured = run.tip.seen == DetectionStatus.MEASURED
    assert measured[-50:].all()
    assert not measured.all()
    error_mm = np.linalg.norm(run.tip.measured_mm - run.simulated.tip_mm, axis=1)
    assert np.nanmax(error_mm) < 1


def test_a_clock_that_drifts_faster_than_stated_is_reported_and_its_times_are_less_certain(tmp_path: Path) -> None:
    run = run_tracked(tmp_path, ", drift_ppm: 500", steps="  - hold: {duration_s: 7}\n")
    (event,) = [event for event in run.events if "largest_drift_ppm" in event.message]
    assert "by more than largest_drift_ppm, 200" in event.message
    assert messages(run)["clock_steps"] == 0
    clock = run.tracker
    assert clock is not None
    true_s = run.header.started_t_ns * 1e-9 - LEAD_S - 1_700_000_000 - 500e-6 * (clock.time_s + LEAD_S) + 2e-3
    error_s = np.abs(clock.clock_offset_s - true_s)
    assert np.mean(error_s <= 1.96e-6 * clock.clock_uncertainty_us + 2e-6) > 0.9


def test_silence_is_no_measurement_and_then_ends_the_run(tmp_path: Path) -> None:
    steps = "  - hold: {duration_s: 4}\n"
    (tmp_path / "rig.yaml").write_text(TEXT)
    normal = Faults.camera
    calls = [0]

    def silent_later(faults: Faults, number: int) -> CameraFault:
        calls[0] += 1
        return CameraFault.SILENT if calls[0] > 300 else normal(faults, number)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(Faults, "camera", silent_later)
        run = virtual_run(protocol_file(tmp_path, steps), tmp_path / "rig.yaml", folder=tmp_path / "data", seed=0)
    assert run.status is Status.ABORTED
    assert "tracker pose: no pose within 1 s" in run.message
    seen = run.tip.seen
    assert seen[-1] == DetectionStatus.NO_MESSAGE
    assert np.isnan(run.tip.measured_mm[seen == DetectionStatus.NO_MESSAGE]).all()
    assert np.count_nonzero(seen == DetectionStatus.NO_MESSAGE) > 50


def test_the_online_estimator_uses_the_poses_of_a_tracker(tmp_path: Path) -> None:
    run = run_tracked(tmp_path, adapt=True)
    assert run.adaptation is not None
    assert len(run.adaptation.time_s) == len(run.tip.time_s)
    assert np.nanmean(run.tip.error_mm[-50:]) < 0.5
