"""Options of all commands: one name has one meaning, and the reference lists it."""

from __future__ import annotations

import re
from collections import defaultdict
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
import typer

from rig.cli.app import app
from tests.support.command_line import status_of

REFERENCE = Path(__file__).parents[3] / "docs" / "reference" / "command-line.md"
_CLICK_OWN = {"--help", "--install-completion", "--show-completion"}


def options(command: Any, name: str = "rig") -> Iterator[tuple[str, Any]]:
    """Every option of a command and its sub-commands, with the name of the command."""
    for parameter in command.params:
        if parameter.param_type_name == "option" and not _CLICK_OWN & set(parameter.opts):
            yield name, parameter
    for part, below in getattr(command, "commands", {}).items():
        yield from options(below, f"{name} {part}")


def meanings() -> dict[str, dict[tuple[object, ...], list[str]]]:
    """The commands of every option by its name, and by what it means there."""
    found: dict[str, dict[tuple[object, ...], list[str]]] = defaultdict(lambda: defaultdict(list))
    for command, option in options(typer.main.get_command(app)):
        meaning = (
            option.help,
            str(option.type_descriptor.annotation),
            option.min,
            option.is_flag,
            option.multiple,
            option.metavar,
        )
        for name in (*option.opts, *option.secondary_opts):
            found[name][meaning].append(command)
    return found


def documented() -> dict[str, tuple[set[str], str]]:
    """The commands and the meaning of every option in the table of the reference."""
    _, _, section = REFERENCE.read_text().partition("## Options\n")
    rows = re.findall(
        r"^\| `(--[a-z-]+)(?:\\\||[^|])*\| (.*?) \| (.*?) \|$", section.partition("\n## ")[0], re.MULTILINE
    )
    return {name: (set(re.findall(r"`(.*?)`", commands)), meaning) for name, meaning, commands in rows}


@pytest.mark.parametrize("name", sorted(meanings()))
def test_an_option_means_the_same_in_every_command(name: str) -> None:
    assert len(meanings()[name]) == 1, dict(meanings()[name])


def test_every_option_is_documented_with_its_commands() -> None:
    table = documented()
    for name, by_meaning in meanings().items():
        ((_, commands),) = by_meaning.items()
        if name.startswith("--no-") and f"--{name.removeprefix('--no-')}" in meanings():
            continue  # the row of the switch names both
        assert name in table, name
        assert table[name][0] == {command.removeprefix("rig").strip() or "rig" for command in commands}, name
    assert set(table) <= set(meanings())


def commands(command: Any, *names: str) -> Iterator[tuple[str, ...]]:
    """A command and all its sub-commands, each as the words that call it."""
    yield names
    for name, below in getattr(command, "commands", {}).items():
        yield from commands(below, *names, name)


@pytest.mark.parametrize("columns", [80, 120])
def test_help_fits_the_terminal_and_cuts_no_sentence_off(
    columns: int, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setenv("COLUMNS", str(columns))
    texts = []
    for arguments in commands(typer.main.get_command(app)):
        with pytest.raises(SystemExit):
            app([*arguments, "--help"], prog_name="rig")
        shown = capsys.readouterr().out
        texts.append(" ".join(shown.split()))
        assert max(map(len, shown.splitlines())) <= columns, shown
        assert "..." not in shown.partition("\n\n")[2]
    assert "against a rig, without touching hardware." in texts[0]


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["run", "ramp-a", "--seed", "-1"], "'--seed': found -1, expected at least 0"),
        (["run", "ramp-a", "--seed", "0.5"], "'--seed': found 0.5, expected a whole number"),
        (["run", "ramp-a", "--port", "65536"], "'--port': found 65536, expected at most 65535"),
        (["reproduce", "table99"], "'what': 'table99' is not one of 'modulus'"),
        (["identify", "last", "--every", "0"], "'--every': found 0, expected at least 1"),
        (["identify", "last", "--split-s", "nan"], "'--split-s': found nan, expected at least 0\n"),
        (["design", "--duration-s", "much"], "'--duration-s': found much, expected a number"),
    ],
)
def test_an_invalid_value_is_shown_with_what_was_expected(
    arguments: list[str], said: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert status_of(*arguments) == 2
    assert said in capsys.readouterr().err
