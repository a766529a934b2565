"""Every command has its Python counterpart, with the same options and the same defaults."""

from __future__ import annotations

import importlib
import inspect
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from enum import Enum
from typing import Any

import click
import pytest
import typer

from rig.cli.app import app

TERMINAL = {"json", "dry", "live", "host", "port"}
"""Options about the terminal or a page."""


@dataclass(frozen=True)
class Counterpart:
    """Where a command's work is done in Python: a function or class, as module:name.

    renamed: parameter for an option of another name. elsewhere: the function or attribute, as module:name, that has
    what an option asks for.
    """

    path: str
    renamed: Mapping[str, str] = field(default_factory=dict)
    elsewhere: Mapping[str, str] = field(default_factory=dict)


OPEN = {"rig": "rig:open"}
FILE = {"to": "pathlib:Path.write_text", "replace": "pathlib:Path.write_text"}
OUTPUT = dict.fromkeys(("to", "replace", "note"), "rig.calibrate.file_sections:OutputFile")
RUNS = {"archives": "runs"}

COUNTERPARTS = {
    "run": Counterpart(
        "rig.session.session:Session.run",
        {"no_report": "report"},
        OPEN,
    ),
    "check": Counterpart("rig.session.session:Session.check", elsewhere=OPEN),
    "simulate": Counterpart("rig.session.session:Session.simulate", elsewhere=OPEN),
    "study": Counterpart("rig.session.session:Session.study", elsewhere=OPEN),
    "protocols": Counterpart("protocols:named"),
    "doctor": Counterpart("rig.doctor:examine", {"rig": "config", "out": "folder"}),
    "vent": Counterpart(
        "rig.hardware.vent:vent", {"rig": "config"}, {"everything": "rig.hardware.running:signal_runs"}
    ),
    "live": Counterpart("rig.live.launch:show"),
    "note": Counterpart("runs.annotations:add_note", {"archive": "run"}),
    "tag": Counterpart("runs.annotations:add_tags", {"archive": "run"}, {"remove": "runs.annotations:remove_tags"}),
    "runs": Counterpart("runs.catalogue:search", elsewhere={"folder": "runs.catalogue:catalogue"}),
    "show": Counterpart("runs:open", {"archive": "name"}),
    "export": Counterpart("runs.export.exporters:export", {"format_": "to", "out": "folder"}, {"force": "runs:open"}),
    "recover": Counterpart("runs.recovery:recover"),
    "report": Counterpart(
        "runs.report.figure_export:write",
        {"format_": "kind", "out": "folder"},
        {"figures": "runs.report.page:write", "to": "runs.report.page:write", "force": "runs:open"},
    ),
    "publish": Counterpart(
        "rig.publish.description:describe",
        RUNS | {"creator": "creators"},
        {
            "to": "rig.publish.crate:write",
            "replace": "rig.publish.crate:write",
        },
    ),
    "replay": Counterpart(
        "rig.experiment.replay:replay",
        {"archive": "run", "model": "variant", "calibration": "calibrations", "out": "folder"},
    ),
    "import": Counterpart(
        "rig.importing.archive_builder:import_table", {"mapping": "mapping_file", "out": "folder", "note": "notes"}
    ),
    "reproduce": Counterpart(
        "rig.reproduce.all_results:results",
        {"what": "items", "runs": "folder"},
        {"out": "rig.reproduce.page:write", "replace": "rig.reproduce.page:write"},
    ),
    "workspace": Counterpart("rig.tip_planning.workspace:workspace", {"rig": "config", "model": "variant"}, FILE),
    "board": Counterpart(
        "rig.calibrate.board_drawing:write",
        {"rig": "name", "to": "path"},
        {"replace": "runs.overwriting:refuse_existing"},
    ),
    "init": Counterpart("rig.cli.rigs:commented", {"like": "text"}, FILE),
    "drivers": Counterpart("rig.hardware.installed_drivers:installed_drivers"),
    "test-driver": Counterpart(
        "rig.conformance.runner:results",
        {"rig": "config"},
        {"supply_off": "rig.conformance.runner:results"},  # a question at the terminal
    ),
    "design": Counterpart(
        "rig.design.design:design",
        {"rig": "config", "errors_of": "errors"},
        FILE,
    ),
    "identify fit": Counterpart(
        "rig.identify:identify",
        RUNS | {"prior": "priors"},
        {
            "export": "calibration.identify.fitting.export:write",
            "to": "calibration.identify.presentation.parameters_document:write",
            "rig_file": "rig.identify.estimation:rig_with",
            "report": "calibration.identify.presentation.report:write",
            "replace": "pathlib:Path.write_text",
        },
    ),
    "identify compare": Counterpart("rig.identify:compare", RUNS | {"prior": "priors"}),
    "calibrate dlt": Counterpart("rig.calibrate.dlt:DLTCalibrationRequest", {"calibration": "calibrations"}, OUTPUT),
    "calibrate camera": Counterpart("rig.calibrate.camera:CameraCalibrationRequest", elsewhere=OUTPUT),
    "calibrate tool": Counterpart("rig.calibrate.tool:ToolCalibrationRequest", elsewhere=OUTPUT),
    "calibrate pressure": Counterpart("rig.calibrate.pressure:PressureCalibrationRequest", elsewhere=OUTPUT),
}


def commands() -> Iterator[tuple[str, click.Command]]:
    def below(command: Any, words: tuple[str, ...]) -> Iterator[tuple[str, click.Command]]:
        if not hasattr(command, "commands"):
            yield " ".join(words), command
            return
        for name, child in command.commands.items():
            yield from below(child, (*words, name))

    return below(typer.main.get_command(app), ())


def found(path: str) -> Any:
    module, _, name = path.partition(":")
    value: Any = importlib.import_module(module)
    for part in name.split("."):
        value = getattr(value, part)
    return value


def plain(value: Any) -> Any:
    """A default without its form: nothing given is the empty tuple, a path its text."""
    if value is None or value == "" or value in ((), [], {}) or value is inspect.Parameter.empty:
        return ()
    return str(getattr(value, "value", value)) if isinstance(value, Enum) or hasattr(value, "parts") else value


@pytest.mark.parametrize(("name", "command"), list(commands()), ids=lambda value: value if type(value) is str else "")
def test_a_command_has_a_function_with_its_options_and_defaults(name: str, command: click.Command) -> None:
    counterpart = COUNTERPARTS[name]
    parameters = inspect.signature(found(counterpart.path)).parameters
    for option in command.params:
        assert option.name is not None
        if option.name in TERMINAL:
            continue
        if option.name in counterpart.elsewhere:
            assert callable(found(counterpart.elsewhere[option.name]))
            continue
        own = counterpart.renamed.get(option.name, option.name)
        assert own in parameters, f"rig {name} --{option.name} has no counterpart in {counterpart.path}"
        default = parameters[own].default
        if option.name.startswith("no_"):
            default = not default
        if isinstance(option, click.Argument) or default is inspect.Parameter.empty:
            continue
        assert plain(default) == plain(option.default), f"rig {name} --{option.name}: {option.default!r}, {default!r}"


def test_there_is_no_counterpart_without_a_command() -> None:
    assert set(COUNTERPARTS) == {name for name, _ in commands()}
