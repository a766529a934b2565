"""The operator of a calibration, at the terminal."""

from __future__ import annotations

import typer
from rich.console import Console

from rig.cli.console import console
from rig.cli.keyboard import Keyboard
from rig.cli.run_output import confirm
from rig.execution.stop_signals import StopSignals


class TerminalOperator:
    """Instructions on standard error, keys from standard input, stop signals from the terminal."""

    def __init__(self) -> None:
        self._screen: Console = console(stderr=True)

    def tell(self, line: str) -> None:
        """Print an instruction or the progress."""
        self._screen.print(line, soft_wrap=True)

    def confirm(self) -> bool:
        """Ask whether pressures may rise."""
        return confirm(self._screen)

    def wait(self, instruction: str) -> None:
        """Print an instruction; return after Enter."""
        typer.prompt(f"{instruction}; then Enter", default="", show_default=False, err=True)

    def keys(self) -> Keyboard:
        """Read single keys while entered."""
        return Keyboard()

    def stop_requests(self) -> StopSignals:
        """Turn SIGINT, SIGTERM and SIGHUP into a stop request while entered."""
        return StopSignals()
