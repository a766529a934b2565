"""A command group whose first sub-command is the default: `rig identify RUN` means `rig identify fit RUN`."""

from __future__ import annotations

from typing import Any

from rig.cli.help_formatter import HelpGroup


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
