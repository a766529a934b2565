"""`rig run --adapt`: the live error falls, the intervals hold, and the valve voltages do not change."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from matplotlib.figure import Figure

import model
from calibration.identify.unknowns.parameters import named
from calibration.identify.unknowns.setup import Setup
from model.dynamics import Dynamics
from model.statics import statics
from rig.config import parameters_overlay as parameter_files
from rig.config.arm_model import model_arm, true_arm
from rig.config.loader import load
from rig.execution.plan import observation_rows
from rig.observation.online_estimation import OnlineEstimation, default_parameters, estimated_quantities
from runs.records import DetectionStatus, observation_dtype
from runs.report.figure_specifications import figure_specifications
from runs.run import Run
from runs.summary import summarise
from tests.support.command_line import status_of
from tests.support.sectioned_bench import sectioned_rig

pytestmark = pytest.mark.slow

PERIOD_S = 2 * np.pi
DEFAULT_PARAMETERS = default_parameters(load("mock"))
ONE_PERIOD = """
title: Somewhat more than one period of sine-1
steps:
  - sine:
      {actuators: [1], mean_bar: 0.35, amplitude_bar: 0.25, omega_rad_s: 1, phase_deg: 240, periods: 1.4, lead_in_s: 3}
"""
COVARIANCE = np.diag(np.square([0.06e-3, 0.35e-3, 0.08e-3]))


def ran(folder: Path, seed: int, *more: str, periods: float = 1.4) -> Run:
    protocol = folder / "one-period.yaml"
    protocol.write_text(ONE_PERIOD.replace("periods: 1.4", f"periods: {periods}"))
    out = folder / f"out-{seed}-{len(more)}"
    command = ["run", protocol, "--rig", "mock-ideal", "--fast", "--yes", "--no-report", "--seed", seed]
    assert status_of(*command, "--out", out, *more) == 0
    return Run(next(out.glob("*.h5")))


@pytest.fixture(scope="module")
def runs(tmp_path_factory: pytest.TempPathFactory) -> list[Run]:
    return [ran(tmp_path_factory.mktemp("adapt"), seed, "--adapt") for seed in (3,)]


def test_the_live_error_is_at_least_halved_after_one_period(runs: list[Run]) -> None:
    for run in runs:
        assert run.adaptation is not None
        after = run.tip.time_s > 3 + PERIOD_S
        without = np.linalg.norm(run.tip.measured_mm - run.adaptation.start_model_mm, axis=1)
        assert run.tip.error_mm[after].mean() < 0.5 * without[after].mean()


def test_estimates_are_within_their_own_bounds_of_the_simulated_arm(runs: list[Run]) -> None:
    truth = Setup(true_arm(load("mock-ideal")))
    for run in runs:
        found = run.adaptation
        assert found is not None
        for k, parameter in enumerate(named(found.parameter, 3)):
            if not parameter.per_run:
                assert abs(found.value[-1, k] - parameter.read(truth)) < 1.96 * found.uncertainty[-1, k], parameter.name
        # What a sine tells is known better than before it; the archive keeps how that came about.
        a2 = found.parameter.index("a2_per_n2")
        assert found.uncertainty[-1, a2] < 0.3 * found.uncertainty[0, a2]
        assert (np.diff(found.uncertainty[:, a2]) < 1e-12).all()
        assert np.allclose(np.sqrt(np.diagonal(found.covariance[-1])), found.uncertainty[-1])


def test_the_estimates_can_be_used_for_the_next_run(runs: list[Run], tmp_path: Path) -> None:
    file = runs[0].path.with_suffix(".parameters.yaml")
    found = parameter_files.read(file).found
    assert [e["name"] for e in found.estimates] == [parameter.name for parameter in named(DEFAULT_PARAMETERS, 3)]
    assert found.data[0]["run"] == runs[0].header.run_id
    again = ran(tmp_path, 3, "--parameters", str(file), periods=0.4)
    without = np.linalg.norm(runs[0].tip.measured_mm - runs[0].adaptation.start_model_mm, axis=1)  # type: ignore[union-attr]
    assert again.tip.error_mm.mean() < 0.5 * without[: len(again.tip.time_s)].mean()
    assert again.adaptation is None


def test_estimation_does_not_change_the_valve_voltages(runs: list[Run], tmp_path: Path) -> None:
    plain = ran(tmp_path, 3, periods=0.4)
    n, frames = (plain.pressure.protocol_s < 5.4).sum(), (plain.tip.protocol_s < 5.4).sum()
    assert n > 1000
    assert frames > 150
    assert np.array_equal(plain.pressure.valve_v[:n], runs[0].pressure.valve_v[:n])
    assert np.allclose(plain.tip.model_mm[:frames], runs[0].adaptation.start_model_mm[:frames])  # type: ignore[union-attr]


def test_the_report_draws_every_estimate_with_its_95_percent_band(runs: list[Run]) -> None:
    summary, found = summarise(runs[0]), runs[0].adaptation
    assert found is not None
    (plate,) = (plate for plate in figure_specifications(runs[0], summary) if plate.name == "adaptation")
    figure = Figure(plate.size)
    plate.draw(figure, runs[0], summary)
    panels = {axes.get_title(): axes for axes in figure.axes if axes.get_title()}
    assert list(panels) == [f"{name} [{unit}]" for name, unit in zip(found.parameter, found.unit, strict=True)]
    for k, panel in enumerate(panels.values()):
        (band,) = panel.collections
        corners = band.get_paths()[0].vertices
        last = corners[corners[:, 0] == found.time_s[-1], 1]
        half = 1.96 * found.uncertainty[-1, k]
        assert np.ptp(last) == pytest.approx(2 * half, rel=1e-4)
        assert (last.min() + last.max()) / 2 == pytest.approx(found.value[-1, k], abs=1e-6 * half)


def test_over_twenty_arms_drawn_from_the_prior_the_intervals_have_their_stated_coverage() -> None:
    z = np.array([_normalised_errors(seed) for seed in range(20)])
    # 20 arms, 12 parameters each: few lie outside 95 %, and the errors are not far smaller than stated either.
    assert 0.90 < (np.abs(z) < 1.96).mean() <= 0.99
    assert 0.5 < np.sqrt((z**2).mean()) < 1.2


def _normalised_errors(seed: int, rate_hz: float = 4.0) -> np.ndarray:
    """Errors of the estimates in their own standard deviations, after one period on an arm drawn from the prior."""
    config, rng = load("mock"), np.random.default_rng(seed)
    truth, parameters = Setup(true_arm(config)), named(DEFAULT_PARAMETERS, 3)
    for parameter, start in zip(parameters, estimated_quantities(config, None, DEFAULT_PARAMETERS), strict=True):
        truth = parameter.write(truth, rng.normal(start.value[0], start.uncertainty))
    real, believed = Dynamics(truth.arm, 1 / rate_hz), Dynamics(model_arm(config), 1 / rate_hz)
    adapting = OnlineEstimation(config, None, DEFAULT_PARAMETERS)
    for k, t in enumerate(np.arange(0, 3 + PERIOD_S, 1 / rate_hz)):
        level = (0.35 + 0.25 * np.sin(max(t - 3, 0) + 4 * np.pi / 3)) * min(t / 3, 1) * 1e5
        pressure = np.array([level, 0.0, 0.0])
        read = pressure + np.array(truth.sensor_offset_pa) + rng.normal(0, 50, 3)
        shape = _moved(real, pressure, k)
        row = np.zeros((), observation_dtype(3))
        row["frame"], row["seen"], row["model_ok"], row["pressure_pa"] = k, DetectionStatus.MEASURED, 1, read
        row["measured_m"] = truth.measured(shape.tip_m[None], shape.tip_rotation[None])[0]
        row["measured_m"] += rng.multivariate_normal(np.zeros(3), COVARIANCE)
        row["covariance_m2"], row["model_m"] = COVARIANCE, _moved(believed, read, k).tip_m
        last = adapting.step(row)
    error = last["value"] - np.array([parameter.read(truth) for parameter in parameters])
    return np.asarray(error / np.sqrt(np.diagonal(last["covariance"])))


def _moved(dynamics: Dynamics, pressure: np.ndarray, k: int) -> model.Shape:
    return dynamics.start(pressure) if k == 0 else dynamics.step(pressure)


def test_the_sections_of_a_rig_narrow_the_estimates_and_are_predicted() -> None:
    rig, without = sectioned_rig(), sectioned_rig().model_copy(update={"sections": {}})
    arm, s_m = model_arm(rig), np.array([0.085, 0.125])
    estimators = {
        name: OnlineEstimation(one, None, ["law", "base"]) for name, one in (("with", rig), ("without", without))
    }
    last = {}
    for k, level in enumerate(np.linspace(1e4, 6e4, 6)):
        shape = statics(arm, [level, 0.0, level / 2])
        for name, one in (("with", rig), ("without", without)):
            row = np.zeros((), observation_rows(one))
            row["frame"], row["seen"], row["model_ok"] = k, DetectionStatus.MEASURED, 1
            row["pressure_pa"] = (level, 0.0, level / 2)
            row["measured_m"] = row["model_m"] = shape.tip_m
            row["covariance_m2"] = COVARIANCE
            if name == "with":
                row["section_seen"], row["section_covariance_m2"] = DetectionStatus.MEASURED, COVARIANCE
                row["section_m"] = row["section_model_m"] = shape.frames_at(s_m)[0]
            last[name] = estimators[name].step(row)
            if name == "with":
                np.testing.assert_allclose(row["section_model_m"], shape.frames_at(s_m)[0], atol=1e-6)
    std = {name: np.sqrt(np.diagonal(one["covariance"])) for name, one in last.items()}
    assert last["with"]["used"] == 1
    assert std["with"].shape == std["without"].shape
    assert (std["with"] <= std["without"] * (1 + 1e-9)).all()
    assert (std["with"] / std["without"]).min() < 0.9


def test_a_frame_without_a_tip_predicts_and_changes_nothing() -> None:
    config = load("mock")
    adapting = OnlineEstimation(config, None, ["law"])
    row = np.zeros((), observation_dtype(3))
    row["model_ok"], row["pressure_pa"] = 1, (3e4, 0, 0)
    row["model_m"] = statics(model_arm(config), [3e4, 0, 0]).tip_m
    row["measured_m"] = row["covariance_m2"] = np.nan
    before = row["model_m"].copy()
    done = adapting.step(row)
    assert done["used"] == 0
    assert np.allclose(row["model_m"], before, atol=1e-9)
    assert np.allclose(done["value"], [q.value[0] for q in estimated_quantities(config, None, ["law"])])


@pytest.mark.parametrize(
    ("options", "said"),
    [
        (["--adapt", "--free", "a1_per_m"], "did you mean"),
        (["--adapt", "--free", "law,damping_s"], "shows only in how the arm moves"),
        (["--free", "law"], "--adapt"),
    ],
)
def test_an_invalid_request_gets_one_sentence(
    options: list[str], said: str, capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    assert status_of("run", "sine-1", "--fast", "--yes", "--out", tmp_path, *options) == 2
    told = capsys.readouterr().err
    assert said in told
    assert "Traceback" not in told


def test_the_json_output_names_the_parameter_file(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    protocol = tmp_path / "short.yaml"
    protocol.write_text("title: short\nsteps:\n  - hold: {duration_s: 1}\n")
    options = ["--fast", "--yes", "--no-report", "--json", "--adapt", "--free", "law", "--out", str(tmp_path)]
    assert status_of("run", protocol, *options) == 0
    assert Path(json.loads(capsys.readouterr().out)["parameters"]).exists()
