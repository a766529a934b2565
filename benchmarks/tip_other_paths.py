"""Sharp and growing paths on arms far from the model: the horizon controller beside the baselines.

    python -m benchmarks.tip_other_paths [--paths S spiral square] [--truths ...] [--controllers ...] [--speed-mm-s 30]

Each path is a CSV file of straight lines. It is planned with the model of mock-3 and run in virtual time
(benchmarks.virtual_tip_run) on a simulated rig whose truth is one of TRUTHS. Printed is the RMS and the largest value
of the 3-D distance between reference and true tip on the path, lag included, in mm, for each controller.
"""

from __future__ import annotations

import argparse
import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import yaml

import protocols
from benchmarks.random_tip_paths import stated_rig
from benchmarks.virtual_tip_run import SHARED_HORIZON, distances_m, perform
from model.arrays import Array
from protocols import SetPointTrajectory
from rig.config import loader
from rig.config.schema import RigConfig
from rig.tip_planning.inverse import RigTipInverse

Row = dict[str, Any]

HEIGHT_MM = 190.0
CONTROLLERS = {
    "horizon": SHARED_HORIZON,
    "inverse-integral": "inverse-integral",
    "static-inverse": "static-inverse",
    "feed-forward": "feed-forward",
}


def letter() -> Array:
    """Corners (n, 2) [mm] of a letter S, 12 straight lines."""
    x = [14, 8, 0, -10, -14, -8, 8, 14, 10, 0, -8, -14]
    y = [16, 21, 22, 18, 10, 3, -3, -10, -18, -22, -21, -16]
    return np.array([x, y], dtype=np.float64).T


def spiral() -> Array:
    """Corners of a spiral of four turns that grows to a radius of 25 mm."""
    turns = np.linspace(0.0, 4.0, 97)
    radius = 25 * turns / 4
    return np.stack([radius * np.cos(2 * np.pi * turns), radius * np.sin(2 * np.pi * turns)], axis=1)


def square() -> Array:
    """Corners of a square of 30 mm, three times."""
    once = 15.0 * np.array([[1, 1], [-1, 1], [-1, -1], [1, -1]])
    return np.vstack([once, once, once, once[:1]])


PATHS: dict[str, Callable[[], Array]] = {"S": letter, "spiral": spiral, "square": square}


def soft(data: Row) -> None:
    """A softer arm with less damping, 25 g more on its tip, other chambers, valves and sensors."""
    simulator = data["simulator"]
    simulator["material"] |= {"a1_per_N": 0.0079, "a2_per_N2": 0.00029}
    simulator["material"] |= {"rpe_per_bar": 0.056, "shear_ratio": 0.39, "density_kg_m3": 1040, "damping_s": 0.006}
    simulator["cap_mass_g"] = 75
    simulator["chamber"] = {"dead_volume_ml": 25}
    simulator["valve"] = {"spool_hz": 100, "leakage_l_min": 2, "dead_zone_V": 0.5, "flow_scale": 0.93}
    simulator["sensor"] = {"noise_bar": 0.0015, "offset_bar": 0.003, "lag_ms": 4}


def remembering(data: Row) -> None:
    """The effects of the rig mock, 1.5 times as large, on actuators of unequal strength."""
    effects = yaml.safe_load(loader.text("mock"))["simulator"]["arm_effects"]
    gains = {"type": "gains", "gains": [0.93, 1.05, 0.98]}
    data["simulator"]["arm_effects"] = [gains, *(_larger(one) for one in effects if one["type"] != "gains")]


def heavy(data: Row) -> None:
    """An arm with 45 g more on its tip, four times the damping and slow valves, which stands askew by 1.5 degrees."""
    simulator = data["simulator"]
    simulator["cap_mass_g"] = 97
    simulator["material"] |= {"damping_s": 0.04}
    simulator["valve"] |= {"spool_hz": 60}
    simulator["base"] = {"translation_mm": [0, 0, 0], "rotation_deg": [1.5, 0, 0]}


TRUTHS: dict[str, Callable[[Row], None]] = {"soft": soft, "remembering": remembering, "heavy": heavy}
_AMOUNTS = ("share", "per_bar", "by_peak", "by_cycles", "weight", "amount")


def _larger(value: Any, name: str = "") -> Any:
    if isinstance(value, dict):
        return {key: _larger(item, key) for key, item in value.items()}
    if isinstance(value, list):
        return [_larger(item, name) for item in value]
    return 1.5 * value if name in _AMOUNTS else value


def planned(corners_mm: Array, speed_mm_s: float, inverse: RigTipInverse) -> SetPointTrajectory:
    """The trajectory along straight lines at one speed, from rest and back to rest."""
    times = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(corners_mm, axis=0), axis=1)) / speed_mm_s])
    rows = np.column_stack([times, corners_mm, np.full(len(times), HEIGHT_MM)])
    with tempfile.TemporaryDirectory() as name:
        lines = ["time_s,x_mm,y_mm,z_mm", *(",".join(f"{value:.4f}" for value in row) for row in rows)]
        (Path(name) / "path.csv").write_text("\n".join(lines) + "\n", encoding="utf-8")
        steps: list[Row] = [{"hold": {"duration_s": 0.1}}, {"tip": {"csv": {"file": "path.csv"}, "lead_in_s": 2.0}}]
        return protocols.from_steps("path", steps, Path(name)).expand(3, inverse)


def errors_mm(config: RigConfig, trajectory: SetPointTrajectory, seed: int, controller: str) -> tuple[float, float]:
    """RMS and largest value of the true tip's distance on the path."""
    record, outcome = perform(config, trajectory, seed, controller)
    if outcome.message:
        raise RuntimeError(outcome.message)
    (motion,) = trajectory.tip.motions
    off = 1e3 * distances_m(record, motion, motion.path_s)
    return float(np.sqrt(np.mean(off**2))), float(off.max())


def main() -> None:
    """Print a row for each truth and path."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--paths", nargs="+", choices=list(PATHS), default=list(PATHS))
    parser.add_argument("--truths", nargs="+", choices=list(TRUTHS), default=list(TRUTHS))
    parser.add_argument("--controllers", nargs="+", choices=list(CONTROLLERS), default=list(CONTROLLERS))
    parser.add_argument("--speed-mm-s", type=float, default=30.0)
    parser.add_argument("--seed", type=int, default=0)
    args = parser.parse_args()
    inverse = RigTipInverse(RigConfig.model_validate(stated_rig()))
    print(f"| truth | path | {' | '.join(args.controllers)} |")
    print("|---|---|" + "---|" * len(args.controllers))
    for truth in args.truths:
        data = stated_rig()
        TRUTHS[truth](data)
        config = RigConfig.model_validate(data)
        for path in args.paths:
            trajectory = planned(PATHS[path](), args.speed_mm_s, inverse)
            found = (errors_mm(config, trajectory, args.seed, CONTROLLERS[name]) for name in args.controllers)
            print(f"| {truth} | {path} | {' | '.join(f'{rms:.3f}, {most:.2f}' for rms, most in found)} |", flush=True)


if __name__ == "__main__":
    main()
