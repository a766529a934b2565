"""Tip control on a simulated rig that is changed in ways the controller is not told: horizon controller and baselines.

    python -m benchmarks.tip_unannounced [--trials 24] [--seed 0] [--controllers ...]

Trial k draws one of CHANGES and one of PATHS in turn, and the amount of the change at random. The path is planned with
the model of mock-3 and run in virtual time (benchmarks.support.virtual_tip_run) on a rig whose arm and valves are drawn
as in benchmarks.tip_references, with the change. Printed is, for each controller, the RMS of the 3-D distance between
reference and true tip on the path, lag included, in mm; then the runs that ended early or left the limits, and in how
many trials the horizon controller was the best.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable
from dataclasses import dataclass, fields
from typing import Any

import numpy as np

from benchmarks.support.random_tip_paths import DELAY_MS, drawn_rig, stated_rig
from benchmarks.support.tip_paths import CONTROLLERS, PATHS, planned
from benchmarks.tip_references import Row, followed, is_beyond
from protocols import SetPointTrajectory
from rig.config.schema import RigConfig
from rig.tip_planning.inverse import RigTipInverse

SPEEDS_MM_S = (20.0, 45.0)


@dataclass(frozen=True)
class LoadedTrajectory(SetPointTrajectory):
    """A trajectory during which a weight is hung on the tip, without a prompt: no controller sees it."""

    hung_kg: float = 0.0
    hung_from_s: float = 0.0

    @classmethod
    def of(cls, trajectory: SetPointTrajectory, hung_kg: float, hung_from_s: float) -> LoadedTrajectory:
        """A trajectory with a weight from a protocol time on."""
        own = {one.name: getattr(trajectory, one.name) for one in fields(SetPointTrajectory) if one.init}
        return cls(**own, hung_kg=hung_kg, hung_from_s=hung_from_s)

    def weight_kg(self, t_s: float) -> float:
        """Weight on the end cap [kg] at a protocol time."""
        return self.hung_kg if t_s >= self.hung_from_s else 0.0


@dataclass
class Trial:
    """A rig file and a trajectory, which a change alters."""

    data: Row
    trajectory: SetPointTrajectory

    @property
    def simulator(self) -> Row:
        """The section of the truth."""
        found: Row = self.data["simulator"]
        return found


def strengths(trial: Trial, rng: np.random.Generator) -> None:
    """Actuators up to 12 % weaker or stronger."""
    trial.simulator["arm_effects"].append({"type": "gains", "gains": rng.uniform(0.88, 1.12, 3).tolist()})


def creep(trial: Trial, rng: np.random.Generator) -> None:
    """Creep of up to 12 % over 1 s and 10 s."""
    branches = [{"amount": float(rng.uniform(0.02, 0.06)), "time_s": time_s} for time_s in (1, 10)]
    trial.simulator["arm_effects"].append({"type": "creep", "branches": branches})


def delay(trial: Trial, rng: np.random.Generator) -> None:
    """A tracker that is 5 to 20 ms later than stated, and slow valves."""
    trial.data["trackers"]["pose"]["true_delay_ms"] = DELAY_MS + float(rng.uniform(5, 20))
    trial.simulator["valve"]["spool_hz"] = float(rng.uniform(30, 80))


def backlash(trial: Trial, rng: np.random.Generator) -> None:
    """Hysteresis of 5 to 15 % that slips within 0.01 to 0.06 bar."""
    element = {"weight": float(rng.uniform(0.05, 0.15)), "slip_bar": float(rng.uniform(0.01, 0.06))}
    trial.simulator["arm_effects"].append({"type": "hysteresis", "elements": [element]})


def payload(trial: Trial, rng: np.random.Generator) -> None:
    """A payload of 20 to 120 g in the first half of the path."""
    (motion,) = trial.trajectory.tip.motions
    at_s = motion.path_s + float(rng.uniform(0.1, 0.5)) * (motion.stop_s - motion.path_s)
    trial.trajectory = LoadedTrajectory.of(trial.trajectory, float(rng.uniform(0.02, 0.12)), at_s)


def everything(trial: Trial, rng: np.random.Generator) -> None:
    """All of them at once."""
    for change in (strengths, creep, delay, backlash, payload):
        change(trial, rng)


CHANGES: dict[str, Callable[[Trial, np.random.Generator], None]] = {
    "strengths": strengths,
    "creep": creep,
    "delay": delay,
    "backlash": backlash,
    "payload": payload,
    "everything": everything,
}


def drawn(k: int, seed: int, inverse: RigTipInverse) -> tuple[str, str, RigConfig, SetPointTrajectory]:
    """Names of change and path, the rig and the trajectory of a trial."""
    rng = np.random.default_rng([seed, k])
    names, paths = list(CHANGES), list(PATHS)
    change, path = names[k % len(names)], paths[(k // len(names) + k) % len(paths)]
    trajectory = planned(PATHS[path](), float(rng.uniform(*SPEEDS_MM_S)), inverse)
    trial = Trial(drawn_rig(rng).model_dump(mode="json", by_alias=True, exclude_unset=True), trajectory)
    CHANGES[change](trial, rng)
    return change, path, RigConfig.model_validate(trial.data), trial.trajectory


def main() -> None:
    """Print a row for each trial, and the counts."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--trials", type=int, default=24)
    parser.add_argument("--first", type=int, default=0)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--controllers", nargs="+", choices=list(CONTROLLERS), default=list(CONTROLLERS))
    args = parser.parse_args()
    inverse = RigTipInverse(RigConfig.model_validate(stated_rig()))
    print(f"| trial | change | path | {' | '.join(args.controllers)} | ended early or out of limits |")
    print("|---|---|---|---|" + "---|" * len(args.controllers))
    rows: list[dict[str, Any]] = []
    for k in range(args.first, args.first + args.trials):
        change, path, config, trajectory = drawn(k, args.seed, inverse)
        rows.append({name: followed(config, trajectory, k, CONTROLLERS[name]) for name in args.controllers})
        found = " | ".join(f"{row['rms_mm']:.3f}" for row in rows[-1].values())
        wrong = [name for name, row in rows[-1].items() if row["ended"] or is_beyond(row)]
        print(f"| {k} | {change} | {path} | {found} | {', '.join(wrong) or '-'} |", flush=True)
    for name in args.controllers:
        ended = [row[name]["ended"] for row in rows if row[name]["ended"]]
        beyond = sum(is_beyond(row[name]) for row in rows)
        best = sum(row[name]["rms_mm"] == min(other["rms_mm"] for other in row.values()) for row in rows)
        print(f"{name}: best in {best} of {len(rows)}, {len(ended)} ended early, {beyond} out of limits {ended or ''}")


if __name__ == "__main__":
    main()
