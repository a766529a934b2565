"""Measured tip and modelled tip, frame by frame."""

from __future__ import annotations

import numpy as np
import pytest

import rig.config.loader
import rig.config.schema
from rig.hardware.cameras.base import Frame, FrameSet
from rig.observation.observer import Observer
from rig.observation.sample_interpolator import SampleInterpolator
from rig.simulator.mock_camera import MockCamera
from runs.records import DetectionStatus
from tests.support.control_cycles import control_cycles
from tests.support.vision_bench import FRAME_NS, Sweep

EMPTY_T, EMPTY_PA = np.empty(0, np.int64), np.empty((0, 3))
SCANS_NS = np.arange(0, 2_000_000_000, 5_000_000)


@pytest.fixture(scope="module")
def config() -> rig.config.schema.RigConfig:
    return rig.config.loader.load("mock")


@pytest.fixture(scope="module")
def camera(config: rig.config.schema.RigConfig) -> MockCamera:
    return MockCamera(config, Sweep(), seed=1)


def _pressures(scans_ns: np.ndarray, bar: float) -> np.ndarray:
    pa = np.zeros((len(scans_ns), 3))
    pa[:, 0] = bar * 1e5 * np.clip(scans_ns * 1e-9, 0, 1)
    return pa


def _cycles(scans_ns: np.ndarray) -> np.ndarray:
    return control_cycles(scans_ns, _pressures(scans_ns, 0.3))


def test_a_frame_becomes_a_row_with_measured_true_and_modelled_tip(
    config: rig.config.schema.RigConfig, camera: MockCamera
) -> None:
    observer = Observer(config)
    row = observer.step(FrameSet.of(camera.frame_at(3, 10**9)), _cycles(SCANS_NS), 0.9, dropped=2)
    assert (row["frame"], row["t_ns"], row["protocol_s"], row["dropped"]) == (3, 10**9, 0.9, 2)
    assert row["seen"] == DetectionStatus.MEASURED
    assert row["model_ok"] == 1
    assert np.linalg.norm(row["measured_m"] - row["truth_m"]) < 1e-3
    assert np.all(np.linalg.eigvalsh(row["covariance_m2"]) > 0)
    assert 0 < row["reprojection_px"] < 0.3
    assert row["pressure_pa"] == pytest.approx([0.3e5, 0, 0])


def test_pressures_are_read_between_the_samples() -> None:
    pressures = SampleInterpolator(1)
    start = 5_000_000_000_000_000_001
    pressures.extend(np.array([start, start + 10]), np.array([[1.0], [2.0]]))
    pressures.extend(np.array([start + 10, start + 20]), np.array([[99.0], [4.0]]))
    assert pressures.at(start + 5) == pytest.approx([1.5])
    assert pressures.at(start + 15) == pytest.approx([3.0])
    assert pressures.at(start - 9) == pytest.approx([1.0])
    assert pressures.at(start + 900) == pytest.approx([4.0])


def test_in_motion_the_model_lags_the_static_shape(config: rig.config.schema.RigConfig, camera: MockCamera) -> None:
    moving, resting = (
        Observer(config.model_copy(update={"model": config.model.model_copy(update={"mode": mode})}))
        for mode in ("dynamic", "static")
    )
    pa = np.zeros((len(SCANS_NS), 3))
    pa[SCANS_NS > 20_000_000, 0] = 0.3e5  # a step just after the first frame
    cycles = control_cycles(SCANS_NS, pa)
    first = [o.step(FrameSet.of(camera.frame_at(0, 0)), cycles, 0.0) for o in (moving, resting)]
    assert np.allclose(first[0]["model_m"], first[1]["model_m"], atol=1e-5)
    second = [o.step(FrameSet.of(camera.frame_at(1, FRAME_NS)), cycles, 0.0) for o in (moving, resting)]
    assert second[1]["model_m"][0] < first[1]["model_m"][0] - 0.01
    assert np.linalg.norm(second[0]["model_m"] - second[1]["model_m"]) > 0.002


def test_after_lost_frames_the_model_has_taken_every_step_in_between(
    config: rig.config.schema.RigConfig, camera: MockCamera
) -> None:
    cycles = control_cycles(SCANS_NS, _pressures(SCANS_NS, 0.4))
    whole, gappy = Observer(config), Observer(config)
    rows = [whole.step(FrameSet.of(camera.frame_at(k, k * FRAME_NS)), cycles, 0.0) for k in range(8)]
    for k in (0, 3, 7):
        last = gappy.step(FrameSet.of(camera.frame_at(k, k * FRAME_NS)), cycles, 0.0)
    assert np.allclose(last["model_m"], rows[-1]["model_m"], atol=1e-7)


