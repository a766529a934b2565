"""Wrong arguments from Python are refused in one sentence before anything starts, as wrong options of a command are."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import rig
import runs
from protocols import BadInputError
from rig.config import loader
from rig.importing import import_table
from runs.annotations import AnnotationError, add_note, add_tags
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
