"""References drawn at random: is every path that `rig check` accepts followed, within every limit, on an unlike arm?

    python -m benchmarks.tip_references --results FILE.jsonl [--seed 1] [--first 0] [--count 10000]
                                          [--minutes 60] [--only K]

Each path (circle, eight, star, points, held point, CSV; any plane, size and speed) is given to the planner and the
preflight check of `rig check` on mock-3. An accepted path is run in virtual time: control loop, interlocks, horizon
controller, valves and chambers; a simulated tracker measures the tip at 30 Hz with 0.1 mm noise per coordinate in place
of pictures. The arm is drawn at random (benchmarks.support.random_tip_paths).

Counted are runs that an interlock or anything else ended, cycles whose set-point or its rate is out of the limits of
the rig, and paths that are not followed: after the lead-in the RMS of the 3-D distance between reference and true tip
is above NEAR_RMS_MM, or its largest value above NEAR_MM.

Every path has a line in the results; with a file of results only the missing paths are run, and the table is printed
from model.arrays import Array
from the whole file. Path K is the same for the same seed, whatever was run before it.
"""

from __future__ import annotations

import argparse
import json
import tempfile
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

import protocols
from benchmarks.support.random_tip_paths import SHAPES, drawn_rig, stated_rig, tip_step
from benchmarks.support.virtual_tip_run import SHARED_HORIZON, distances_m, perform
from model.units import PA_PER_BAR
from protocols import BadInputError, SetPointTrajectory
from rig.config.schema import RigConfig
from rig.experiment.preflight import check
from rig.tip_planning.inverse import RigTipInverse
from runs.records import Level, Status

Row = dict[str, Any]

NEAR_RMS_MM, NEAR_MM = 2.0, 5.0
"""A path is followed if RMS and largest value of the true tip's distance are below these, after the lead-in."""
ROUNDING = 1e-9


def steps_of(tip: Row) -> list[Row]:
    """The protocol's steps: a moment of rest, the tip path, and back to no pressure close to the rate limit."""
    ramp = {"actuators": [1, 2, 3], "to_bar": 0, "duration_s": 1.1, "shape": "smooth"}
    return [{"hold": {"duration_s": 0.1}}, {"tip": tip}, {"ramp": ramp}]


def judged(k: int, seed: int, config: RigConfig, inverse: RigTipInverse) -> Row:
    """Draw path k, check it, and run it if it is accepted."""
    rng = np.random.default_rng([seed, k])
    with tempfile.TemporaryDirectory() as folder:
        tip = tip_step(rng, Path(folder))
        kind = next(name for name in tip if name in SHAPES)
        row: Row = {"k": k, "seed": seed, "kind": kind}
        try:
            protocol = protocols.from_steps("random", steps_of(tip), Path(folder))
            trajectory = protocol.expand(3, inverse)
        except BadInputError as error:
            return row | {"refused": error.problems[0].expected}
        if problems := check(config, trajectory, protocol):
            return row | {"refused": problems[0].expected}
    drawn = drawn_rig(np.random.default_rng([seed, k, 1]))
    return row | followed(drawn, trajectory, seed=k)


def followed(config: RigConfig, trajectory: SetPointTrajectory, seed: int, controller: str = SHARED_HORIZON) -> Row:
    """Run a trajectory on a simulated rig in virtual time; how it ended, and how far the tip was from its path."""
    record, outcome = perform(config, trajectory, seed, controller)
    cycles = np.concatenate(record.cycles)
    (motion,) = trajectory.tip.motions
    setpoint = cycles["setpoint_pa"]
    rate = np.abs(np.diff(setpoint, axis=0)) * config.control.rate_hz
    limit, fastest = config.limits.pressure_bar * PA_PER_BAR, config.limits.rate_bar_per_s * PA_PER_BAR
    beyond = (setpoint < -ROUNDING) | (setpoint > limit * (1 + ROUNDING))
    off = 1e3 * distances_m(record, motion, motion.path_s)
    times = cycles["protocol_s"]
    on = (times[:-1] > motion.path_s) & (times[:-1] < motion.stop_s)
    bound = (setpoint[:-1] <= 1) | (setpoint[:-1] >= limit - 1) | (rate > 0.999 * fastest)
    warnings = [event.message for event in record.events if event.level is not Level.INFO]
    return {
        "duration_s": round(trajectory.duration_s, 2),
        "ended": "" if outcome.status is Status.FINISHED else outcome.message,
        "warnings": warnings,
        "beyond_limit": int(beyond.sum()),
        "beyond_rate": int(np.count_nonzero(rate > fastest * (1 + 1e-6))),
        "at_limit": round(float(bound[on].any(axis=1).mean()), 3) if on.any() else 0.0,
        "unsolved": record.unsolved,
        "measured": len(off),
        "rms_mm": round(float(np.sqrt(np.mean(off**2))), 4) if len(off) else float("nan"),
        "largest_mm": round(float(off.max()), 4) if len(off) else float("nan"),
    }


