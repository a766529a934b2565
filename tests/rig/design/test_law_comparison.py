"""`rig design --compare`: within the limits of the rig, and `rig identify compare` finds the true law in its data."""

from __future__ import annotations

import itertools
import json
from collections import Counter
from pathlib import Path

import numpy as np
import pytest

import protocols
from calibration.identify import identify
from calibration.identify.model_comparison import MIN_DECISIVE, ComparisonFit, fit_all
from calibration.identify.parameters import Setup
from calibration.identify.simulated_experiments import MeasurementErrors, perform_as_planned
from rig.cli.design_output import separations
from rig.config.arm_model import model_arm
from rig.config.loader import load
from rig.design.law_comparison import LawDesign, design_comparison, in_order, levels
from rig.experiment.preflight import check
from rig.identify.estimation import rig_uncertainties, sensor_priors
from rig.identify.model_comparison import compare, laws_named
from tests.support.command_line import status_of

pytestmark = pytest.mark.slow

CONFIG = load("mock-ideal")
LAWS = ("homogeneous+rpe", "pointwise")


@pytest.fixture(scope="module")
def designed() -> LawDesign:
    return design_comparison(CONFIG, LAWS, duration_s=40.0)


def test_the_protocol_keeps_the_limits_and_the_duration(designed: LawDesign, tmp_path: Path) -> None:
    file = tmp_path / "laws.yaml"
    file.write_text(designed.text)
    trajectory = protocols.load(str(file)).expand(CONFIG.actuators)
    assert check(CONFIG, trajectory) == ()
    assert 36.0 < trajectory.duration_s <= 40.0
    levels_pa = [segment.level_pa for segment in trajectory.segments]
    assert levels_pa == [segment.level_pa for segment in designed.protocol.expand(CONFIG.actuators).segments]


def test_an_identification_reads_every_level_as_a_plateau(designed: LawDesign) -> None:
    visited = Counter(map(tuple, designed.planned.pressure_pa.round().tolist()))
    assert not designed.planned.moving
    assert sum(visited.values()) == len(designed.planned) >= 10
    every = {tuple(round(bar * 1e5) for bar in level) for level in levels(CONFIG)}
    assert set(visited) <= every


def test_a_comparison_of_its_data_decides_for_the_true_law(
    designed: LawDesign, monkeypatch: pytest.MonkeyPatch
) -> None:
    # On one core the work stays in this process: others would take longer to start than so small a comparison does.
    monkeypatch.setattr("os.cpu_count", lambda: 1)
    true, errors = 1, MeasurementErrors()
    start = designed.laws[true].unknowns.start
    data = perform_as_planned(designed.planned, start, np.random.default_rng(5), errors)
    found = compare(start, [data], (), {}, between=LAWS, config=CONFIG).comparison
    assert min(found.rows, key=lambda row: row.bic).candidate.name == designed.laws[true].name
    assert f"Decision: {designed.laws[true].name};" in found.sentence


def test_a_law_is_not_refuted_by_a_stated_modulus_that_its_data_do_not_determine(designed: LawDesign) -> None:
    """The wall closest to the rig's arm is much stiffer than the rig says, and these errors hide how stiff."""
    true, errors = designed.laws[0].unknowns.start, MeasurementErrors()
    data = perform_as_planned(designed.planned, true, np.random.default_rng(8), errors)
    start = Setup(model_arm(CONFIG))
    assert true.arm.material.youngs_modulus_pa > 3 * start.arm.material.youngs_modulus_pa
    stated = rig_uncertainties(CONFIG, start)
    priors = tuple(sensor_priors(stated).items())
    tasks = [ComparisonFit(law, (data,), priors, stated=tuple(stated.items())) for law in laws_named(LAWS, start, "")]
    held = identify((data,), start, tasks[0].candidate.free, dict(priors), stated=stated)
    assert not held["youngs_modulus_pa"].identified
    homogeneous, pointwise = (fit_all(task)[1] for task in tasks)
    assert pointwise - homogeneous > MIN_DECISIVE


def test_a_design_promises_nothing_where_one_law_contains_the_other(
    designed: LawDesign, capsys: pytest.CaptureFixture[str]
) -> None:
    assert not designed.sufficient
    separations(designed, Path("laws.yaml"), "", as_json=False)
    said = " ".join(capsys.readouterr().out.split())
    assert "homogeneous+rpe inhomogeneous+rpe, pointwise 0 at most" in said
    assert "no pressures tell them apart if homogeneous+rpe is true" in said


def test_equal_levels_are_no_neighbours() -> None:
    course = in_order([(0.1,), (0.1,), (0.1,), (0.3,), (0.5,), (0.7,)], seed=2)
    assert sorted(course) == [(0.1,), (0.1,), (0.1,), (0.3,), (0.5,), (0.7,)]
    assert all(a != b for a, b in itertools.pairwise(course))


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["--compare", "secan", "pointwise"], "did you mean secant"),
        (["--compare", "secant", "secant"], "two different laws"),
        (["--compare", "secant", "pointwise", "--free", "law"], "--compare has its own free parameters"),
        (["--compare", "secant", "pointwise", "--duration-s", "10"], "to 14400 s"),
        (["--rig", "mock-no-camera"], "a design is about measured tips"),
    ],
)
def test_bad_input_gets_one_message(
    words: list[str], said: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    file = tmp_path / "design.yaml"
    assert status_of("design", "--rig", "mock", "--to", file, *words) == 2
    assert said in " ".join(capsys.readouterr().err.split())
    assert not file.exists()


def test_the_command_prints_the_expected_decisions(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    file = tmp_path / "laws.yaml"
    words = ["design", "--rig", "mock-ideal", "--compare", *LAWS, "--duration-s", "30", "--to", str(file), "--json"]
    assert status_of(*words) == 0
    found = json.loads(capsys.readouterr().out)
    assert [case["true"] for case in found["cases"]] == ["homogeneous+rpe", "inhomogeneous+rpe, pointwise"]
    assert found["cases"][1]["right"] > 0.99
    assert found["cases"][0]["right"] < 0.95 < found["right_in_longest"][0]
    assert "--between 'homogeneous+rpe' 'inhomogeneous+rpe, pointwise'" in file.read_text()
