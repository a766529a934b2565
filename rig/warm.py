"""`python -m rig.warm`: compile everything that a run would otherwise wait for; part of the installation."""

from __future__ import annotations

import sys

from model import warm as model_warm


def main() -> int:
    """Compile the rod's and the plant's kernels into the cache on disk; the exit status."""
    if status := model_warm.main():
        return status
    from rig.arm import true_arm
    from rig.config import load
    from rig.simulator.plant import Plant

    config = load("mock")
    Plant(config, seed=0, t0_ns=0).advance(20_000_000)
    # The simulator's arm is damped, which is a kernel of its own.
    true_arm(config).dynamics(1 / config.control.rate_hz).start([0.0] * config.actuators)
    print("rig.warm: the simulator's kernels are ready")
    return 0


if __name__ == "__main__":
    sys.exit(main())
