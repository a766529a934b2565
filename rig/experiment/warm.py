"""`python -m rig.experiment.warm`: precompile the kernels; part of the installation."""

from __future__ import annotations

import sys

from model import warm as model_kernels
from runs.records import DetectionStatus

SETTLED_NS, FRAME_NS = 100_000_000, 33_333_333


def main() -> int:
    """Compile the rod's and the plant's kernels into the cache on disk; the exit status."""
    if status := model_kernels.main():
        return status
    if not (measure_frames() and measure_frames("mock-charuco")):
        print("rig.experiment.warm: failed: the simulated camera did not see the board", file=sys.stderr)
        return 1
    print("rig.experiment.warm: simulator and vision are ready")
    return 0


def measure_frames(rig: str = "mock") -> bool:
    """Render and measure frames of a mock rig, which loads or compiles every kernel for it.

    False if the last one does not show the board.
    """
    import numpy as np

    from rig.config.loader import load
    from rig.execution.plan import sample_rows
    from rig.hardware.cameras.base import FrameSet
    from rig.observation.observer import Observer
    from rig.simulator.mock_camera import MockCamera
    from rig.simulator.plant import Plant

    config = load(rig)
    plant = Plant(config, seed=0, t0_ns=0)
    plant.advance(SETTLED_NS)
    camera, observer = MockCamera(config, plant), Observer(config)
    samples = np.zeros(1, sample_rows(config))
    for index in range(3):
        t_ns = (index + 1) * FRAME_NS - 1
        samples["t_ns"] = t_ns
        row = observer.step(FrameSet.of(camera.frame_at(index, t_ns)), samples, 0.0)
    return bool(row["seen"] == DetectionStatus.MEASURED)


if __name__ == "__main__":
    sys.exit(main())
