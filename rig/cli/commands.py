"""Classes of command groups: their `--help` has whole sentences, and a group may have a default command."""

from __future__ import annotations

from typing import Any

import typer


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
