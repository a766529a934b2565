"""`rig identify` from the command line: report, profiles, runs left out, model choice."""

from __future__ import annotations

import json
import re
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest

import runs
from calibration.identify import NoDataError, Poses, Setup
from calibration.identify.simulated_experiments import MeasurementErrors, perform, plan
from calibration.identify.unknowns.parameters import groups, known
from rig.config.arm_model import model_arm
from rig.config.loader import load, text
from rig.config.parameters_overlay import read
from rig.identify import estimation
from runs.archive.writer import finalise
from runs.journal.journal import JournalWriter
from runs.records import DetectionStatus, RunFooter, Status, observation_dtype, sample_dtype
from tests.support.command_line import status_of
from tests.support.sectioned_bench import sectioned
from tests.support.synthetic_runs import header

pytestmark = pytest.mark.slow

HOLD_S, HZ = 3, 30
TRUE = {"a1_per_n": 0.0079, "a2_per_n2": 0.00034, "rpe_per_bar": 0.049}


def archive(
    folder: Path, name: str, pressure_bar: np.ndarray, weight_kg: np.ndarray, rig_yaml: str = text("mock")
) -> Path:
    """A run of plateaus on an arm that is softer than the mock's file says, as its archive would be."""
    arm = model_arm(load("mock"))
    truth = Setup(arm.with_segment(material=replace(arm.material, **TRUE)))
    poses = perform(
        plan(name, pressure_bar * 1e5, weight_kg), truth, np.random.default_rng(2), MeasurementErrors((0, 0, 0), 0, 0)
    )
    rng = np.random.default_rng(len(name))
    n = len(poses) * HOLD_S * HZ
    which = np.arange(n) // (HOLD_S * HZ)
    about = replace(header(name), rig_yaml=rig_yaml, intervals=(), quantities=(), control_hz=HZ, camera_hz=HZ)
    samples, rows = np.zeros(n, sample_dtype(3, 2)), np.zeros(n, observation_dtype(3))
    samples["cycle"] = rows["frame"] = np.arange(n)
    samples["t_ns"] = rows["t_ns"] = about.started_t_ns + np.arange(n) * 1_000_000_000 // HZ
    samples["protocol_s"] = rows["protocol_s"] = np.arange(n) / HZ
    samples["setpoint_pa"], samples["scans"] = poses.pressure_pa[which], 1
    samples["measured_pa"] = rows["pressure_pa"] = poses.pressure_pa[which] + rng.normal(0, 30, (n, 3))
    rows["weight_kg"], rows["seen"] = weight_kg[which], DetectionStatus.MEASURED
    rows["measured_m"] = poses.tip_m[which] + rng.normal(0, 1e-4, (n, 3))
    rows["covariance_m2"] = np.eye(3) * 1e-8
    rows["orientation_rad"] = rows["orientation_covariance_rad2"] = rows["cross_covariance_m_rad"] = np.nan
    journal = JournalWriter(folder / f"{name}.mcap", about)
    journal.samples(samples)
    journal.observations(rows)
    journal.close(RunFooter(int(rows["t_ns"][-1]), Status.FINISHED, ""))
    return finalise(journal.path)


@pytest.fixture(scope="module")
def bench(tmp_path_factory: pytest.TempPathFactory) -> dict[str, str]:
    folder = tmp_path_factory.mktemp("bench")
    ramp, none = np.linspace(0.0, 0.6, 5)[:, None], np.zeros(5)
    made = {
        "weights": archive(folder, "weights", np.zeros((5, 3)), np.linspace(0, 1.2, 5)),
        "one": archive(folder, "one", ramp * np.array([1.0, 0, 0]), none),
        "two": archive(folder, "two", ramp * np.array([0, 1.0, 1.0]), none),
    }
    return {name: str(path) for name, path in made.items()}


def rig(*arguments: str, status: int = 0) -> None:
    assert status_of("identify", *arguments) == status


