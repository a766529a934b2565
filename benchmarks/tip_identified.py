"""Tip control with parameters that `rig identify` has found: identify each arm from a run of it, then steer with them.

    python -m benchmarks.tip_identified --results FILE.jsonl [--arms 20] [--seed 1] [--published]
                                          [--controllers horizon]

The arms are those of benchmarks.tip_control with the same seed, on a simulated rig in virtual time
(benchmarks.virtual_tip_run) with the valves, chambers and sensors of mock-3. Each arm is first moved by the
feed-forward of the published parameters, over a circle and five points (23 s). `rig identify` gets the archive of this
run, without options; its parameters are laid over the rig as `rig run --parameters FILE` does. Then circle and figure
eight are followed, by the horizon controller and by the feed-forward alone. Printed is the RMS of the 3-D distance
between reference and true tip from the third period on, lag included: median and worst over the arms. With
`--published` the same is also done without the identified parameters.

Every arm has a line in the results; with a file of results only the missing arms are run.
"""

from __future__ import annotations

import argparse
import json
import tempfile
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import yaml
from numpy.typing import NDArray

import protocols
from benchmarks.random_tip_paths import stated_rig
from benchmarks.tip_closed_loop import Truth
from benchmarks.tip_control import drawn
from benchmarks.virtual_tip_run import SHARED_HORIZON, distances_m, in_this_process, perform
from calibration.identify import parameters_document
from rig.config import parameters_overlay
from rig.config.loader import RigFile, read
from rig.config.schema import RigConfig
from rig.execution.plan import NullOperator
from rig.experiment import run as experiment
from rig.experiment.options import RunOptions
from rig.experiment.prepare import prepare
from rig.identify import identify
from rig.tip_planning.inverse import RigTipInverse

Row = dict[str, Any]

LEAD_IN_S = 2.0
PERIODS = {0.1: 3, 0.5: 4, 1.0: 5}
"""Periods of a path by its frequency [Hz]; those after the second count."""
PATHS: dict[str, Row] = {
    "circle": {"circle": {"centre_mm": [0, 0, 190], "radius_mm": 20}},
    "figure eight": {"figure_eight": {"centre_mm": [0, 0, 190], "width_mm": 30, "height_mm": 15}},
}
CONTROLLERS = {"horizon": SHARED_HORIZON, "feed-forward": "feed-forward"}
TO_IDENTIFY: list[Row] = [
    {"tip": {"circle": {"centre_mm": [0, 0, 190], "radius_mm": 30, "period_s": 4, "periods": 2}, "lead_in_s": 2}},
    {
        "tip": {
            "points": {
                "at_mm": [[30, 0, 188], [-15, 26, 195], [-12, -20, 185], [0, 0, 205], [30, 0, 188]],
                "dwell_s": 1.0,
                "move_s": 1.0,
            },
            "lead_in_s": 2,
        }
    },
    {"ramp": {"actuators": [1, 2, 3], "to_bar": 0, "duration_s": 1.5, "shape": "smooth"}},
]


def rig_of(truth: Truth) -> Row:
    """The rig file of mock-3 with a tracker, whose simulated arm is the truth."""
    data = stated_rig()
    data["simulator"]["material"] = parameters_document.material_section(truth.arm.material)
    data["simulator"]["cap_mass_g"] = 1e3 * truth.arm.cap_mass_kg
    data["simulator"]["arm_effects"] = [{"type": "gains", "gains": truth.strength.tolist()}]
    return data


def identified(rig: RigFile, folder: Path, seed: int) -> RigFile:
    """The rig with the parameters that `rig identify` finds in one run of it."""
    protocol = protocols.from_steps("to identify", TO_IDENTIFY, folder)
    options = RunOptions(fast=True, seed=seed, out=folder, report=False, controller="feed-forward")
    prepared = prepare(protocol, rig, options)
    with in_this_process():
        done = experiment.run(prepared, NullOperator())
    if done.archive is None:
        raise RuntimeError("; ".join(done.warnings))
    found = identify([done.archive])
    file = parameters_document.write(found.fit, folder / "arm.params.yaml", baseline=found.baseline)
    return rig.identified(parameters_overlay.read(file))


