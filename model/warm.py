"""`python -m model.warm`: compile every kernel into the cache on disk, so that no run waits for the compiler."""

from __future__ import annotations

import sys
import time


def main() -> int:
    """Compile, or load what is compiled already; report what was done. Returns the exit status."""
    start = time.perf_counter()
    try:
        from dataclasses import replace

        from model import batch
        from model.arm import Arm
        from model.dynamics import Dynamics
        from model.kernels.jit import cache_folder
        from model.material import MaxwellBranch
        from model.paper.rod import PaperRod
        from model.sensitivities import motion, tip_gradient

        print(f"model.warm: kernels are kept in {cache_folder()}", flush=True)
        arms = [Arm.paper("homogeneous"), Arm.paper("inhomogeneous+rpe")]
        viscous = replace(arms[0].material, branches=(MaxwellBranch(0.05, 1.0),))
        for arm in [*arms, arms[0].with_segment(material=viscous)]:
            dynamics = Dynamics(arm, 1 / 30)
            dynamics.start((0.0, 0.0, 0.0))
            if not (dynamics.step((1e4, 0.0, 0.0)).ok and dynamics.run([(1e4, 0.0, 0.0)]).ok.all()):
                print(f"model.warm: failed: the {arm.variant} arm could not be stepped", file=sys.stderr)
                return 1
            tip_gradient(arm, (1e4, 0.0, 0.0))
            motion(arm, [(1e4, 0.0, 0.0)] * 2, 1 / 30, ())
            batch.statics(arm, [(1e4, 0.0, 0.0)])
        PaperRod(Arm.paper("homogeneous")).statics((1e4, 0.0, 0.0))
    except Exception as fault:
        print(f"model.warm: failed: {type(fault).__name__}: {fault}", file=sys.stderr)
        return 1
    print(f"model.warm: every kernel is ready after {time.perf_counter() - start:.1f} s")
    return 0


if __name__ == "__main__":
    sys.exit(main())