def is_followed(row: Row) -> bool:
    """Whether the tip of an accepted path has followed it."""
    return bool(row["rms_mm"] <= NEAR_RMS_MM and row["largest_mm"] <= NEAR_MM)


def is_beyond(row: Row) -> bool:
    """Whether a set-point or its rate has left the limits of the rig."""
    return bool(row["beyond_limit"] or row["beyond_rate"])


def table(rows: Sequence[Row]) -> str:
    """The counts for each kind of path, and the paths that need a look."""
    lines = ["| path | drawn | accepted | ended early | out of limits | followed | RMS p50 / p99 / worst [mm] |"]
    lines.append("|---|---|---|---|---|---|---|")
    for kind in (*SHAPES, "all"):
        drawn = [row for row in rows if kind in (row["kind"], "all")]
        run = [row for row in drawn if "refused" not in row]
        if not run:
            continue
        rms = np.array([row["rms_mm"] for row in run])
        spread = " / ".join(f"{value:.2f}" for value in (np.median(rms), np.percentile(rms, 99), rms.max()))
        ended = sum(bool(row["ended"]) for row in run)
        beyond = sum(is_beyond(row) for row in run)
        near = sum(is_followed(row) for row in run)
        lines.append(
            f"| {kind.replace('_', ' ')} | {len(drawn)} | {len(run)} | {ended} | {beyond} | {near} | {spread} |"
        )
    lines += [
        f"path {row['k']} ({row['kind']}): RMS {row['rms_mm']} mm, largest {row['largest_mm']} mm, "
        f"{row['at_limit']:.0%} of the time at a limit{'; ' + row['ended'] if row['ended'] else ''}"
        for row in rows
        if "refused" not in row and (row["ended"] or is_beyond(row) or not is_followed(row))
    ]
    return "\n".join(lines)


def known_rows(results: Path, seed: int) -> list[Row]:
    """The rows of a seed in a file of results; a line that was cut off when the program was stopped is removed."""
    if not results.exists():
        return []
    lines = results.read_text(encoding="utf-8").splitlines(keepends=True)
    whole = [line for line in lines if line.endswith("}\n")]
    if len(whole) < len(lines):
        results.write_text("".join(whole), encoding="utf-8")
    return [row for row in map(json.loads, whole) if row["seed"] == seed]


def main() -> None:
    """Run the missing paths, and print the table of all."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--results", type=Path, required=True, help="a line of JSON for each path; kept and continued")
    parser.add_argument("--first", type=int, default=0, help="number of the first path")
    parser.add_argument("--count", type=int, default=10_000, help="paths from the first on")
    parser.add_argument("--minutes", type=float, default=60.0, help="processor time of this process")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--only", type=int, nargs="+", help="run these paths and print their lines")
    args = parser.parse_args()
    config = RigConfig.model_validate(stated_rig())
    inverse = RigTipInverse(config)
    if args.only:
        for k in args.only:
            print(json.dumps(judged(k, args.seed, config, inverse)), flush=True)
        return
    rows = known_rows(args.results, args.seed)
    known, end_s = {row["k"] for row in rows}, time.process_time() + 60 * args.minutes
    with args.results.open("a", encoding="utf-8") as file:
        for k in (k for k in range(args.first, args.first + args.count) if k not in known):
            if time.process_time() > end_s:
                break
            rows.append(judged(k, args.seed, config, inverse))
            file.write(json.dumps(rows[-1]) + "\n")
            file.flush()
    print(table(rows))


if __name__ == "__main__":
    main()
