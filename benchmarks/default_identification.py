"""Coverage of `rig identify RUN`: simulated runs of arms that are drawn, each identified without options.

Run: python -m benchmarks.default_identification [--rig mock] [--protocol ramp-a] [--trials 40] [--seed 0] [--store DIR]

For each trial every number of the arm, its mounting and its sensors is drawn from the standard uncertainty that the rig
file states or has by default, and each amount of what the arm does beyond the model is multiplied by a number from 0 to
2. The run is performed on the simulated bench, with pictures and valves, and identified without options. Printed are,
by parameter: in how many arms it gets a number, how many 95 % intervals hold the truth of the simulator, the median of
half their width, and the errors in stated deviations.
"""

from __future__ import annotations

import argparse
import tempfile
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import yaml

import protocols
from calibration.identify.parameter import Prior
from calibration.identify.parameters import named
from calibration.identify.setup import Setup
from calibration.parallel_map import parallel_map
from calibration.vision.transforms import RigidTransform
from model.arrays import Array
from rig.config.arm_model import model_arm
from rig.config.loader import RigFile, read
from rig.config.optics import placement_of, rigid
from rig.config.schema import RigConfig
from rig.execution.plan import NullOperator
from rig.experiment import run as experiment
from rig.experiment.options import RunOptions
from rig.experiment.prepare import prepare
from rig.identify import identify
from rig.identify.estimation import rig_uncertainties
from rig.identify.initial_setup import truth_of
from rig.observation.online_estimation import default_parameters
from runs.run import Run

MATERIAL = {
    "a1_per_N": "a1_per_n",
    "a2_per_N2": "a2_per_n2",
    "rpe_per_bar": "rpe_per_bar",
    "shear_ratio": "shear_ratio",
    "density_kg_m3": "density_kg_m3",
}
LENGTHS = ("length", "inner_radius", "outer_radius", "circle_radius")
# Amounts of the effects of a rig file.
AMOUNTS = ("share", "per_bar", "by_peak", "by_cycles", "weight", "amount")
# About the simulator's damping, as a logarithm: one that is drawn from the stated 20 ms would often be zero.
DAMPING_SHARE = 0.3


@dataclass(frozen=True)
class DefaultTrial:
    """A run of an arm that is drawn, and its identification."""

    rig: str
    protocol: str
    seed: int


def drawn_rig(text: str, config: RigConfig, rng: np.random.Generator) -> dict[str, Any]:
    """The YAML of a rig whose simulated arm is drawn about the stated one."""
    stated = rig_uncertainties(config, Setup(model_arm(config)))

    def draw(name: str) -> float:
        return _drawn(stated[name], rng)

    data: dict[str, Any] = yaml.safe_load(text)
    assert config.simulator is not None
    simulator = data["simulator"]
    simulator["material"] |= {key: max(0.0, draw(name)) for key, name in MATERIAL.items()}
    simulator["material"]["damping_s"] *= float(np.exp(rng.normal(0.0, DAMPING_SHARE)))
    simulator["cap_mass_g"] = 1e3 * draw("cap_mass_kg")
    geometry = config.arm.geometry.model_dump(mode="json")
    geometry |= {f"{name}_mm": 1e3 * draw(f"{name}_m") for name in LENGTHS}
    geometry["actuator_angles_deg"] = [
        angle + float(np.degrees(draw(f"actuator_{n}_turn_rad")))
        for n, angle in enumerate(config.arm.geometry.actuator_angles_deg, start=1)
    ]
    simulator["geometry"] = geometry
    base, tool = (
        RigidTransform.from_vectors(
            [draw(f"{part}_r{axis}_rad") for axis in "xyz"], [draw(f"{part}_{axis}_m") for axis in "xyz"]
        )
        for part in ("base", "tool")
    )
    simulator["base"] = placement_of(base).model_dump(mode="json")
    if config.board is not None:
        simulator["board"] = placement_of(tool @ rigid(config.board.placement)).model_dump(mode="json")
    sensors = [sensor.model_dump(mode="json", exclude_none=True) for sensor in config.sensors]
    for sensor in sensors:
        gain = draw(f"sensor_{sensor['actuator']}_gain")
        sensor["span_bar"] = [bar / gain for bar in sensor["span_bar"]]
    simulator["built"] = {
        "lenses": {name: camera.lens.model_dump(mode="json") for name, camera in config.cameras.items()},
        "valves": [valve.model_dump(mode="json") for valve in config.valves],
        "sensors": sensors,
    }
    simulator["arm_effects"] = [_scaled(one, rng.uniform(0, 2)) for one in simulator.get("arm_effects", ())]
    return data


