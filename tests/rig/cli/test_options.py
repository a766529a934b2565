"""Options of all commands: one name has one meaning, and the table of the documentation lists it."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterator
from typing import Any

import pytest
import typer

from rig.cli.app import app
from scripts.option_table import display, options, rows
from tests.support.command_line import status_of


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


@pytest.mark.parametrize("name", sorted(meanings()))
def test_an_option_means_the_same_in_every_command(name: str) -> None:
    assert len(meanings()[name]) == 1, dict(meanings()[name])


def test_the_table_of_the_documentation_has_every_option_with_its_meaning_and_commands() -> None:
    table = {name.strip(","): (meaning, commands) for names, meaning, commands in rows() for name in names.split()}
    for name, by_meaning in meanings().items():
        (((meaning, *_), commands),) = by_meaning.items()
        assert table[name] == (meaning, [command.removeprefix("rig").strip() or "rig" for command in commands]), name
        assert name in display("")


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
