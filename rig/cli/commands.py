"""Classes of commands: groups whose `--help` fits any terminal, and commands that load numerical libraries.

These libraries crash or hang without enough address space, so it is checked first.
"""

from __future__ import annotations

import re
import shutil
from collections.abc import Sequence
from typing import Any

import typer
from typer.core import TyperCommand

from rig.cli.exit_status import FAULT

try:
    import resource
except ImportError:  # Windows
    resource = None  # type: ignore[assignment]

LEAST_WIDTH, MOST_WIDTH = 30, 78
TEXT_SHARE = 0.6
"""Least share of the width for the explanations; a longer name has a line of its own."""

_Formatter: Any = typer.core.TyperGroup.context_class.formatter_class


class HelpFormatter(_Formatter):  # type: ignore[misc]
    """Fits the help to the terminal, also below the 50 columns that typer assumes."""

    def __init__(self, indent_increment: int = 2, width: int | None = None, max_width: int | None = None) -> None:
        columns = shutil.get_terminal_size().columns - 2
        super().__init__(indent_increment, width or max(LEAST_WIDTH, min(columns, MOST_WIDTH)), max_width)

    def write_dl(self, rows: Sequence[tuple[str, str]], col_max: int = 30, col_spacing: int = 2) -> None:
        """Write names and explanations."""
        rows = [(self._folded(name), text) for name, text in rows]
        super().write_dl(rows, min(col_max, int(self.width * (1 - TEXT_SHARE)) - 2), col_spacing)

    def _folded(self, name: str) -> str:
        """Return a name in lines that fit; the values of a choice may part after a bar."""
        lines = [""]
        for piece in re.findall(r"[^|]*\|?", name):
            if lines[-1] and self.current_indent + len(lines[-1] + piece) > self.width:
                lines.append(" " * self.indent_increment)
            lines[-1] += piece
        return f"\n{'':{self.current_indent}}".join(lines)


class HelpGroup(typer.core.TyperGroup):
    """A command group that lists its commands with whole sentences."""

    def format_commands(self, ctx: Any, formatter: Any) -> None:
        """Write the commands and the first sentence about each."""
        commands = [(name, self.get_command(ctx, name)) for name in self.list_commands(ctx)]
        rows = [(name, one.get_short_help_str(1000)) for name, one in commands if one is not None and not one.hidden]
        with formatter.section("Commands"):
            formatter.write_dl(rows)


class DefaultCommandGroup(HelpGroup):
    """A group that hands arguments to its first sub-command unless they name another one."""

    @property
    def default_command(self) -> Any:
        """The first sub-command."""
        return next(iter(self.commands.values()))

    def parse_args(self, ctx: Any, args: list[str]) -> list[str]:
        """Insert the default sub-command where none is named."""
        if args and args[0] not in self.commands and args[0] not in self.get_help_option_names(ctx):
            args = [self.default_command.name, *args]
        return super().parse_args(ctx, args)

    def shell_complete(self, ctx: Any, incomplete: str) -> list[Any]:
        """Complete sub-commands and options, and the arguments of the default sub-command."""
        found: list[Any] = super().shell_complete(ctx, incomplete)
        command = self.default_command
        within = command.make_context(command.name, [], parent=ctx, resilient_parsing=True)
        if incomplete.startswith("-"):
            return [*found, *command.shell_complete(within, incomplete)]
        arguments = (one for one in command.params if one.param_type_name == "argument")
        return found + [item for one in arguments for item in one.shell_complete(within, incomplete)]


def _address_space() -> int | None:
    """Bytes that a process may map; None without a limit."""
    if resource is None:
        return None
    limit = resource.getrlimit(resource.RLIMIT_AS)[0]
    return None if limit == resource.RLIM_INFINITY else limit


class NumericalCommand(TyperCommand):
    """A command whose largest process maps the rod model's compiler, linear algebra and vision."""

    needed_bytes = 1_200_000_000
    """Address space of the largest process; most of it is never resident."""

    def invoke(self, ctx: Any) -> Any:
        """Run the command, or report that `ulimit -v` leaves too little address space."""
        limit = _address_space()
        if limit is not None and limit < self.needed_bytes:
            command = ctx.command_path.replace(ctx.find_root().command_path, "rig", 1)
            typer.echo(
                f"the address space of a process is limited to {limit / 1e6:.0f} MB (ulimit -v), "
                f"{command} needs {self.needed_bytes / 1e6:.0f} MB",
                err=True,
            )
            raise typer.Exit(FAULT)
        return super().invoke(ctx)


class PlottingCommand(NumericalCommand):
    """A command that draws figures, without the rod model."""

    needed_bytes = 700_000_000


class EstimationCommand(NumericalCommand):
    """A command that also loads optimisers and the compiled sensitivities."""

    needed_bytes = 1_500_000_000
