"""The rendered scene as a V4L2 camera: pictures of the arm under pressure, played into v4l2loopback.

`python played_pictures.py render FILE` renders one for each level of actuator 1 (and has every kernel that a run needs
compiled on the way); `python played_pictures.py play FILE DEVICE` plays them for ever, the one that belongs to the
voltage at which the card's first valve stands.
"""

from __future__ import annotations

import os
import sys
import time
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from model.statics import statics
from model.units import PA_PER_BAR
from rig.config.arm_model import model_arm
from rig.config.loader import load
from rig.hardware.cameras.base import FrameSet
from rig.hardware.cards.base import Channel
from rig.hardware.cards.comedi import ComediCard
from rig.observation.observer import Observer
from rig.simulator.mock_camera import MockCamera
from rig.simulator.tip_pose import TipPose
from runs.records import DetectionStatus
from tests.hardware.kernel_card import CARD
from tests.hardware.rig_of_the_machine import LOOPED, VALVES
from tests.hardware.v4l2_output import open_output
from tests.support.card_setups import comedi_setup
from tests.support.control_cycles import control_cycles

LEVELS_BAR = tuple(np.arange(0.0, 0.66, 0.05).round(2).tolist())
RATE_HZ = 5


@dataclass(frozen=True)
class _StandingStill:
    position_m: NDArray[np.float64]
    rotation: NDArray[np.float64]

    def pose_at(self, t_ns: int) -> TipPose:
        return TipPose(t_ns, self.position_m, self.rotation)


def render(target: Path) -> None:
    """Write pictures (n, height, width) and their true tips (n, 3) [m]."""
    scene, looped = load("mock"), load(LOOPED)
    arm, observer = model_arm(scene), Observer(looped)
    pictures, tips = [], []
    for number, level in enumerate(LEVELS_BAR):
        pressure_pa = np.array([[level * PA_PER_BAR, 0.0, 0.0]])
        shape = statics(arm, pressure_pa[0])
        camera = MockCamera(scene, _StandingStill(shape.tip_m, shape.tip_rotation))
        frame = camera.frame_at(number, number * 10**9 // RATE_HZ)
        seen = observer.step(FrameSet.of(frame), control_cycles([frame.t_ns], pressure_pa), 0.0)
        if seen["seen"] != DetectionStatus.MEASURED or not seen["model_ok"]:
            raise SystemExit(f"the picture at {level} bar cannot be measured and modelled: {seen}")
        pictures.append(frame.image)
        tips.append(frame.truth_m)
    np.savez_compressed(target, pictures=np.array(pictures), tips=np.array(tips))


def yuyv(grey: NDArray[np.uint8]) -> bytes:
    """Grey of full range as YUYV of video range, which is what readers expect of it."""
    luma = 16 + grey.astype(np.float64) * (219 / 255)
    packed = np.full((*grey.shape, 2), 128, np.uint8)
    packed[:, :, 0] = np.rint(luma)
    return packed.tobytes()


def play(source: Path, device: str) -> None:
    """Play until killed."""
    with np.load(source) as stored:
        pictures = stored["pictures"]
    height, width = pictures.shape[1:]
    frames = [bytearray(yuyv(picture)) for picture in pictures]
    valve = ComediCard(comedi_setup(CARD, (), (Channel(VALVES[0], 0.0, 10.0),)))
    node = open_output(device, width, height)
    print("playing", flush=True)
    due = time.monotonic()
    while True:
        bar = float(valve.readback()[0]) / 10
        frame = frames[int(np.argmin(np.abs(np.array(LEVELS_BAR) - bar)))]
        frame[: 2 * width : 2] = os.urandom(width)  # a camera never gives the same picture twice
        os.write(node, frame)
        due = max(due + 1 / RATE_HZ, time.monotonic())
        time.sleep(max(0.0, due - time.monotonic()))


if __name__ == "__main__":
    verb, path, *rest = sys.argv[1:]
    if verb == "render":
        render(Path(path))
    else:
        play(Path(path), *rest)
