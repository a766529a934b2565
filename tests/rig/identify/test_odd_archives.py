"""Unusual archives, and archives that do not belong together, give a fit or one sentence."""

from __future__ import annotations

import math
import re
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml

import runs
from calibration.identify import Setup, in_motion
from calibration.identify.prediction.tip_predictor import Predictor
from calibration.identify.simulated_experiments import MeasurementErrors, plan
from rig.config import loader
from rig.config.arm_model import model_arm
from rig.config.loader import load, parse, text
from rig.config.parameters_overlay import MountingSection, read
from rig.identify.initial_setup import truth_of
from runs.archive.writer import finalise
from runs.journal.journal import JournalWriter
from runs.records import DetectionStatus, RunFooter, RunHeader, Status, observation_dtype, sample_dtype
from tests.support.command_line import status_of
from tests.support.synthetic_runs import header

pytestmark = pytest.mark.slow

HZ, CYCLE_HZ = 15, 60
AT_REST = "--quasi-static"
"""The shortest search, for tests of what is not about motion."""
MILLISECOND = 1_000_000


def about(name: str, **changes: Any) -> RunHeader:
    plain = {"rig_yaml": text("mock"), "intervals": (), "quantities": (), "control_hz": CYCLE_HZ, "camera_hz": HZ}
    return replace(header(name), **{**plain, **changes})


def archive(
    folder: Path,
    name: str = "odd",
    frames: int = 18,
    cycles: int = 72,
    seen: DetectionStatus = DetectionStatus.MEASURED,
    swing_pa: float = 1.5e4,
    std_m: tuple[float, float, float] = (1e-4, 1e-4, 1e-4),
    status: Status = Status.FINISHED,
    frame_hz: float = HZ,
    actuators: int = 3,
    **changes: Any,
) -> Path:
    """An arm of the mock's file that swings for a second, as its archive would be."""
    rng = np.random.default_rng(frames + cycles)
    who = about(name, actuators=actuators, **changes)
    samples, rows = np.zeros(cycles, sample_dtype(actuators, 2)), np.zeros(frames, observation_dtype(actuators))

    def course(time_s: np.ndarray) -> np.ndarray:
        return 3e4 + swing_pa * np.sin(3.0 * time_s)[:, None] * np.eye(actuators)[0]

    sampled_s, frame_s = np.arange(cycles) / CYCLE_HZ, np.arange(1, frames + 1) / HZ
    samples["cycle"], samples["scans"] = np.arange(cycles), 1
    samples["t_ns"] = who.started_t_ns + np.round(sampled_s * 1e9).astype(np.int64)
    samples["setpoint_pa"] = course(sampled_s)
    samples["measured_pa"] = samples["setpoint_pa"] + (rng.normal(0, 20, (cycles, actuators)) if swing_pa else 0.0)
    rows["frame"], rows["seen"] = np.arange(1, frames + 1), seen
    rows["t_ns"] = who.started_t_ns + np.round(frame_s * HZ / frame_hz * 1e9).astype(np.int64)
    samples["protocol_s"], rows["protocol_s"] = sampled_s, frame_s
    rows["covariance_m2"] = np.diag(np.square(std_m))
    rows["orientation_rad"] = rows["orientation_covariance_rad2"] = rows["cross_covariance_m_rad"] = np.nan
    if frames and actuators == 3:
        planned = plan("swing", course(frame_s), period_s=1 / HZ, errors=MeasurementErrors())
        rows["measured_m"] = Predictor(planned)(Setup(model_arm(load("mock")))) + rng.normal(0, 1e-4, (frames, 3))
    if seen is not DetectionStatus.MEASURED:
        rows["measured_m"] = np.nan
    journal = JournalWriter(folder / f"{name}.mcap", who)
    journal.samples(samples)
    journal.observations(rows)
    journal.close(RunFooter(who.started_t_ns + 3_000 * MILLISECOND, status, ""))
    return finalise(journal.path)


