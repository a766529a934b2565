"""Processor time that `rig check` needs for tip paths of 60 s on mock-3: paths that are followed, and refused ones.

    python -m benchmarks.tip_check

The expansion alone, after the kernels are compiled: inverse solution, and for a refused path its remedies.
"""

from __future__ import annotations

import time

import protocols
from protocols import BadInputError
from rig.config.loader import load
from rig.tip_planning.inverse import RigTipInverse

SQUARE = [[20, 20, 190], [-20, 20, 190], [-20, -20, 190], [20, -20, 190]]
PATHS = {
    "circle, 20 mm, 1 Hz": {"circle": {"centre_mm": [0, 0, 190], "radius_mm": 20, "period_s": 1, "periods": 60}},
    "circle, 30 mm, 0.2 Hz": {"circle": {"centre_mm": [0, 0, 190], "radius_mm": 30, "period_s": 5, "periods": 12}},
    "points, 60 s": {"points": {"at_mm": SQUARE * 6, "dwell_s": 1, "move_s": 1.5}},
    "too fast: circle, 30 mm, 1.25 Hz": {
        "circle": {"centre_mm": [0, 0, 190], "radius_mm": 30, "period_s": 0.8, "periods": 75}
    },
    "too large: circle, 75 mm, 0.2 Hz": {
        "circle": {"centre_mm": [0, 0, 200], "radius_mm": 75, "period_s": 5, "periods": 12}
    },
    "too fast: points, 60 s": {"points": {"at_mm": SQUARE * 10, "dwell_s": 1, "move_s": 0.5}},
    "too large: points, 60 s": {"points": {"at_mm": [[2.2 * x, 2.2 * y, z] for x, y, z in SQUARE] * 6, "move_s": 2.5}},
    "out of reach: point": {"hold": {"at_mm": [0, 0, 240], "duration_s": 60}},
}


def main() -> None:
    """Print one line for each path."""
    inverse = RigTipInverse(load("mock-3"))
    for name in (next(iter(PATHS)), *PATHS):
        steps = [{"hold": {"duration_s": 0.5}}, {"tip": PATHS[name]}]
        begun, wall = time.process_time(), time.perf_counter()
        try:
            said = f"followed, {protocols.from_steps('t', steps).expand(3, inverse).duration_s:.0f} s"
        except BadInputError as error:
            said = error.problems[0].expected.rpartition("; ")[2]
        spent, took = time.process_time() - begun, time.perf_counter() - wall
        print(f"{name:36} {spent:6.2f} CPU-s {took:6.2f} s  {said}", flush=True)


if __name__ == "__main__":
    main()
