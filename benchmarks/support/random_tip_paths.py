"""Tip paths and simulated arms drawn at random, for `benchmarks.tip_references`."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import yaml
from scipy.interpolate import CubicSpline

from model.arrays import Array
from rig.config import loader
from rig.config.schema import RigConfig

Step = dict[str, Any]

NOISE_MM = 0.1
"""Standard deviation of each coordinate of the measured tip."""
FRAME_HZ = 30
DELAY_MS = 2.0
LEAD_IN_S = (1.0, 3.0)
FEWER_COORDINATES = (["x", "y"], ["x", "z"], ["y", "z"])
SPLINE_STEP_S = 0.02


def tip_step(rng: np.random.Generator, folder: Path) -> Step:
    """A `tip` step; its CSV file, if it has one, is written into `folder`."""
    kind = str(rng.choice(list(SHAPES)))
    step: Step = {kind: SHAPES[kind](rng, folder), "lead_in_s": _number(rng, *LEAD_IN_S)}
    if rng.random() < 0.1:
        step["coordinates"] = FEWER_COORDINATES[rng.integers(len(FEWER_COORDINATES))]
    return step


def _number(rng: np.random.Generator, low: float, high: float) -> float:
    return round(float(rng.uniform(low, high)), 3)


def _centre(rng: np.random.Generator) -> list[float]:
    return [_number(rng, -20, 20), _number(rng, -20, 20), _number(rng, 175, 205)]


def _plane(rng: np.random.Generator) -> Step:
    """Centre, plane and timing of a closed shape; planes of every direction, half of them almost horizontal."""
    tilt = 1.0 if rng.random() < 0.5 else 0.3
    normal = [_number(rng, -tilt, tilt), _number(rng, -tilt, tilt), 1.0]
    plane: Step = {"centre_mm": _centre(rng), "normal": normal, "rotation_deg": _number(rng, -180, 180)}
    if rng.random() < 0.5:
        return plane | {"period_s": _number(rng, 0.5, 4.0), "periods": _number(rng, 0.5, 3.0)}
    return plane | {"speed_mm_per_s": _number(rng, 5, 120), "duration_s": _number(rng, 1.0, 4.0)}


def _circle(rng: np.random.Generator, folder: Path) -> Step:
    return _plane(rng) | {"radius_mm": _number(rng, 1, 40)}


def _figure_eight(rng: np.random.Generator, folder: Path) -> Step:
    return _plane(rng) | {"width_mm": _number(rng, 2, 70), "height_mm": _number(rng, 2, 40)}


def _star(rng: np.random.Generator, folder: Path) -> Step:
    return _plane(rng) | {"radius_mm": _number(rng, 3, 40), "points": int(rng.integers(2, 8))}


def _points(rng: np.random.Generator, folder: Path) -> Step:
    centre, size = np.array([0, 0, 190.0]), rng.uniform(3, 50)
    spread = size * rng.uniform(-1, 1, (rng.integers(2, 6), 3)) * [1, 1, 0.3]
    timing: Step = {"move_s": _number(rng, 0.3, 2.0)} if rng.random() < 0.5 else {"speed_mm_per_s": _number(rng, 5, 80)}
    if rng.random() < 0.3:
        timing["periods"] = _number(rng, 1.0, 2.0)
    ways = str(rng.choice(["smooth", "linear"]))
    return timing | {"at_mm": (centre + spread).round(3).tolist(), "dwell_s": _number(rng, 0.0, 0.5), "ways": ways}


def _hold(rng: np.random.Generator, folder: Path) -> Step:
    at = [_number(rng, -60, 60), _number(rng, -60, 60), _number(rng, 165, 222)]
    return {"at_mm": at, "duration_s": _number(rng, 0.5, 2.0)}


def _csv(rng: np.random.Generator, folder: Path) -> Step:
    """A smooth path through random points, or a spiral, or a polygon with sharp corners."""
    duration = rng.uniform(2.0, 5.0)
    times: Array = np.arange(0.0, duration, SPLINE_STEP_S)
    size = rng.uniform(3, 45)
    match rng.integers(3):
        case 0:
            at = np.linspace(0.0, duration, rng.integers(4, 9))
            corners = size * rng.uniform(-1, 1, (len(at), 3)) * [1, 1, 0.3]
            rows = CubicSpline(at, corners)(times)
        case 1:
            turns, share = 2 * np.pi * rng.uniform(1, 5) * times / duration, times / duration
            lift = rng.uniform(-0.2, 0.2) * size * share
            rows = np.stack([size * share * np.cos(turns), size * share * np.sin(turns), lift], axis=1)
        case _:
            times = np.linspace(0.0, duration, rng.integers(3, 8))
            rows = size * rng.uniform(-1, 1, (len(times), 3)) * [1, 1, 0.3]
    rows[:, 2] += rng.uniform(180, 200)
    table = np.column_stack([times, rows])
    lines = ["time_s,x_mm,y_mm,z_mm", *(",".join(f"{value:.4f}" for value in row) for row in table)]
    (folder / "path.csv").write_text("\n".join(lines) + "\n", encoding="utf-8")
    return {"file": "path.csv"}


SHAPES: dict[str, Callable[[np.random.Generator, Path], Step]] = {
    "circle": _circle,
    "figure_eight": _figure_eight,
    "star": _star,
    "points": _points,
    "hold": _hold,
    "csv": _csv,
}


def stated_rig() -> dict[str, Any]:
    """The rig file of mock-3, with a simulated tracker in place of its camera: a picture is not needed.

    The delay of the tracker is stated, because the exposure times of a camera are known, too.
    """
    data: dict[str, Any] = yaml.safe_load(loader.text("mock-3"))
    del data["cameras"], data["board"], data["simulator"]["scene"]
    data["trackers"] = {"pose": {"driver": "mock", "rate_hz": float(FRAME_HZ), "noise_mm": NOISE_MM}}
    data["trackers"]["pose"] |= {"delay_ms": DELAY_MS, "true_delay_ms": DELAY_MS}
    return data


def drawn_rig(rng: np.random.Generator) -> RigConfig:
    """The stated rig with a true arm and true valves drawn at random.

    Material 4 %, strengths 3 %, cap 2 g, damping between half and twice the stated one (limits at three standard
    deviations); dead zone, flow, dead volume and lag of the sensors; on every second arm the effects of the rig mock,
    each amount between half and one and a half times that of its file.
    """
    data = stated_rig()
    simulator, stated = data["simulator"], data["arm"]["material"]

    def off(std: float) -> float:
        return 1 + std * float(np.clip(rng.standard_normal(), -3, 3))

    material = {name: stated[name] * off(0.04) for name in ("a1_per_N", "a2_per_N2", "rpe_per_bar", "shear_ratio")}
    simulator["material"] = {
        "youngs_modulus_pa": stated["youngs_modulus_pa"],
        "density_kg_m3": 1080 * off(0.04),
        "damping_s": stated["damping_s"] * float(2 ** rng.uniform(-1, 1)),
        **material,
    }
    simulator["cap_mass_g"] = 50 * off(0.04)
    simulator["valve"] |= {"dead_zone_V": float(rng.uniform(0.35, 0.5)), "flow_scale": float(rng.uniform(0.9, 1.1))}
    simulator["chamber"] = {"dead_volume_ml": float(rng.uniform(5, 25))}
    simulator["sensor"] |= {"lag_ms": float(rng.uniform(1, 5))}
    simulator["arm_effects"] = [{"type": "gains", "gains": [off(0.03) for _ in range(3)]}]
    if rng.random() < 0.5:
        effects = yaml.safe_load(loader.text("mock"))["simulator"]["arm_effects"]
        simulator["arm_effects"] += [_scaled(one, rng) for one in effects if one["type"] != "gains"]
    return RigConfig.model_validate(data)


AMOUNTS = ("share", "per_bar", "by_peak", "by_cycles", "weight", "amount")


def _scaled(value: Any, rng: np.random.Generator, name: str = "") -> Any:
    """A section with each amount times a factor between 0.5 and 1.5."""
    if isinstance(value, dict):
        return {key: _scaled(item, rng, key) for key, item in value.items()}
    if isinstance(value, list):
        return [_scaled(item, rng, name) for item in value]
    return value * float(rng.uniform(0.5, 1.5)) if name in AMOUNTS else value