def identify(capsys: pytest.CaptureFixture[str], *arguments: str | Path, status: int) -> str:
    ended, said = status_of("identify", *arguments), capsys.readouterr()
    assert ended == status, said
    # A narrow terminal breaks the sentence.
    return re.sub(r"[\s│]+", " ", said.out + said.err)


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        ({"frames": 0}, "no frame shows the tip"),
        ({"seen": DetectionStatus.NO_BOARD}, "no frame shows the tip"),
        ({"cycles": 0}, "no pressure was recorded"),
        ({"std_m": (1e-4, 0.0, 1e-4)}, "uncertainty is zero along an axis"),
        ({"rig_yaml": ""}, "holds no rig"),
        ({"frame_hz": math.inf}, "does not increase"),
    ],
)
def test_an_archive_without_usable_data_is_refused_in_one_sentence(
    tmp_path: Path, changes: dict[str, Any], said: str, capsys: pytest.CaptureFixture[str]
) -> None:
    told = identify(capsys, archive(tmp_path, **changes), "--free", "law", status=2)
    assert said in told
    assert "odd" in told
    assert "Traceback" not in told


@pytest.mark.parametrize(
    "changes",
    [
        {"frames": 1},
        {"frames": 2},
        {"cycles": 1},
        {"swing_pa": 0.0},
        {"status": Status.ABORTED, "frames": 6, "cycles": 24},
    ],
)
def test_an_archive_with_little_information_gives_verdicts_or_wide_error_bars(
    tmp_path: Path, changes: dict[str, Any], capsys: pytest.CaptureFixture[str]
) -> None:
    told = identify(capsys, archive(tmp_path, **changes), "--free", "law,damping_s", status=0)
    assert "a1_per_n" in told


def test_frames_after_the_last_pressure_do_not_count(tmp_path: Path) -> None:
    run = runs.open(archive(tmp_path, frames=45, cycles=60))
    poses = in_motion(run)
    assert (poses.time_s[poses.has_tip] < 1 + 2 / HZ).all()
    assert poses.has_tip.sum() > 10


def test_a_camera_slower_than_asked_does_not_change_the_arms_time(tmp_path: Path) -> None:
    run = runs.open(archive(tmp_path, camera_hz=30.0))
    assert in_motion(run).period_s == pytest.approx(1 / HZ, rel=1e-6)


