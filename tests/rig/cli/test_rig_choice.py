"""Which rig a command uses, what `rig vent` does without one, and the file that `rig init` writes."""

from __future__ import annotations

import json
import os
import subprocess
from collections.abc import Iterator
from pathlib import Path

import pytest
import yaml

import rig.cli.vent
import rig.hardware.vent
import runs
from rig.cli.rigs import EXPLAINED, commented
from rig.config import loader
from rig.config.loader import Source, chosen_rig, named_rig
from rig.config.schema import RigConfig
from rig.hardware import runtime_folder
from rig.hardware.lock import cards_locked
from rig.hardware.running import FOLDER
from rig.hardware.vent import VentResult
from rig.simulator.registers import Registers
from tests.support.command_line import status_of

BRIEF = "title: Brief\nsteps:\n  - ramp: {actuators: [1], to_bar: 0.1, duration_s: 0.3}\n"


@pytest.fixture(autouse=True)
def here(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """An empty folder to stand in, no variable, no running experiment."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.delenv("SOFTRIG_RIG", raising=False)
    (tmp_path / "shared").mkdir(mode=0o700)
    monkeypatch.setattr(runtime_folder, "BASE", tmp_path / "shared")
    return tmp_path


def write_rig(file: str, name: str) -> None:
    Path(file).write_text(loader.text("mock").replace("name: mock\n", f"name: {name}\n"))


def test_the_rig_comes_from_the_option_the_variable_the_folder_and_then_the_default(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    assert named_rig(None) is None
    assert chosen_rig(None) == loader.RigChoice("mock", Source.DEFAULT)
    write_rig("softrig.yaml", "folder")
    assert chosen_rig(None) == loader.RigChoice("softrig.yaml", Source.FOLDER)
    monkeypatch.setenv("SOFTRIG_RIG", "mock-stereo")
    assert chosen_rig(None) == loader.RigChoice("mock-stereo", Source.ENVIRONMENT)
    assert chosen_rig("pci1716") == loader.RigChoice("pci1716", Source.OPTION)
    monkeypatch.setenv("SOFTRIG_RIG", "")
    assert chosen_rig(None).source is Source.FOLDER


@pytest.mark.parametrize("source", [Source.ENVIRONMENT, Source.FOLDER, Source.DEFAULT])
def test_screen_and_record_state_what_chose_the_rig(
    source: Source, here: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    if source is Source.ENVIRONMENT:
        write_rig("bench.yaml", "chosen")
        monkeypatch.setenv("SOFTRIG_RIG", "bench.yaml")
    elif source is Source.FOLDER:
        write_rig("softrig.yaml", "chosen")
    (here / "brief.yaml").write_text(BRIEF)
    assert status_of("run", "brief.yaml", "--fast", "--yes", "--no-report") == 0
    assert f"chosen by {source}" in capsys.readouterr().out
    (archive,) = Path("data").glob("*.h5")
    run = runs.open(archive)
    assert run.header.rig_name == ("mock" if source is Source.DEFAULT else "chosen")
    said = [event.message for event in run.events if "chosen by" in event.message]
    assert len(said) == (0 if source is Source.DEFAULT else 1)
    assert all(str(source) in line and str(here) in line for line in said)


@pytest.mark.parametrize(
    "arguments",
    [
        ("check", "ramp-a"),
        ("run", "ramp-a", "--fast", "--yes"),
        ("simulate", "ramp-a"),
        ("doctor",),
        ("calibrate", "tool", "--capture"),
        ("calibrate", "pressure", "--fast", "--yes"),
        ("calibrate", "camera", "--capture", "--corners", "6x5", "--square-mm", "8"),
    ],
    ids=" ".join,
)
def test_an_unreadable_rig_of_folder_or_variable_is_not_replaced_by_the_mock(
    arguments: tuple[str, ...], monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    Path("softrig.yaml").symlink_to("gone.yaml")
    assert status_of(*arguments) == 2
    assert "softrig.yaml" in capsys.readouterr().err
    monkeypatch.setenv("SOFTRIG_RIG", "mook")
    assert status_of(*arguments) == 2
    said = capsys.readouterr().err
    assert "mook: chosen by SOFTRIG_RIG" in said
    assert "did you mean mock or mock-3?" in said


@pytest.mark.parametrize("source", ["variable", "folder"])
@pytest.mark.parametrize(
    ("content", "reason"),
    [
        (None, "this is a folder, not a file"),
        (b"", "the file is empty"),
        (b"\xff\xfea", "the file is UTF-16; save it as UTF-8"),
        (b"cards: [1\n", "a ',' or the closing ']' here"),
    ],
    ids=["folder", "empty", "UTF-16", "syntax"],
)
def test_a_rig_file_that_cannot_be_read_is_reported_with_what_chose_it(
    content: bytes | None, reason: str, source: str, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    file = Path("bench.yaml" if source == "variable" else "softrig.yaml")
    if content is None:
        file.mkdir()
    else:
        file.write_bytes(content)
    why = "chosen because neither --rig nor SOFTRIG_RIG names a rig"
    if source == "variable":
        monkeypatch.setenv("SOFTRIG_RIG", str(file))
        why = "chosen by SOFTRIG_RIG"
    for arguments in (("check", "ramp-a"), ("board",)):
        assert status_of(*arguments) == 2
        said = capsys.readouterr().err
        assert why in said.splitlines()[0]
        assert reason in said
    assert status_of("vent") == 1
    said = capsys.readouterr().err
    assert said.startswith("NOT vented: ")
    assert reason in said
    assert f"rig chosen by {'SOFTRIG_RIG' if source == 'variable' else 'softrig.yaml in this folder'}" in said


def test_vent_without_a_rig_and_without_a_run_vents_nothing_and_returns_2(
    capsys: pytest.CaptureFixture[str],
) -> None:
    assert status_of("vent") == 2
    said = capsys.readouterr()
    assert "nothing to vent" in said.err
    assert said.out == ""


@pytest.mark.parametrize("arguments", [("vent",), ("vent", "--rig", "softrig.yaml")])
def test_vent_of_a_simulated_rig_that_has_never_run_says_so_and_returns_2(
    arguments: tuple[str, ...], capsys: pytest.CaptureFixture[str]
) -> None:
    write_rig("softrig.yaml", "folder")
    assert status_of(*arguments) == 2
    said = capsys.readouterr()
    assert "nothing to vent: the simulated rig folder" in said.err
    assert "does not run" in said.err
    assert said.out == ""


@pytest.fixture
def two_cards() -> Iterator[list[tuple[RigConfig, Registers]]]:
    made = []
    for number in (1, 2):
        text = loader.text("mock").replace("name: mock\n", f"name: bench{number}\n")
        device = f"chosen-{os.getpid()}-{number}"
        registers = Registers.create(device, 2, 8)
        registers.outputs["value"] = 7.0
        made.append((loader.parse(text.replace("device: mock0", f"device: {device}"), "rig.yaml"), registers))
    yield made
    for _, registers in made:
        registers.close()


def test_vent_without_a_rig_vents_only_the_running_ones(
    two_cards: list[tuple[RigConfig, Registers]],
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    (running, first), (_, second) = two_cards
    monkeypatch.setattr(rig.hardware.vent.os, "kill", lambda pid, number: None)
    with cards_locked(running, "protocol ramp-a"):
        assert status_of("vent") == 0
    said = capsys.readouterr().out
    assert "every chamber of rig bench1 is open to the exhaust" in said
    assert "protocol ramp-a" in said
    assert first.outputs["value"].tolist() == [0.0, 0.0]
    assert second.outputs["value"].tolist() == [7.0, 7.0]


def test_vent_without_a_rig_vents_every_rig_that_runs(
    two_cards: list[tuple[RigConfig, Registers]],
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    (one, first), (other, second) = two_cards
    first.outputs["value"] = 7.0
    monkeypatch.setattr(rig.hardware.vent.os, "kill", lambda pid, number: None)
    with cards_locked(one, "protocol ramp-a"), cards_locked(other, "protocol sine-1"):
        assert status_of("vent") == 0
    said = capsys.readouterr().out
    assert "every chamber of rig bench1 is open to the exhaust" in said
    assert "every chamber of rig bench2 is open to the exhaust" in said
    assert first.outputs["value"].tolist() == [0.0, 0.0]
    assert second.outputs["value"].tolist() == [0.0, 0.0]


def test_an_unreadable_record_of_an_ended_run_is_listed_until_the_operator_removes_it(
    capsys: pytest.CaptureFixture[str],
) -> None:
    with subprocess.Popen(["true"]) as ended:
        pass
    file = runtime_folder.subfolder(FOLDER) / f"{ended.pid}-1-0.json"
    file.write_text("{")
    for _ in range(2):
        assert status_of("vent") == 1
        said = capsys.readouterr().err
        assert "NOT vented" in said
        assert f"then remove {file}" in said
    file.unlink()
    assert status_of("vent") == 2


def test_vent_does_not_claim_what_a_card_without_read_back_cannot_show(
    two_cards: list[tuple[RigConfig, Registers]],
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    (running, _), _ = two_cards
    monkeypatch.setattr(rig.cli.vent, "results", lambda rigs: [VentResult(("daq",)) for _ in rigs])
    with cards_locked(running, "protocol ramp-a"):
        assert status_of("vent") == 0
    said = capsys.readouterr().out
    assert "was commanded to vent; card daq has no read-back: look at the gauge" in said
    assert "open to the exhaust" not in said


def test_a_running_rig_that_cannot_be_vented_does_not_stop_the_venting_of_others(
    two_cards: list[tuple[RigConfig, Registers]],
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    (one, broken), (other, registers) = two_cards
    monkeypatch.setattr(rig.hardware.vent.os, "kill", lambda pid, number: None)
    broken.faults.inject(failing_writes=2**40)
    with cards_locked(one, "one"), cards_locked(other, "other"):
        assert status_of("vent") == 1
    assert registers.outputs["value"].tolist() == [0.0, 0.0]
    said = capsys.readouterr()
    assert "rig bench1 (it was held by process" in said.err
    assert "every chamber of rig bench2 is open to the exhaust" in said.out


@pytest.mark.parametrize("like", loader.named())
def test_init_writes_a_rig_file_with_a_comment_on_every_section(like: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert status_of("init", "--like", like) == 0
    text = Path("softrig.yaml").read_text()
    assert loader.load("softrig.yaml") == loader.load(like)
    sections = yaml.safe_load(text)
    assert sections.keys() <= EXPLAINED.keys()
    lines = text.splitlines()
    for section in sections:
        at = next(i for i, line in enumerate(lines) if line.startswith(f"{section}:"))
        assert lines[at - 1].startswith("# "), section
    assert max(map(len, lines)) <= 120
    capsys.readouterr()
    assert status_of("check", "ramp-a", "--json") == 0
    assert json.loads(capsys.readouterr().out)["rig_source"] == str(Source.FOLDER)


@pytest.mark.parametrize(
    ("to", "said"), [("softrig.yaml", "every later rig command in this folder uses it"), ("b.yaml", "--rig b.yaml")]
)
def test_init_says_which_commands_use_its_file(to: str, said: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert status_of("init", "--to", to) == 0
    assert said in capsys.readouterr().out


def test_init_explains_every_section_that_a_rig_can_have() -> None:
    assert EXPLAINED.keys() == RigConfig.model_fields.keys()
    assert "docs/schemas" not in commented(loader.text("mock"))


@pytest.mark.parametrize("kind", ["file", "broken link"])
def test_init_overwrites_nothing_without_consent(kind: str, capsys: pytest.CaptureFixture[str]) -> None:
    if kind == "file":
        Path("softrig.yaml").write_text("mine")
    else:
        Path("softrig.yaml").symlink_to("elsewhere")
    assert status_of("init") == 2
    said = capsys.readouterr().err
    assert "softrig.yaml exists" in said
    assert "--replace" in said
    assert not Path("elsewhere").exists()
    if kind == "file":
        assert Path("softrig.yaml").read_text() == "mine"
        assert status_of("init", "--replace") == 0
        assert loader.load("softrig.yaml").name == "mock"
