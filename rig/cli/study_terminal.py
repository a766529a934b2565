"""The operator of a study in real time, at the terminal."""

from __future__ import annotations

import time

from rich.console import Console

from rig.cli import run_output
from rig.cli.terminal import Terminal
from rig.execution.plan import RunPlan
from rig.execution.stop_signals import StopSignals
from rig.experiment import run as experiment
from rig.experiment.run import RunRequest
from runs.records import Status


class StudyTerminal:
    """Shows each run as `rig run` does; rests and asks between the runs. Ctrl-C stops the study."""

    def __init__(self, screen: Console) -> None:
        self._screen = screen

    def run(self, request: RunRequest, plan: RunPlan) -> Status:
        """Perform a run; return how it ended."""
        place = request.study
        assert place is not None
        self._screen.print(f"study {place.study}: {place.role} {place.number}, block {place.block}", style="bold")
        with (
            StopSignals(restore=True) as signals,
            Terminal(self._screen, lambda: signals.reason, run_output.title(request)) as terminal,
        ):
            result = experiment.run(request, plan, terminal)
        run_output.last_screen(self._screen, result)
        return result.outcome.status

    def rest(self, seconds: float) -> None:
        """Wait."""
        self._screen.print(f"rest for {seconds:g} s")
        time.sleep(seconds)

    def confirm(self, prompt: str) -> None:
        """Print what the operator has to do; return after Enter."""
        self._screen.print(prompt, style="bold yellow")
        try:
            self._screen.input("then Enter ", markup=False)
        except EOFError:
            raise KeyboardInterrupt from None
