"""Commands that load numerical libraries; which crash or hang without enough address space; it is checked first."""

from __future__ import annotations

from typing import Any

import typer
from typer.core import TyperCommand

from rig.cli.exit_status import FAULT

try:
    import resource
except ImportError:  # Windows
    resource = None  # type: ignore[assignment]


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
