"""References drawn at random: what `rig check` accepts is followed, within the limits, on an arm unlike the model."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import event, given
from hypothesis import strategies as st

import protocols
from benchmarks import tip_references
from benchmarks.support.random_tip_paths import stated_rig
from benchmarks.support.tip_closed_loop import CYCLE_S, Task, Truth, simulate
from model.arrays import Array
from protocols import BadInputError, SetPointTrajectory
from rig.config.loader import load
from rig.config.schema import RigConfig
from rig.tip_control import session
from rig.tip_control.horizon import HorizonControl
from rig.tip_control.interface import TipControlSettings
from rig.tip_planning.inverse import RigTipInverse
from tests.support.budget import examples

NEAR_MM = 3.0
"""Largest distance from the reference, also at corners and in the lead-in, on arms that differ by up to 6 %."""


def _number(low: float, high: float) -> st.SearchStrategy[float]:
    return st.floats(low, high, allow_nan=False).map(lambda x: round(x, 3))


def _point() -> st.SearchStrategy[list[float]]:
    return st.tuples(_number(-60, 60), _number(-60, 60), _number(165, 220)).map(list)


@st.composite
def tip_steps(draw: st.DrawFn) -> dict[str, Any]:
    """A `tip` step of a few seconds, about half of which the arm can follow."""
    kind = draw(st.sampled_from(["circle", "figure_eight", "star", "points", "hold"]))
    step: dict[str, Any] = {"lead_in_s": draw(_number(1.0, 3.0))}
    if kind == "hold":
        return step | {kind: {"at_mm": draw(_point()), "duration_s": 1.0}}
    if kind == "points":
        centre, size = np.array([0, 0, 190.0]), draw(_number(1, 40))
        at = [(centre + size * np.array(p)).tolist() for p in draw(_corners())]
        ways = draw(st.sampled_from(["smooth", "linear"]))
        return step | {kind: {"at_mm": at, "move_s": draw(_number(0.3, 1.5)), "dwell_s": 0.2, "ways": ways}}
    closed: dict[str, Any] = {
        "centre_mm": [draw(_number(-10, 10)), draw(_number(-10, 10)), draw(_number(178, 200))],
        "normal": [draw(_number(-0.4, 0.4)), draw(_number(-0.4, 0.4)), 1.0],
        "rotation_deg": draw(_number(-180, 180)),
        "period_s": draw(_number(0.5, 3.0)),
        "periods": draw(_number(0.5, 1.5)),
    }
    size = draw(_number(1, 40))
    sizes = {"figure_eight": {"width_mm": size, "height_mm": round(size / 2, 3)}}.get(kind, {"radius_mm": size})
    return step | {kind: closed | sizes}


def _corners() -> st.SearchStrategy[list[tuple[float, float, float]]]:
    corner = st.tuples(_number(-1, 1), _number(-1, 1), _number(-0.2, 0.2))
    return st.lists(corner, min_size=2, max_size=5, unique=True)


@cache
def _bench() -> tuple[RigTipInverse, TipControlSettings, HorizonControl]:
    config = load("mock-3")
    settings = session.settings(config, None)
    return RigTipInverse(config), settings, HorizonControl(settings)


def _truth(arm_seed: int, settings: TipControlSettings) -> Truth:
    """An arm whose material, strengths and cap differ from the model's by up to two standard deviations of 2 to 3 %."""
    rng = np.random.default_rng(arm_seed)

    def off(std: float) -> float:
        return 1 + std * float(np.clip(rng.standard_normal(), -2, 2))

    arm = settings.arm
    names = ("a1_per_n", "rpe_per_bar", "density_kg_m3", "damping_s")
    material = replace(arm.material, **{name: getattr(arm.material, name) * off(0.03) for name in names})
    return Truth(
        replace(arm, cap_mass_kg=arm.cap_mass_kg * off(0.02)).with_segment(material=material),
        np.array([off(0.02) for _ in range(3)]),
    )


def _task(played: SetPointTrajectory, settings: TipControlSettings) -> Task:
    (motion,) = played.tip.motions
    first = [settings.valve_of.index(valve) for valve in range(settings.valves)]
    begin = motion.start_s

    def of(values: Callable[[Array], Array]) -> Callable[[Array], Array]:
        return lambda times_s: values(np.minimum(begin + times_s, motion.stop_s))

    return Task(
        motion.stop_s - begin,
        of(motion.positions_m),
        of(motion.velocities_m_s),
        lambda times_s: played.sample((begin + times_s).tolist())[:, first],
        motion.period_s,
    )


@pytest.mark.slow
@examples(4)
@given(tip_steps(), st.integers(0, 10**6))
def test_an_accepted_path_is_followed_within_the_limits_and_a_refused_one_has_a_reason(
    step: dict[str, Any], arm_seed: int
) -> None:
    inverse, settings, controller = _bench()
    try:
        played = protocols.from_steps("t", [{"hold": {"duration_s": 0.5}}, {"tip": step}]).expand(3, inverse)
    except BadInputError as error:
        (problem,) = error.problems
        assert "a path that the arm follows within 0.5 mm" in problem.expected
        event("refused")
        return
    event("accepted")
    run = simulate(settings, controller, _truth(arm_seed, settings), _task(played, settings), seed=arm_seed)
    assert run.setpoint_pa.min() >= 0
    assert run.setpoint_pa.max() <= settings.pressure_limit_pa
    assert np.abs(np.diff(run.setpoint_pa, axis=0)).max() <= settings.rate_limit_pa_s * CYCLE_S * (1 + 1e-9)
    off_mm = 1e3 * np.linalg.norm(run.tip_m - run.reference_m, axis=1)
    assert off_mm.max() < NEAR_MM
    assert off_mm[-round(0.2 / CYCLE_S) :].mean() < 0.5 * NEAR_MM


@pytest.mark.slow
def test_a_path_of_the_benchmark_is_run_with_interlocks_and_kept_where_the_program_is_stopped(
    tmp_path: Path,
) -> None:
    config = RigConfig.model_validate(stated_rig())
    first, second = (tip_references.judged(2, 1, config, RigTipInverse(config)) for _ in range(2))
    assert first == second
    assert first["ended"] == ""
    assert not tip_references.is_beyond(first)
    assert tip_references.is_followed(first)
    results = tmp_path / "rows.jsonl"
    line = json.dumps(first)
    results.write_text(f"{line}\n{line[:40]}", encoding="utf-8")
    assert tip_references.known_rows(results, 1) == [first]
    assert tip_references.known_rows(results, 2) == []
    assert results.read_text(encoding="utf-8") == f"{line}\n"
    assert "| points | 1 | 1 | 0 | 0 | 1 |" in tip_references.table([first])
