"""The rendered camera has a steady clock, gaps when the reader is late, and a known truth."""

from __future__ import annotations

import time

import numpy as np
import pytest

import rig.config.loader
import rig.config.schema
from rig.hardware.cameras.base import CameraError
from rig.simulator.mock_camera import MockCamera
from rig.simulator.tip_pose import TipPose
from tests.support.vision_bench import FRAME_NS, Sweep

DELAY_MS = 40.0


@pytest.fixture(scope="module")
def config() -> rig.config.schema.RigConfig:
    return rig.config.loader.load("mock")


def test_a_frame_in_virtual_time_is_repeatable_and_knows_the_truth(config: rig.config.schema.RigConfig) -> None:
    one, other = MockCamera(config, Sweep(), seed=3), MockCamera(config, Sweep(), seed=3)
    for k in (0, 1, 5):
        a, b = one.frame_at(k, k * FRAME_NS), other.frame_at(k, k * FRAME_NS)
        assert np.array_equal(a.image, b.image)
        assert (a.index, a.t_ns) == (k, k * FRAME_NS)
        assert a.truth_m is not None
        assert np.array_equal(a.truth_m, Sweep().pose_at(a.t_ns).position_m)


@pytest.fixture(scope="module")
def late() -> rig.config.schema.RigConfig:
    """The rig with a camera whose driver gives times that are late."""
    text = rig.config.loader.text("mock")
    return rig.config.loader.parse(
        text.replace("  scene: {", f"  scene: {{stamp_delay_ms: {DELAY_MS:g}, "), "late.yaml"
    )


def test_the_truth_is_that_of_the_time_that_a_late_driver_gives(late: rig.config.schema.RigConfig) -> None:
    frame = MockCamera(late, Sweep(), seed=3).frame_at(1, FRAME_NS)
    assert frame.t_ns == FRAME_NS + DELAY_MS * 1e6
    assert np.array_equal(frame.truth_m, Sweep().pose_at(frame.t_ns).position_m)


@pytest.mark.realtime
def test_a_picture_comes_once_the_pose_at_its_late_time_is_known(late: rig.config.schema.RigConfig) -> None:
    camera = MockCamera(late, Sweep(), seed=3)
    for frame in [camera.read(1.0) for _ in range(3)]:
        assert frame.t_ns < time.monotonic_ns()
        assert np.array_equal(frame.truth_m, Sweep().pose_at(frame.t_ns).position_m)


@pytest.mark.realtime
def test_real_time_frames_lie_on_the_cameras_grid_and_follow_one_another(config: rig.config.schema.RigConfig) -> None:
    camera = MockCamera(config, Sweep(), seed=3)
    camera.read(1.0)  # compiles or loads the renderer
    frames = [camera.read(1.0) for _ in range(4)]
    period = round(1e9 / config.cameras["front"].rate_hz)
    steps = np.diff([f.t_ns for f in frames])
    gaps = np.diff([f.index for f in frames])
    assert np.array_equal(steps, gaps * period)
    assert np.all(gaps >= 1)
    assert frames[-1].t_ns < time.monotonic_ns()


@pytest.mark.realtime
def test_a_late_reader_sees_a_gap_and_never_an_old_picture(config: rig.config.schema.RigConfig) -> None:
    camera = MockCamera(config, Sweep(), seed=3)
    first = camera.read(1.0)
    time.sleep(0.2)
    before = time.monotonic_ns()
    second = camera.read(1.0)
    assert second.index - first.index >= 5
    assert second.t_ns > before - 1.6e9 / 30


@pytest.mark.realtime
def test_a_camera_slower_than_the_time_out_is_reported(config: rig.config.schema.RigConfig) -> None:
    slow = config.model_copy(update={"cameras": {"front": config.cameras["front"].model_copy(update={"rate_hz": 5.0})}})
    camera = MockCamera(slow, Sweep(), seed=3)
    camera.start()
    # Begun at the start of an exposure, a period before the next.
    camera.read(3.0)
    with pytest.raises(CameraError, match="no picture within"):
        camera.read(0.02)


def test_a_dead_simulator_is_a_camera_error(config: rig.config.schema.RigConfig) -> None:
    class Dead:
        def pose_at(self, t_ns: int) -> TipPose:
            raise LookupError("no pose")

    with pytest.raises(CameraError, match="has stalled"):
        MockCamera(config, Dead()).read(1.0)


def test_a_rig_without_a_simulator_has_no_rendered_camera(config: rig.config.schema.RigConfig) -> None:
    with pytest.raises(CameraError, match="simulator"):
        MockCamera(config.model_copy(update={"simulator": None}), Sweep())
