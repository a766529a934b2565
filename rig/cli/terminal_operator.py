"""The operator of a calibration, at the terminal."""

from __future__ import annotations

import typer
from rich.console import Console

from rig.cli.keyboard import Keyboard
from rig.cli.output import console
from rig.cli.run_output import confirm


class TerminalOperator:
    """Instructions on standard error, keys from standard input."""

    def __init__(self) -> None:
        self._screen: Console = console(stderr=True)

    def tell(self, line: str) -> None:
        self._screen.print(line, soft_wrap=True)

    def confirm(self) -> bool:
        return confirm(self._screen)

    def wait(self, instruction: str) -> None:
        typer.prompt(f"{instruction}; then Enter", default="", show_default=False, err=True)

    def keys(self) -> Keyboard:
        return Keyboard()
