"""Wrong arguments from Python are refused in one sentence before anything starts, as wrong options of a command are."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import protocols
import rig
import runs
import tests.support.synthetic_runs as made_up
from protocols import BadInputError
from rig.calibrate import board_drawing
from rig.config import loader
from rig.design.design import design
from rig.design.expected_poses import errors_of_run
from rig.doctor import examine
from rig.experiment.replay import replay
from rig.identify import compare, identify
from rig.importing import import_table
from rig.publish import crate
from rig.publish.description import describe
from rig.tip_planning.workspace import workspace
from runs.annotations import AnnotationError, add_note, add_tags
from runs.archive.checked import ArchiveError
from runs.archive.writer import finalise
from runs.run import Run
from tests.support.command_line import status_of

PROTOCOL = """\
title: One step
parameters:
  peak_bar: {default: 0.1, unit: bar, lowest: 0, highest: 0.3}
steps:
  - ramp: {actuators: [1], to_bar: peak_bar, duration_s: 0.2}
"""


@pytest.fixture
def protocol(tmp_path: Path) -> Path:
    path = tmp_path / "step.yaml"
    path.write_text(PROTOCOL)
    return path


def refusal(protocol: Path, **arguments: Any) -> str:
    """The message about the arguments of a run; nothing is written."""
    out = protocol.parent / "none"
    with rig.open("mock") as bench, pytest.raises(BadInputError) as wrong:
        bench.run(protocol, **{"fast": True, "out": out, **arguments})
    assert not out.exists()
    return str(wrong.value)


def test_metadata_from_python_may_be_numbers_and_reach_the_archive(protocol: Path, tmp_path: Path) -> None:
    meta = {"mass_g": 3.5, "batch": np.int64(7), "specimen": "A7"}
    with rig.open("mock") as bench:
        run = bench.run(protocol, fast=True, seed=np.int64(2), out=tmp_path, report=False, meta=meta)
    again = runs.open(run.path).header
    assert again.metadata == {"mass_g": "3.5", "batch": "7", "specimen": "A7"}
    assert again.seed == 2


@pytest.mark.parametrize("value", [None, True, float("nan"), [1], {"a": 1}, b"x", "", "a\0b", "a\ud800b", 10**400])
def test_metadata_that_cannot_be_stored_are_refused(protocol: Path, value: object) -> None:
    message = refusal(protocol, meta={"mass_g": value})
    assert "--meta" in message
    assert "mass_g=" in message
    assert "expected  a finite number, or text without NUL and lone surrogates, not empty" in message


@pytest.mark.parametrize(("meta", "expected"), [(["a"], "a mapping from names to values"), ({3: "x"}, "a name of")])
def test_metadata_of_another_form_are_refused(protocol: Path, meta: object, expected: str) -> None:
    assert expected in refusal(protocol, meta=meta)


@pytest.mark.parametrize("value", [3, None, b"x", "a\0b", "a\ud800b"])
@pytest.mark.parametrize("argument", ["operator", "note"])
def test_operator_and_note_that_cannot_be_stored_are_refused(protocol: Path, argument: str, value: object) -> None:
    message = refusal(protocol, **{argument: value})
    assert f"--{argument}" in message
    assert "expected  text without NUL and lone surrogates" in message


def test_a_study_refuses_what_its_runs_cannot_store(protocol: Path, tmp_path: Path) -> None:
    plan = tmp_path / "plan.yaml"
    plan.write_text("title: Two\nprotocol: step.yaml\nfactors: {peak_bar: [0.1, 0.2]}\n")
    with rig.open("mock") as bench:
        for wrong in ({"operator": 3}, {"meta": {"a": None}}, {"meta": [1]}):
            with pytest.raises(BadInputError, match=r"--operator|--meta"):
                bench.study(plan, fast=True, out=tmp_path / "none", **wrong)  # type: ignore[arg-type]
    assert not (tmp_path / "none").exists()


def test_an_import_refuses_an_operator_that_cannot_be_stored(tmp_path: Path) -> None:
    with pytest.raises(BadInputError, match="--operator"):
        import_table(tmp_path / "a.csv", tmp_path / "a.yaml", tmp_path / "none", operator=3)  # type: ignore[arg-type]


@pytest.mark.parametrize("text", [3, None, "a\0b", "a\ud800b"])
def test_a_note_that_cannot_be_stored_is_refused(text: Any) -> None:
    with pytest.raises(AnnotationError, match="expected a note"):
        add_note("last", text)


@pytest.mark.parametrize("tags", [3, None, [3], [["a"]], ["a\0b"]])
def test_tags_that_are_no_words_are_refused(tags: Any) -> None:
    with pytest.raises(AnnotationError, match="expected a "):
        add_tags("last", tags)


def test_check_names_the_metadata_that_run_will_refuse_to_be_without(
    protocol: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    bench = tmp_path / "bench.yaml"
    required = "metadata:\n  required: [specimen, batch, site]\n  values: {site: Lab 2}\n"
    bench.write_text(loader.text("mock") + required)
    assert status_of("check", protocol, "--rig", bench) == 0
    shown = " ".join(capsys.readouterr().out.split())
    assert shown.endswith("rig run needs --meta specimen=VALUE --meta batch=VALUE")
    assert status_of("check", protocol, "--rig", bench, "--json") == 0
    assert json.loads(capsys.readouterr().out)["missing_metadata"] == ["specimen", "batch"]
    assert status_of("run", protocol, "--rig", bench, "--fast", "--yes", "--out", tmp_path / "none") == 2
    assert not (tmp_path / "none").exists()


@pytest.mark.parametrize(
    ("arguments", "expected"),
    [
        ({"seed": "a"}, "an integer of at least 0"),
        ({"seed": -1}, "an integer of at least 0"),
        ({"seed": 1.5}, "an integer of at least 0"),
        ({"seed": 2**70}, "an integer from 0 to 9223372036854775807"),
        ({"settings": {"peak_bar": "a"}}, "a number"),
        ({"settings": [1]}, "a mapping from names of parameters to numbers"),
        ({"model": 3}, "one of homogeneous"),
        ({"model": ["a"]}, "one of homogeneous"),
        ({"parameters": 3}, "a path"),
        ({"adapt": 3}, "True or False"),
        ({"adapt": True, "free": "law"}, "a list of names"),
        ({"adapt": True, "free": [3]}, "a list of names"),
        ({"fast": "no"}, "True or False"),
        ({"yes": "no"}, "True or False"),
        ({"report": None}, "True or False"),
        ({"answer": 3}, "a function, such as answer=input"),
        ({"out": 3}, "a path"),
        ({"out": "a\0b"}, "a path"),
        ({"out": "\ud800"}, "a path"),
        ({"out": ""}, "a path"),
        ({"out": "x" * 300}, "a folder: File name too long"),
    ],
)
def test_options_of_a_run_that_cannot_be_are_refused(
    protocol: Path, arguments: dict[str, object], expected: str
) -> None:
    message = refusal(protocol, **arguments)
    assert expected in message
    assert message.count("expected") == 1


def test_a_file_in_place_of_the_folder_of_a_run_is_named(protocol: Path) -> None:
    assert f"a folder; {protocol} is a file" in refusal(protocol, out=protocol)
    assert f"a folder; {protocol} is a file" in refusal(protocol, out=protocol / "below")


def test_a_folder_without_permission_is_named(protocol: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("os.access", lambda place, mode: Path(place) != tmp_path)  # root may write everywhere
    message = refusal(protocol, out=tmp_path / "new" / "data")
    assert f"a folder in which you may write; {tmp_path} is not one" in message


def test_wrong_arguments_of_a_simulation_and_a_study_are_refused(protocol: Path, tmp_path: Path) -> None:
    plan = tmp_path / "plan.yaml"
    plan.write_text("title: Two\nprotocol: step.yaml\nfactors: {peak_bar: [0.1, 0.2]}\n")
    wrong: list[dict[str, Any]] = [
        {"plan": 3}, {"plan": tmp_path}, {"plan": "none.yaml"}, {"out": plan}, {"workers": "a"}, {"workers": 0},
        {"scheduler": 3}, {"fast": "yes"}, {"answer": 3},
    ]  # fmt: skip
    with rig.open("mock") as bench:
        for arguments in wrong:
            with pytest.raises(BadInputError):
                bench.study(**{"plan": plan, "fast": True, "out": tmp_path / "none", **arguments})
        for arguments in ({"out": plan}, {"out": 3}, {"model": 3}, {"parameters": 3}):
            with pytest.raises(BadInputError):
                bench.simulate(protocol, **arguments)
    assert not (tmp_path / "none").exists()


@pytest.mark.parametrize("name", [3, None, b"x", ["a"], "", "\udc80", "a\0b", "x" * 300])
def test_what_names_no_run_is_refused(name: Any) -> None:
    with pytest.raises(ArchiveError):
        runs.open(name)
    with pytest.raises(ArchiveError):
        identify([name])


@pytest.mark.parametrize("listed", ["last", 3, None])
def test_what_is_no_list_of_runs_is_refused(listed: Any) -> None:
    with pytest.raises(ArchiveError, match="expected a list of runs"):
        identify(listed)
    with pytest.raises(ArchiveError, match="expected a list of runs"):
        compare(listed)


@pytest.mark.parametrize(
    ("arguments", "expected"),
    [
        ({}, "needs at least one run"),
        ({"free": "law"}, "a list of names"),
        ({"per_run": [3]}, "a list of names"),
        ({"priors": [1]}, "a mapping from names"),
        ({"priors": {"youngs_modulus_pa": 3}}, "a mapping from names"),
    ],
)
def test_wrong_arguments_of_an_identification_are_refused(arguments: dict[str, Any], expected: str) -> None:
    with pytest.raises(BadInputError, match=expected):
        identify([], **arguments)


def test_wrong_arguments_of_a_design_are_refused() -> None:
    config = rig.open("mock").config
    wrong: list[dict[str, Any]] = [
        {"config": "mock"}, {"free": "law"}, {"free": [3]}, {"duration_s": "a"}, {"duration_s": float("nan")},
        {"criterion": 3}, {"criterion": ["d"]}, {"seed": -1}, {"seed": "a"}, {"errors": 3}, {"errors": []},
    ]  # fmt: skip
    for arguments in wrong:
        with pytest.raises(BadInputError):
            design(**{"config": config, **arguments})
    for no_steps in (3, None, "x", [3]):
        with pytest.raises(BadInputError, match="a list of mappings"):
            protocols.from_steps("title", no_steps)  # type: ignore[arg-type]
    for no_config in (3, "mock", None):
        with pytest.raises(BadInputError, match="the configuration of a rig"):
            workspace(no_config)  # type: ignore[arg-type]
    for no_run in (3, "last", None):
        with pytest.raises(BadInputError, match="an archive"):
            errors_of_run(no_run)  # type: ignore[arg-type]


@pytest.mark.parametrize("function", [identify, compare])
@pytest.mark.parametrize("flag", ["x", 1, None])
def test_a_flag_of_an_identification_is_true_or_false(function: Callable[..., object], flag: Any) -> None:
    with pytest.raises(BadInputError, match=r"(?s)--quasi-static.*True or False"):
        function([], quasi_static=flag)


@pytest.mark.parametrize(
    ("arguments", "expected"),
    [
        ({"every": 0}, "--every"),
        ({"split_s": "x"}, "--split-s"),
        ({"noise": 3}, "--noise"),
        ({"start": 3}, "--start"),
    ],
)
def test_options_of_an_identification_come_before_its_runs(arguments: dict[str, Any], expected: str) -> None:
    with pytest.raises(BadInputError, match=expected):
        identify(["no-such-run"], **arguments)


@pytest.mark.parametrize("wrong", [3, None, [3]])
def test_what_is_no_archive_is_not_published_or_replayed(wrong: Any, tmp_path: Path) -> None:
    with pytest.raises(BadInputError, match="a list of archives"):
        describe(wrong)
    with pytest.raises(BadInputError, match="a list of archives"):
        crate.write(wrong, wrong, tmp_path / "crate.zip")
    with pytest.raises(BadInputError, match="an archive, as"):
        replay(wrong)


@pytest.mark.parametrize("wrong", [3, None, ["x"]])
def test_what_is_no_path_no_board_and_no_rig_is_refused(wrong: Any, tmp_path: Path) -> None:
    with pytest.raises(BadInputError, match="a path"):
        import_table(wrong, tmp_path / "mapping.yaml")
    with pytest.raises(BadInputError, match="a path"):
        import_table(tmp_path / "table.csv", wrong)
    with pytest.raises(BadInputError, match="a path"):
        examine(wrong)
    with pytest.raises(BadInputError, match="the configuration of a rig"):
        examine(tmp_path, wrong or "mock")
    with pytest.raises(BadInputError, match="the board of a rig"):
        board_drawing.write(wrong, "mock", tmp_path / "board.pdf")


@pytest.mark.parametrize("group", ["none", 3, None, "../x"])
def test_a_group_that_a_run_has_not_is_refused_with_those_that_it_has(tmp_path: Path, group: Any) -> None:
    pytest.importorskip("h5netcdf")
    run = Run(finalise(made_up.write_journal(tmp_path / "one.mcap", 1.0).path))
    with pytest.raises(ArchiveError, match=r"has no group .*; it has .*pressure.*tip"):
        run.to_xarray(group)