def _drawn(stated: Prior, rng: np.random.Generator) -> float:
    return float(rng.normal(stated.mean, stated.std))


def _scaled(effect: Any, factor: float) -> Any:
    """An effect, or a part of one, whose amounts are multiplied."""
    if isinstance(effect, list):
        return [_scaled(one, factor) for one in effect]
    if not isinstance(effect, dict):
        return effect
    scaled = {key: factor * value if key in AMOUNTS else _scaled(value, factor) for key, value in effect.items()}
    if "gains" in scaled:
        scaled["gains"] = [1 + factor * (gain - 1) for gain in scaled["gains"]]
    return scaled


def estimated_names(config: RigConfig, moving: bool) -> tuple[str, ...]:
    """Shared parameters that the default form frees."""
    names = (*default_parameters(config), *(("damping_s",) if moving else ()))
    return tuple(p.name for p in named(names, config.actuators) if not p.per_run)


def run_trial(trial: DefaultTrial) -> Array:
    """Value, truth, standard deviation, lower and upper end (5, n) of each parameter; NaN without a number."""
    rig, protocol = read(trial.rig), protocols.load(trial.protocol)
    rng = np.random.default_rng([trial.seed, 16])
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "drawn.yaml"
        file.write_text(yaml.safe_dump(drawn_rig(rig.text, rig.config, rng)), encoding="utf-8")
        archive = _performed(read(file), protocol, trial.seed, Path(folder))
        fit = identify([archive]).fit
        truth = truth_of(Run(archive))
    moving = any(poses.moving for poses in fit.problem.data)
    rows = np.full((5, len(estimated_names(rig.config, True))), np.nan)
    for k, name in enumerate(estimated_names(rig.config, moving)):
        found = fit[name]
        if (
            not fit.worse_than_start
            and found.value is not None
            and found.std is not None
            and found.interval is not None
        ):
            rows[:, k] = found.value, truth[name], found.std, *found.interval
    return rows


def _performed(rig: RigFile, protocol: protocols.Protocol, seed: int, folder: Path) -> Path:
    prepared = prepare(protocol, rig, RunOptions(fast=True, seed=seed, out=folder, report=False))
    result = experiment.run(prepared, NullOperator())
    if result.archive is None:
        raise RuntimeError("; ".join(result.warnings))
    return result.archive


def main() -> None:
    """Print the table."""
    options = argparse.ArgumentParser(description=__doc__)
    options.add_argument("--rig", default="mock")
    options.add_argument("--protocol", default="ramp-a")
    options.add_argument("--trials", type=int, default=40)
    options.add_argument("--seed", type=int, default=0)
    options.add_argument("--workers", type=int, default=1)
    options.add_argument("--store", type=Path, help="keep finished trials there, to resume")
    given = options.parse_args()
    began = time.perf_counter()
    tasks = [DefaultTrial(given.rig, given.protocol, given.seed * 1_000_003 + k) for k in range(given.trials)]
    found = np.array(parallel_map(run_trial, tasks, given.workers, store=given.store))
    value, truth, std, low, high = (found[:, k] for k in range(5))
    known, held = np.isfinite(value), (low <= truth) & (truth <= high)
    print(f"{given.rig}, {given.protocol}: {given.trials} arms in {time.perf_counter() - began:.0f} s")
    for k, name in enumerate(estimated_names(read(given.rig).config, True)):
        at = known[:, k]
        if not at.any():
            print(f"  {name:16s} no number in any arm")
            continue
        z = (value[at, k] - truth[at, k]) / std[at, k]
        half = np.median((high[at, k] - low[at, k]) / 2)
        print(
            f"  {name:16s} {at.sum():3d} numbers, {held[at, k].sum():3d} held, half width {half:.3g}, "
            f"z {z.mean():+.2f} +- {z.std():.2f}"
        )
    print(f"  overall          {known.sum():3d} numbers, {100 * held[known].mean():.1f} % held")


if __name__ == "__main__":
    main()