@pytest.mark.slow
@pytest.mark.parametrize("rate_hz", [15.0, 24.0, 40.0])
def test_a_camera_at_another_rate_than_stated_changes_nothing_in_the_model(
    config: rig.config.schema.RigConfig, rate_hz: float
) -> None:
    scans_ns = np.arange(0, 1_500_000_000, 5_000_000)
    pa = np.zeros((len(scans_ns), 3))
    pa[:, 0] = 0.3e5 * (1 - np.cos(10 * scans_ns * 1e-9))
    image = np.full((480, 640), 80, np.uint8)

    def tips(rate_hz: float, stated_hz: float) -> dict[int, np.ndarray]:
        camera = config.cameras["front"].model_copy(update={"rate_hz": stated_hz})
        observer = Observer(config.model_copy(update={"cameras": {"front": camera}}))
        found = {}
        for k in range(int(rate_hz * 1.2) + 1):
            t_ns = round(k * 1e9 / rate_hz)
            row = observer.step(FrameSet.of(Frame(k, t_ns, image)), control_cycles(scans_ns, pa), 0.0)
            found[t_ns] = np.array(row["model_m"])
        return found

    fine, stated, other = tips(240.0, 240.0), tips(30.0, 30.0), tips(rate_hz, 30.0)

    def error_m(found: dict[int, np.ndarray]) -> float:
        times = np.array(list(fine))
        paths = np.array(list(fine.values()))
        exact = [np.array([np.interp(t, times, paths[:, c]) for c in range(3)]) for t in found]
        return float(np.sqrt(np.mean(np.square(np.array(list(found.values())) - exact))))

    # The error of a step grows with its square; the stated rate has no say in it.
    assert error_m(other) < 1.3 * error_m(stated) * max(1.0, 30.0 / rate_hz) ** 2


def test_without_a_board_the_measured_columns_are_nan_and_the_model_continues(
    config: rig.config.schema.RigConfig,
) -> None:
    observer = Observer(config)
    row = observer.step(
        FrameSet.of(Frame(0, 0, np.full((480, 640), 80, np.uint8))),
        _cycles(SCANS_NS),
        0.0,
    )
    assert row["seen"] == DetectionStatus.NO_BOARD
    assert np.all(np.isnan(row["measured_m"]))
    assert np.all(np.isnan(row["covariance_m2"]))
    assert np.all(np.isnan(row["truth_m"]))
    assert row["model_ok"] == 1
    assert np.all(np.isfinite(row["model_m"]))


@pytest.mark.parametrize("mode", ["dynamic", "static"])
def test_where_the_model_cannot_be_solved_the_last_good_tip_stays_and_is_marked(
    config: rig.config.schema.RigConfig, camera: MockCamera, mode: str
) -> None:
    chosen = config.model_copy(update={"model": config.model.model_copy(update={"mode": mode})})
    observer = Observer(chosen)
    good = observer.step(FrameSet.of(camera.frame_at(0, 0)), _cycles(SCANS_NS[:1]), 0.0)
    later = SCANS_NS[1:8]
    bad = observer.step(FrameSet.of(camera.frame_at(1, FRAME_NS)), control_cycles(later, np.full((7, 3), np.nan)), 0.0)
    assert good["model_ok"] == 1
    assert bad["model_ok"] == 0
    assert np.array_equal(bad["model_m"], good["model_m"])
    fresh = SCANS_NS[8:15]
    again = observer.step(FrameSet.of(camera.frame_at(2, 2 * FRAME_NS)), _cycles(fresh), 0.0)
    assert again["model_ok"] == 1


def test_without_any_pressure_there_is_no_modelled_tip(config: rig.config.schema.RigConfig, camera: MockCamera) -> None:
    row = Observer(config).step(FrameSet.of(camera.frame_at(0, 0)), control_cycles(EMPTY_T, EMPTY_PA), 0.0)
    assert row["model_ok"] == 0
    assert np.all(np.isnan(row["model_m"]))
    assert np.all(np.isnan(row["pressure_pa"]))
    assert row["seen"] == DetectionStatus.MEASURED


def test_the_stated_interval_holds_the_truth(config: rig.config.schema.RigConfig) -> None:
    """The mock's promise: 95 % intervals hold the truth in 90-99 % of frames, and under 1 mm in the plane."""
    from rig.observation.camera_estimator import CameraTipEstimator

    camera, eye = MockCamera(config, Sweep(), seed=11), CameraTipEstimator(config)
    held, plane = [], []
    for k in range(300):
        frame = camera.frame_at(k, 10**9 + k * FRAME_NS)
        seen = eye.measure(FrameSet.of(frame))
        assert seen.seen is DetectionStatus.MEASURED
        error = seen.tip_m - frame.truth_m
        held.append(np.abs(error) < 1.96 * np.sqrt(np.diag(seen.covariance_m2)))
        plane.append(np.hypot(error[0], error[2]))
    share = np.mean(held, axis=0)
    assert np.all((share >= 0.90) & (share <= 0.99)), share
    assert max(plane) < 1e-3
    assert np.quantile(plane, 0.95) < 0.5e-3
