"""The table of all options of `rig`, which the documentation takes from their declarations."""

from __future__ import annotations

from collections.abc import Iterator
from html import escape
from typing import Any

import typer

from rig.cli.app import app

_OF_THE_LIBRARY = {"--help", "--install-completion", "--show-completion"}


def options(command: Any, name: str = "rig") -> Iterator[tuple[str, Any]]:
    """Every option of a command and of those below it, with the name of the command."""
    for parameter in command.params:
        if parameter.param_type_name == "option" and not _OF_THE_LIBRARY & set(parameter.opts):
            yield name, parameter
    for part, below in getattr(command, "commands", {}).items():
        yield from options(below, f"{name} {part}")


def rows() -> list[tuple[str, str, list[str]]]:
    """Names, meaning and commands of each option, by its name."""
    found: dict[str, tuple[str, list[str]]] = {}
    for command, option in options(typer.main.get_command(app)):
        value = "" if option.is_flag or not option.metavar else f" {option.metavar}"
        names = ", ".join((*option.opts, *option.secondary_opts)) + value
        _, commands = found.setdefault(names, (option.help or "", []))
        commands.append(command.removeprefix("rig").strip() or "rig")
    return [(names, *found[names]) for names in sorted(found)]


def display(source: str, *_: Any, **__: Any) -> str:
    """The HTML of a fence `rig-options`, whatever stands in it."""
    cells = [(f"<code>{escape(names)}</code>", escape(text), escape(", ".join(those))) for names, text, those in rows()]
    lines = [f"<tr><td>{'</td><td>'.join(row)}</td></tr>" for row in cells]
    head = "<tr><th>option</th><th>meaning</th><th>commands</th></tr>"
    return f"<table><thead>{head}</thead><tbody>{''.join(lines)}</tbody></table>"