def test_a_run_that_is_named_twice_counts_once(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    # On a busy machine lines of progress would stand between those that are compared.
    monkeypatch.setattr("rig.cli.progress.LINE_PERIOD_S", 3600.0)
    path = archive(tmp_path)
    once = identify(capsys, path, "--free", "a1_per_n", AT_REST, status=0)
    twice = identify(capsys, path, path.name, "--free", "a1_per_n", AT_REST, status=0)
    assert "odd.h5 is named twice and counts once" in twice
    result, _, _ = once.partition("searching:")  # progress is reported as often as the machine is slow
    assert result in twice
    assert "nothing is left" in identify(capsys, path, "--leave-out", path.name, status=2)


def test_a_run_and_its_replay_are_one_experiment(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    run, replay = archive(tmp_path), archive(tmp_path, "again", frames=16, parent="odd")
    other = archive(tmp_path, "other", frames=17, started_utc_ns=1)
    told = identify(capsys, run, other, replay, "--free", "law", status=2)
    assert "odd.h5 and" in told
    assert "are of one run" in told


@pytest.fixture(scope="module")
def with_parameters(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path, Path]:
    """A run of the mock's rig, parameters of it that move and turn what they found, and a run that was given these."""
    folder = tmp_path_factory.mktemp("parameters")
    plain, file = archive(folder, "plain", started_utc_ns=1), folder / "first.yaml"
    assert status_of("identify", plain, "--free", "a1_per_n", AT_REST, "--to", file) == 0
    found = yaml.safe_load(file.read_text())
    found["mounting"] |= {"base_translation_mm": [3.0, 0.0, 1.0], "base_rotation_deg": [0.0, 0.0, 90.0]}
    found["mounting"]["tool_offset_mm"], found["sensing"]["gain"] = [0.0, 1.0, 0.0], [1.02, 1.0, 1.0]
    found["arm"]["geometry"]["actuator_angles_deg"][0] += 0.5
    file.write_text(yaml.safe_dump(found, sort_keys=False))
    moved = archive(folder, "moved", started_utc_ns=2, parameters_yaml=file.read_text())
    return plain, file, moved


def test_runs_with_different_baseline_parameters_are_not_mixed(
    with_parameters: tuple[Path, Path, Path], capsys: pytest.CaptureFixture[str]
) -> None:
    plain, _, moved = with_parameters
    told = identify(capsys, plain, moved, "--free", "law", status=2)
    assert "different parameters applied to their rigs" in told


def test_results_of_runs_with_a_parameter_overlay_apply_to_the_rig_without_it(
    with_parameters: tuple[Path, Path, Path], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    _, first, moved = with_parameters
    file, rig = tmp_path / "second.yaml", tmp_path / "rig.yaml"
    told = identify(capsys, moved, "--free", "a1_per_n,base_x_m", AT_REST, "--to", file, "--rig-file", rig, status=0)
    assert "relative to them" in told
    second = read(file).found
    used = {e["name"]: e["used"] for e in second.estimates}
    shift, side, up = (1e3 * used[f"base_{axis}_m"] for axis in "xyz")
    assert abs(shift) > 1e-3
    # The base that the first parameters turned by a quarter: its x is the plain rig's y.
    assert second.mounting.base_translation_mm == pytest.approx((3.0 - side, shift, 1.0 + up), abs=1e-9)
    assert second.mounting.base_rotation_deg == pytest.approx((0.0, 0.0, 90.0), abs=1.0)
    tool = [1e3 * used[f"tool_{axis}_m"] for axis in "xyz"]
    assert second.mounting.tool_offset_mm == pytest.approx(np.add((0.0, 1.0, 0.0), tool))
    gains = [used[f"sensor_{n}_gain"] for n in (1, 2, 3)]
    assert second.sensing.gain == pytest.approx(np.multiply((1.02, 1.0, 1.0), gains))
    assert second.estimates_count_from is not None
    assert MountingSection(**second.estimates_count_from["mounting"]) == read(first).found.mounting

    plain = loader.read("mock")
    wanted = plain.identified(read(file)).config
    again = plain.identified(read(first)).identified(read(file)).config
    for other in (parse(rig.read_text(), "written"), again):
        assert other.arm == wanted.arm
        for name, camera in wanted.cameras.items():
            placed = other.cameras[name].placement
            assert placed.translation_mm == pytest.approx(camera.placement.translation_mm, abs=1e-9)
            assert placed.rotation_deg == pytest.approx(camera.placement.rotation_deg, abs=1e-9)
        assert other.board.placement.translation_mm == pytest.approx(wanted.board.placement.translation_mm)
        for one, sensor in zip(other.sensors, wanted.sensors, strict=True):
            assert one.span_bar == pytest.approx(sensor.span_bar)


def test_a_run_of_another_arm_is_not_predicted(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    two = archive(tmp_path, "two", actuators=2, started_utc_ns=2)
    told = identify(capsys, archive(tmp_path), "--free", "law", "--leave-out", two, status=2)
    assert "two is of 2 actuators, the others are of 3" in told


def test_the_bore_stays_below_the_outer_radius(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    thin = text("mock").replace("outer_radius_mm: 14", "outer_radius_mm: 9.6")
    told = identify(capsys, archive(tmp_path, rig_yaml=thin), "--free", "inner_radius_m", AT_REST, status=0)
    assert "inner_radius_m" in told


def test_the_rig_that_is_written_is_the_runs_own(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    own = text("mock").replace("name: mock", "name: ours").replace("keep_every: 3", "keep_every: 7")
    found = tmp_path / "deep" / "found.yaml"
    identify(capsys, archive(tmp_path, rig_yaml=own), "--free", "law", AT_REST, "--rig-file", found, status=0)
    assert load(str(found)).name == "ours"


def test_the_true_mounting_of_an_arm_that_is_mounted_as_stated_is_exactly_zero(tmp_path: Path) -> None:
    truth = truth_of(runs.open(archive(tmp_path, rig_yaml=text("mock-ideal"))))
    mounting = {name: value for name, value in truth.items() if name.startswith(("base_", "tool_"))}
    assert len(mounting) == 12
    assert set(mounting.values()) == {0.0}


def test_the_simulated_truth_includes_the_true_mounting(tmp_path: Path) -> None:
    rig = yaml.safe_load(text("mock"))
    simulator, board = rig["simulator"], rig["board"]["placement"]
    simulator["geometry"] = {**rig["arm"]["geometry"], "actuator_angles_deg": [5, 120, 237]}
    simulator["board"] = {**board, "translation_mm": np.add(board["translation_mm"], (1, 2, 3)).tolist()}
    simulator["base"] = {"translation_mm": [4, 5, 6]}
    simulator["built"] = {"lenses": {"front": rig["cameras"]["front"]["lens"]}, "valves": rig["valves"],
                          "sensors": [{**s, "span_bar": [0, 8]} for s in rig["sensors"]]}  # fmt: skip
    truth = truth_of(runs.open(archive(tmp_path, rig_yaml=yaml.safe_dump(rig))))
    assert [truth[f"actuator_{n}_turn_rad"] for n in (1, 2, 3)] == pytest.approx(np.radians([5, 0, -3]))
    assert [truth[f"tool_{axis}_m"] for axis in "xyz"] == pytest.approx([1e-3, 2e-3, 3e-3])
    assert [truth[f"base_{axis}_m"] for axis in "xyz"] == pytest.approx([4e-3, 5e-3, 6e-3])
    assert truth["sensor_1_gain"] == pytest.approx(10 / 8)
    simulator["camera_errors"] = {"front": {"translation_mm": [1, 0, 0]}}
    shaken = truth_of(runs.open(archive(tmp_path, "shaken", rig_yaml=yaml.safe_dump(rig))))
    assert "base_x_m" not in shaken
    assert shaken["a1_per_n"] == truth["a1_per_n"]


@pytest.mark.parametrize(
    ("prior", "said"),
    [
        ("law=1e300+-1e300", "a1_per_n found 1e+300 expected a mean from 1e-06 to 10 1/N"),
        ("law=0.01+-1e300", "a1_per_n found +-1e+300 expected a deviation from 1e-08 to 10 1/N"),
        ("rpe_per_bar=0.05+-1e-300", "rpe_per_bar found +-1e-300"),
    ],
)
@pytest.mark.parametrize("command", ["fit", "compare"])
def test_an_implausible_prior_is_refused(
    tmp_path: Path, prior: str, said: str, command: str, capsys: pytest.CaptureFixture[str]
) -> None:
    first, other = archive(tmp_path), archive(tmp_path, "other", frames=17, started_utc_ns=1)
    told = identify(capsys, command, first, other, "--free", "law,rpe_per_bar", "--prior", prior, status=2)
    assert said in told


@pytest.mark.parametrize(
    ("options", "said"),
    [
        (["compare", "--leave-out", "RUN"], "No such option: --leave-out"),
        (["--prior", "youngs_modulus_pa=3e5+-1e4"], "--prior youngs_modulus_pa: it has no effect on these runs"),
        (["--prior", "cap_mas_kg=0.05+-0.01"], "did you mean cap_mass_kg"),
        (["--prior", "law=1+-0"], "a positive deviation"),
        (["--prior", "law=1+-1", "--prior", "law=2+-1"], "law is given twice"),
    ],
)
def test_incompatible_options_are_refused(
    tmp_path: Path, options: list[str], said: str, capsys: pytest.CaptureFixture[str]
) -> None:
    path = str(archive(tmp_path))
    told = identify(capsys, *(path if word == "RUN" else word for word in options), path, status=2)
    assert said in told