def test_the_report_holds_everything_and_loads_nothing(
    bench: dict[str, str], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    page, found = tmp_path / "page.html", tmp_path / "arm.yaml"
    options = ["--free", "law,rpe_per_bar,damping_s", "--leave-out", bench["two"]]
    rig(
        bench["weights"],
        bench["one"],
        bench["two"],
        *options,
        "--report",
        str(page),
        "--to",
        str(found),
    )
    html, said = page.read_text(), capsys.readouterr()
    for heading in (
        "Parameters",
        "Intervals",
        "Residuals",
        "quantiles",
        "Correlations",
        "left out",
    ):
        assert re.search(f"<h2>[^<]*{heading}", html), heading
    assert "These runs were simulated" in html
    assert not re.search(r"(src|href)=\"http", html)
    assert runs.open(bench["one"]).sha256 in html
    # The run that was left out is predicted, not fitted.
    assert "two (left out)" in said.out
    before, after = map(float, re.findall(r"two \(left out\): rms ([\d.]+) -> ([\d.]+)", said.out)[0])
    assert after < 0.1 * before
    assert "damping_s: no effect on the data" in said.out
    verdicts = {e["name"]: e["verdict"] for e in read(found).found.estimates}
    assert verdicts["damping_s"] == "no effect on the data"


def test_json_holds_the_predictions_with_intervals_from_which_their_coverage_follows(
    bench: dict[str, str], capsys: pytest.CaptureFixture[str]
) -> None:
    free = "law,rpe_per_bar,sensor_offsets"
    rig(bench["weights"], bench["one"], "--leave-out", bench["two"], "--free", free, "--json")
    said = capsys.readouterr()
    facts = json.loads(said.out)
    (found,) = facts["predictions"]
    assert found["run"] == "two"
    assert [words[:32] for words in found["outside_fit"]] == [
        "the pressure of chamber 2 reache",
        "the pressure of chamber 3 reache",
        "these chambers are pressed toget",
    ]
    left = "two leaves the range of the fit: these chambers are pressed together, but not in the fit: 2 and 3"
    assert left in facts["warnings"]
    measured, predicted = np.array(found["measured_mm"]), np.array(found["predicted_mm"])
    low, high = np.moveaxis(np.array(found["interval_95_mm"]), 2, 0)
    std = np.sqrt(np.diagonal(np.array(found["covariance_mm2"]), axis1=1, axis2=2))
    assert measured.shape == std.shape == (len(found["time_s"]), 3)
    assert high - low == pytest.approx(2 * 1.96 * std, rel=1e-3)
    inside = ((low <= measured) & (measured <= high)).mean(axis=0)
    assert inside == pytest.approx([found["share_in_95"][axis] for axis in "xyz"])
    assert found["rms_mm"] == pytest.approx(np.sqrt(((measured - predicted) ** 2).sum(axis=1).mean()))
    assert re.search(r"two \(left out\): .*; stated [\d.]+ mm; in their 95 % intervals: x \d+ %", said.err)


def test_a_comparison_ends_with_a_table_like_the_papers_and_a_sentence(
    bench: dict[str, str], capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    # On one core the work stays in this process: others would take longer to start than so small a comparison does.
    monkeypatch.setattr("os.cpu_count", lambda: 1)
    rig("compare", bench["weights"], bench["one"], bench["two"], "--free", "base_z_m", "--json")
    found = json.loads(capsys.readouterr().out)
    assert found["best"] == "inhomogeneous+rpe"
    assert "predicts runs left out best" in found["sentence"]
    assert {(row["inhomogeneous"], row["radial_effect"]) for row in found["rows"]} == {(0, 0), (0, 1), (1, 1)}


def test_a_comparison_of_two_laws_ends_with_a_decision(
    bench: dict[str, str], capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("os.cpu_count", lambda: 1)
    rig("compare", bench["weights"], bench["one"], "--between", "homogeneous+rpe", "inhomogeneous+rpe", "--json")
    found = json.loads(capsys.readouterr().out)
    assert [row["model"] for row in found["rows"]] == ["homogeneous+rpe", "inhomogeneous+rpe"]
    assert "Decision: inhomogeneous+rpe" in found["sentence"]


def test_every_parameter_is_named_by_the_help_and_by_the_error_for_an_unknown_one(
    bench: dict[str, str], capsys: pytest.CaptureFixture[str]
) -> None:
    rig("fit", "--help")
    help_text = re.sub(r"[\s│]+", " ", capsys.readouterr().out)
    rig(bench["one"], "--free", "lwa", status=2)
    error = capsys.readouterr().err
    assert "did you mean law?" in error
    for name in (*groups(3), *known(3)):
        first_of_its_kind = re.sub(r"_([23])_", "_1_", re.sub(r"_(r?)[yz]_", r"_\1x_", name))
        assert first_of_its_kind in help_text
        assert name in error


def test_the_result_is_on_standard_output_in_units_of_the_bench(
    bench: dict[str, str], capsys: pytest.CaptureFixture[str]
) -> None:
    rig(bench["weights"], bench["one"], "--free", "law", "--leave-out", bench["two"])
    out = capsys.readouterr().out
    assert re.search(r"a1_per_n +\d\.\d+\(\d+\) x 10\^-3 /N", out)
    # What is not free is listed with its stated uncertainty and with what the fit made of it.
    assert re.search(r"inner_radius_m +9\.5\(5\) mm +9\.\d+\(\d+\) mm", out)
    assert re.search(r"two \(left out\): rms", out)
    # No model ran beside these runs.
    assert "before: error of the initial parameters on the plateaus" in out


def test_json_carries_every_warning_of_the_text(bench: dict[str, str], capsys: pytest.CaptureFixture[str]) -> None:
    asked = [bench["weights"], bench["one"], "--free", "law,base", "--leave-out", bench["two"]]
    rig(*asked, "--json")
    warnings = json.loads(capsys.readouterr().out)["warnings"]
    rig(*asked)
    said = capsys.readouterr().out
    assert any("leaves the range of the fit" in words for words in warnings)
    assert all(f"{words[0].upper()}{words[1:]}." in said for words in warnings)


def test_the_export_is_written_and_the_noise_model_is_named(
    bench: dict[str, str], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    file = tmp_path / "fit.npz"
    rig(bench["weights"], bench["one"], "--free", "law", "--noise", "white", "--export", str(file), "--json")
    facts = json.loads(capsys.readouterr().out)
    assert facts["noise"] == "white"
    with np.load(file) as saved:
        assert saved["jacobian"].shape == (len(saved["residual"]), len(saved["theta"]))
        np.testing.assert_allclose(saved["std"], np.sqrt(np.diagonal(facts["covariance"])))
    rig(bench["one"], "--noise", "withe", status=2)
    assert "white" in capsys.readouterr().err


def test_progress_is_printed_without_a_terminal(
    bench: dict[str, str], monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr("rig.cli.progress.LINE_PERIOD_S", 0.01)
    rig(bench["one"], bench["two"], "--free", "law,rpe_per_bar")
    assert re.search(r"searching: \d+ s, one start, round \d+, step \d+: rms \d+\.\d+ mm", capsys.readouterr().err)


def test_the_rest_of_a_run_is_predicted_and_drawn(
    bench: dict[str, str], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    middle_s = runs.open(bench["one"]).duration_s / 2
    page = tmp_path / "arm.html"
    told = ["--split-s", f"{middle_s:g}", "--report", str(page)]
    rig(bench["one"], "--free", "law,rpe_per_bar", *told)
    said = capsys.readouterr()
    before, after = map(float, re.findall(rf"from {middle_s:g} s \(left out\): rms ([\d.]+) -> ([\d.]+)", said.out)[0])
    assert after < 0.3 * before
    assert "" not in said.err.splitlines()  # what a bar leaves behind where there is no terminal
    assert "before, rms" in page.read_text()


def test_a_named_rig_is_where_the_search_starts(
    bench: dict[str, str], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    light = tmp_path / "light.yaml"
    light.write_text(text("mock").replace("  cap_mass_g: 50\n", "  cap_mass_g: 30\n"))
    rig(bench["weights"], bench["one"], "--free", "law", "--start", str(light), "--json")
    cap = next(e for e in json.loads(capsys.readouterr().out)["estimates"] if e["name"] == "cap_mass_kg")
    assert cap["stated"]["mean"] == pytest.approx(0.03)


@pytest.mark.parametrize(
    ("options", "said"),
    [
        (["--every", "2"], "needs --quasi-static"),
        (["--start", "nowhere"], "there is no such file"),
        (["--split-s", "1e6"], "shows no tip after"),
    ],
)
def test_an_invalid_start_or_split_is_refused(
    bench: dict[str, str], options: list[str], said: str, capsys: pytest.CaptureFixture[str]
) -> None:
    rig(bench["one"], *options, status=2)
    # A narrow terminal breaks the sentence.
    assert said in re.sub(r"[\s│]+", " ", capsys.readouterr().err)


def test_an_invalid_output_path_is_refused_before_the_search(
    bench: dict[str, str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr("rig.identify.estimation.from_poses", lambda *_: pytest.fail("the search had begun"))
    (tmp_path / "short.yaml").write_text(text("mock").replace("length_mm: 170", "length_mm: 140"), encoding="utf-8")
    found = str(tmp_path / "found.yaml")
    for options, said in (
        (["--rig-file", found, "--report", str(tmp_path)], "is a folder: name a file"),
        (["--to", str(tmp_path / "short.yaml" / "a.yaml")], "short.yaml is not a folder"),
    ):
        rig(bench["one"], *options, status=2)
        assert said in re.sub(r"[\s│]+", " ", capsys.readouterr().err)
    assert not (tmp_path / "found.parameters.yaml").exists()


def test_runs_of_another_arm_are_refused_unless_one_arm_is_named(
    bench: dict[str, str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    short = text("mock").replace("length_mm: 170", "length_mm: 140")
    other = str(archive(tmp_path, "other", np.array([[0.1, 0, 0], [0.3, 0, 0]]), np.zeros(2), short))
    for asked in ([bench["one"], other], [bench["one"], "--leave-out", other]):
        rig(*asked, status=2)
        assert "length_mm 140.0, not 170.0" in capsys.readouterr().err

    def begun(*_: object) -> None:
        raise NoDataError("the search began")

    monkeypatch.setattr("rig.identify.estimation.from_poses", begun)
    rig(bench["one"], other, "--start", "mock", status=2)
    assert "the search began" in capsys.readouterr().err


def test_runs_with_different_camera_placements_are_reported_to_share_one_base(
    bench: dict[str, str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def begun(*_: object) -> None:
        raise NoDataError("the search began")

    monkeypatch.setattr("rig.identify.estimation.from_poses", begun)
    moved = text("mock").replace("translation_mm: [0, 400, 200]", "translation_mm: [0, 401, 200]")
    other = str(archive(tmp_path, "moved", np.array([[0.1, 0, 0], [0.3, 0, 0]]), np.zeros(2), moved))
    rig(bench["one"], bench["two"], status=2)
    assert "front" not in capsys.readouterr().err
    rig(bench["one"], other, status=2)
    said = capsys.readouterr().err
    assert "moved: its rig places camera front elsewhere than that of one" in said
    assert "--per-run base" in said


def test_runs_with_different_sections_of_one_name_are_reported_to_share_one_mounting(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def begun(*_: object) -> None:
        raise NoDataError("the search began")

    monkeypatch.setattr("rig.identify.estimation.from_poses", begun)
    rigs = {"first": sectioned(text("mock-charuco"))}
    rigs["moved"] = rigs["first"].replace("at_mm: 85", "at_mm: 90")
    pressures = np.array([[0.1, 0, 0], [0.3, 0, 0]])
    first, moved = (str(archive(tmp_path, name, pressures, np.zeros(2), rig_file)) for name, rig_file in rigs.items())
    rig(first, moved, status=2)
    said = capsys.readouterr().err
    assert "moved: its rig has another section middle than that of first" in said
    assert "section lower" not in said


def test_a_base_per_run_is_reported_for_each_run_and_its_mean_is_written(
    bench: dict[str, str], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    file = tmp_path / "arm.yaml"
    rig(bench["one"], bench["two"], "--free", "law,base_x_m", "--per-run", "base_x_m", "--to", str(file), "--json")
    found = json.loads(capsys.readouterr().out)
    own = {e["run"]: e["value"] for e in found["estimates"] if e["name"] == "base_x_m"}
    assert set(own) == {runs.open(bench[name]).header.run_id for name in ("one", "two")}
    written = read(file).found.mounting.base_translation_mm
    assert written[0] == pytest.approx(1e3 * sum(own.values()) / 2, abs=1e-9)


def test_what_cannot_differ_between_the_runs_is_refused(
    bench: dict[str, str], capsys: pytest.CaptureFixture[str]
) -> None:
    rig(bench["one"], "--free", "law", "--per-run", "damping_s", status=2)
    assert "damping_s cannot differ between the runs: it has no effect on them" in capsys.readouterr().err


@pytest.mark.parametrize(("moving", "damped"), [(True, True), (False, False)])
def test_damping_is_free_by_default_where_a_run_moves(
    moving: bool, damped: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(estimation, "identify", lambda data, start, free, *_, **__: free)
    free: Any = estimation.from_poses(
        load("mock"),
        [cast(Poses, SimpleNamespace(moving=moving, has_orientation=np.zeros(1, np.bool_), sections=()))],
        (),
        {},
    )
    assert ("damping_s" in free) == damped
    assert {"a1_per_n", "a2_per_n2", "rpe_per_bar", "base", "sensor_offsets"} <= set(free)


def test_a_result_that_contradicts_the_rig_file_is_called_one(
    bench: dict[str, str], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    stiff = text("mock").replace("a1_per_N: 0.00742681", "a1_per_N: 0.004")
    file = archive(tmp_path, "weights", np.zeros((5, 3)), np.linspace(0, 1.2, 5), stiff)
    rig(str(file))
    assert "The result contradicts what the rig file states" in capsys.readouterr().out
    rig(bench["weights"])
    assert "contradicts" not in capsys.readouterr().out
