"""The rig of the virtual machine, and the pictures that are played in it."""

from __future__ import annotations

import subprocess
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

HERE = Path(__file__).parent
LOOPED = str(HERE / "looped.yaml")
STEPS = str(HERE / "steps.yaml")
SLOW_RAMP = str(HERE / "slow_ramp.yaml")
CAMERA = "/dev/video9"
VALVES = (0, 3, 5)
"""Outputs of the valves, in the order of the actuators."""


@dataclass(frozen=True)
class Player:
    """What is played: the true tips (n, 3) [m] of the pictures, and the process that plays them."""

    tips_m: NDArray[np.float64]
    process: subprocess.Popen[bytes]