def errors_mm(config: RigConfig, seed: int, controllers: Sequence[str]) -> Row:
    """RMS of the true tip's distance from the third period on [mm], by path, frequency and controller."""
    inverse, found = RigTipInverse(config), {}
    for path, step in PATHS.items():
        (shape, words), *_ = step.items()
        for frequency_hz, periods in PERIODS.items():
            timed = {shape: words | {"period_s": 1 / frequency_hz, "periods": periods}, "lead_in_s": LEAD_IN_S}
            protocol = protocols.from_steps(path, [{"hold": {"duration_s": 0.1}}, {"tip": timed}], Path())
            trajectory = protocol.expand(config.actuators, inverse)
            (motion,) = trajectory.tip.motions
            for name in controllers:
                record, outcome = perform(config, trajectory, seed, CONTROLLERS[name])
                if outcome.message:
                    raise RuntimeError(outcome.message)
                off = distances_m(record, motion, motion.path_s + 2 / frequency_hz)
                rms = 1e3 * float(np.sqrt(np.mean(off**2)))
                found[f"{path}, {frequency_hz:g} Hz, {name}"] = round(rms, 4)
    return found


def arm_row(k: int, truth: Truth, seed: int, published: bool, controllers: Sequence[str]) -> Row:
    """Identify one arm, and follow the paths with what was found."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        (folder / "rig.yaml").write_text(yaml.safe_dump(rig_of(truth)), encoding="utf-8")
        rig = read(folder / "rig.yaml")
        row: Row = {"k": k, "seed": seed}
        if published:
            row["published"] = errors_mm(rig.config, seed + k, controllers)
        found = identified(rig, folder, seed + k)
        return row | {"identified": errors_mm(found.config, seed + k, controllers)}


def table(rows: list[Row]) -> str:
    """Median and worst over the arms."""
    lines = ["| path | parameters | controller | " + " | ".join(f"{hz:g} Hz" for hz in PERIODS) + " |"]
    lines.append("|---|---|---|" + "---|" * len(PERIODS))
    for path in PATHS:
        for parameters in ("published", "identified"):
            for controller in CONTROLLERS:
                some = f"{path}, {min(PERIODS):g} Hz, {controller}"
                known = [row[parameters] for row in rows if some in row.get(parameters, ())]
                if not known:
                    continue
                cells: list[str] = []
                for hz in PERIODS:
                    values: NDArray[np.float64] = np.array([one[f"{path}, {hz:g} Hz, {controller}"] for one in known])
                    cells.append(f"{np.median(values):.3f} / {values.max():.3f}")
                lines.append(f"| {path} | {parameters} ({len(known)} arms) | {controller} | {' | '.join(cells)} |")
    return "\n".join(lines)


def main() -> None:
    """Run the missing arms, and print the table of all."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--results", type=Path, required=True, help="a line of JSON for each arm; kept and continued")
    parser.add_argument("--arms", type=int, default=20)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--controllers", nargs="+", choices=list(CONTROLLERS), default=list(CONTROLLERS))
    parser.add_argument("--published", action="store_true", help="also without the identified parameters")
    args = parser.parse_args()
    text = args.results.read_text(encoding="utf-8") if args.results.exists() else ""
    rows = [row for row in map(json.loads, text.splitlines()) if row["seed"] == args.seed]
    done, rng = {row["k"] for row in rows}, np.random.default_rng(args.seed)
    for k in range(args.arms):
        truth = drawn(rng)
        if k not in done:
            rows.append(arm_row(k, truth, args.seed, args.published, args.controllers))
            with args.results.open("a", encoding="utf-8") as file:
                file.write(json.dumps(rows[-1]) + "\n")
    print(table(rows))


if __name__ == "__main__":
    main()
