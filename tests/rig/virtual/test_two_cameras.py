"""Two cameras in a run: paired, measured together, recorded with their skew; the run survives the loss of one."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import runs
from rig.config.loader import load
from rig.config.schema import RigConfig
from rig.experiment.replay import replay
from rig.hardware.cameras.base import Frame, FrameSet
from rig.observation.camera_estimator import CameraTipEstimator
from rig.realtime.health_monitor import HealthMonitor
from rig.simulator.mock_camera import MockCamera
from runs.records import DetectionStatus, Level, observation_dtype
from runs.run import Run
from tests.support.virtual_runs import protocol_file, virtual_run
from tests.support.vision_bench import FRAME_NS, Sweep

pytestmark = pytest.mark.slow

STEPS = "  - sine: {actuators: [1], mean_bar: 0.3, amplitude_bar: 0.2, omega_rad_s: 2, periods: 2, lead_in_s: 1}\n"


STARTS = "".join(
    f"  - ramp: {{actuators: [1], to_bar: {bar}, duration_s: 0.4}}\n  - hold: {{duration_s: 0.2}}\n"
    for bar in (0.3, 0.1, 0.4, 0.2, 0.5, 0.1)
)


def run_of(folder: Path, rig: str, steps: str = STEPS) -> Run:
    return virtual_run(protocol_file(folder, steps), rig, folder=folder / rig, seed=2)


@pytest.fixture(scope="module")
def stereo(tmp_path_factory: pytest.TempPathFactory) -> Run:
    """A sine seen by two cameras."""
    return run_of(tmp_path_factory.mktemp("stereo"), "mock-stereo")


@pytest.fixture(scope="module")
def config() -> RigConfig:
    return load("mock-stereo")


def errors(run: Run) -> tuple[np.ndarray, np.ndarray]:
    """Errors (m, 3) [mm] of the measured frames, and their squared distances in the stated uncertainty."""
    seen = run.tip.seen == DetectionStatus.MEASURED
    assert run.simulated is not None
    error = run.tip.measured_mm[seen] - run.simulated.tip_mm[seen]
    return error, np.einsum("ni,nij,nj->n", error, np.linalg.inv(run.tip.covariance_mm2[seen]), error)


def test_two_cameras_hold_the_truth_and_err_less_than_one(stereo: Run, tmp_path: Path) -> None:
    error, distances = errors(stereo)
    assert len(error) > 0.98 * len(stereo.tip.seen)
    assert 0.88 <= np.mean(distances < 7.815) <= 1.0  # of some 200 frames, which one path links
    alone, _ = errors(run_of(tmp_path, "mock-ideal", STEPS.replace("periods: 2", "periods: 1")))
    assert np.linalg.norm(error, axis=1).mean() < 0.5 * np.linalg.norm(alone, axis=1).mean()


def test_the_truth_is_held_where_the_arm_starts_and_stops_between_two_exposures(tmp_path: Path) -> None:
    _, distances = errors(run_of(tmp_path, "mock-stereo", STARTS))
    assert np.mean(distances < 7.815) > 0.88
    assert distances.max() < 200


def test_the_archive_names_the_cameras_what_each_saw_and_their_skew(stereo: Run) -> None:
    assert stereo.header.cameras == ("left", "right")
    assert np.mean(stereo.tip.camera_seen == DetectionStatus.MEASURED, axis=0).min() > 0.98
    assert np.all(stereo.tip.camera_skew_us[:, 0] == 0)
    assert stereo.tip.camera_skew_us[:, 1] == pytest.approx(2000)
    assert set(stereo.frames.camera) == {"left", "right"}


def test_a_replay_measures_again_with_both(stereo: Run, tmp_path: Path) -> None:
    again = runs.open(replay(stereo, tmp_path))
    assert again.header.cameras == ("left", "right")
    assert np.all(again.tip.camera_seen[1:] == DetectionStatus.MEASURED)
    rows = np.searchsorted(stereo.tip.frame, again.tip.frame)
    off = again.tip.measured_mm[1:] - stereo.tip.measured_mm[rows][1:]
    assert np.linalg.norm(off, axis=1).mean() < 0.05


def frame_sets(config: RigConfig, count: int, lose: int | None = None) -> list[FrameSet]:
    cameras = [MockCamera(config, Sweep(), name, 5) for name in config.cameras]
    found = []
    for k in range(count):
        frames: list[Frame | None] = [camera.frame_at(k, 10**9 + k * FRAME_NS) for camera in cameras]
        if lose is not None and k >= count // 2:
            frames[lose] = None
        found.append(FrameSet(k, tuple(frames)))
    return found


@pytest.mark.parametrize("lose", [0, 1])
def test_a_camera_that_is_lost_leaves_the_other_to_measure(config: RigConfig, lose: int) -> None:
    eyes = CameraTipEstimator(config)
    seen = [eyes.measure(frame_set) for frame_set in frame_sets(config, 8, lose)]
    assert all(m.seen is DetectionStatus.MEASURED for m in seen)
    assert seen[3].cameras == (DetectionStatus.MEASURED, DetectionStatus.MEASURED)
    assert seen[-1].cameras[lose] is DetectionStatus.NO_FRAME
    assert seen[-1].cameras[1 - lose] is DetectionStatus.MEASURED
    assert np.trace(seen[-1].covariance_m2) > 4 * np.trace(seen[3].covariance_m2)


def test_contradicting_cameras_give_no_measurement(config: RigConfig) -> None:
    """One camera was displaced by 10 mm after its calibration."""
    left = config.cameras["left"]
    x, y, z = left.placement.translation_mm
    pushed = left.placement.model_copy(update={"translation_mm": (x, y, z + 10.0)})
    cameras = {**config.cameras, "left": left.model_copy(update={"placement": pushed})}
    eyes = CameraTipEstimator(config.model_copy(update={"cameras": cameras}))
    for frame_set in frame_sets(config, 3):
        measured = eyes.measure(frame_set)
        assert measured.seen is DetectionStatus.DISAGREE
        assert np.all(np.isnan(measured.tip_m))


def test_the_loss_and_the_return_of_one_camera_are_reported(config: RigConfig) -> None:
    rows = np.zeros(300, observation_dtype(3, 2))
    rows["t_ns"] = 10**9 + np.arange(300) * FRAME_NS
    rows["model_ok"] = 1
    rows["camera_seen"][60:150, 1], rows["camera_skew_s"][60:150, 1] = DetectionStatus.NO_FRAME, np.nan
    lost, back = HealthMonitor(config).observations(rows)
    assert (lost.level, back.level) == (Level.WARNING, Level.INFO)
    assert "camera right gives no pictures; the tip is measured without it" in lost.message
    assert "camera right" in back.message
