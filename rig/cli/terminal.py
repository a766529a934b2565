"""The run in the terminal: a live table where there is a screen, plain lines where there is none."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from contextlib import suppress
from types import TracebackType
from typing import IO, TextIO, cast

import numpy as np
from numpy.typing import NDArray
from rich.console import Console, Group
from rich.live import Live
from rich.progress_bar import ProgressBar
from rich.table import Column, Table
from rich.text import Text

from rig.cli.keyboard import Keyboard
from rig.cli.nonblocking_writer import NonBlockingWriter
from rig.cli.printable import printable
from rig.config.schema import PA_PER_BAR
from rig.execution.plan import Progress
from runs.records import DetectionStatus, Event, Level, Quantity

LINE_EVERY_S = 2.0
_STYLE = {Level.INFO: "dim", Level.WARNING: "yellow", Level.FAULT: "bold red"}


class Terminal:
    """Shows a run and takes the operator's answers. A terminal that has gone never stops a run."""

    def __init__(self, console: Console, stop_reason: Callable[[], str | None], title: str) -> None:
        self._console = console
        self._stop_reason = stop_reason
        self._title = title
        self._live = Live(console=console, auto_refresh=False, transient=True) if console.is_terminal else None
        self._line_at = -LINE_EVERY_S
        self._keys = Keyboard()
        self._outlet: NonBlockingWriter | None = None
        self._typed = ""
        self._prompted = False
        self._no_operator = False

    def __enter__(self) -> Terminal:
        self._keys.__enter__()
        # Whoever reads the terminal may stop reading; the run has no time to wait for him.
        with suppress(OSError, ValueError):
            self._stream = cast(TextIO, self._console.file)
            self._outlet = NonBlockingWriter(self._stream)
            self._console.file = cast(IO[str], self._outlet)
        if self._live is not None:
            self._live.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if self._live is not None:
            with suppress(OSError):
                self._live.stop()
        if self._outlet is not None:
            self._console.file = self._stream
            self._outlet.close()
        self._keys.__exit__(kind, error, trace)

    def show(self, progress: Progress) -> None:
        """Show where the run stands."""
        if self._live is not None and progress.prompt is None:
            self._typed = self._typed.replace("\n", "")  # Enter answers the prompt that is shown, never one to come
        with suppress(OSError):
            if self._live is not None:
                self._live.update(_screen(self._title, progress), refresh=True)
            elif time.monotonic() - self._line_at >= LINE_EVERY_S:
                self._line_at = time.monotonic()
                self._console.print(_line(progress), soft_wrap=True, highlight=False)

    def tell(self, event: Event) -> None:
        """Show an event; it stays on the screen."""
        with suppress(OSError):
            self._console.print(
                Text(printable(f"{event.source}: {event.message}"), _STYLE[event.level]),
                soft_wrap=True,
                highlight=False,
            )

    def answered(self) -> bool:
        """True once the operator has pressed Enter."""
        self._prompted = True
        answered = self._taken("\n")
        self._no_operator = self._keys.ended and not answered
        return answered

    def pause_toggled(self) -> bool:
        """True once the operator has pressed p."""
        return self._taken("p")

    def _taken(self, key: str) -> bool:
        """Take one stroke of a key out of what was typed; a pipe is read only once a prompt asks for an answer."""
        if self._live is not None or self._prompted:
            self._typed += self._keys.pressed()
        before, found, after = self._typed.partition(key)
        if found:
            self._typed = before + after
        return bool(found)

    def stop_requested(self) -> str | None:
        """Why the run is to stop."""
        if self._no_operator:
            return "a prompt waits for an operator, and standard input has ended"
        return self._stop_reason()


def _bar(pascal: float) -> str:
    return f"{pascal / PA_PER_BAR:7.3f}"


def _point(metres: NDArray[np.float64]) -> str:
    return " ".join(f"{1e3 * x:8.2f}" for x in metres)


def _clock(seconds: float) -> str:
    minutes, rest = divmod(max(0, round(seconds)), 60)
    return f"{minutes}:{rest:02d}"


def _error_mm(progress: Progress) -> float:
    row = progress.observation
    return float("nan") if row is None else 1e3 * float(np.linalg.norm(row["measured_m"] - row["model_m"]))


def _line(progress: Progress) -> str:
    left = progress.duration_s - progress.protocol_s
    parts = [f"{progress.protocol_s:7.1f} s, {_clock(left)} left"]
    if progress.sample is not None:
        pairs = zip(progress.sample["setpoint_pa"], progress.sample["measured_pa"], strict=True)
        parts.append("bar " + " ".join(f"{s / PA_PER_BAR:.3f}/{m / PA_PER_BAR:.3f}" for s, m in pairs))
    if progress.observation is not None and progress.observation["seen"] == DetectionStatus.MEASURED:
        parts.append(f"tip mm {_point(progress.observation['measured_m'])}, error {_error_mm(progress):.2f}")
    if progress.held:
        parts.append("PAUSED")
    if progress.prompt is not None:
        parts.append(f"WAITING: {progress.prompt} (then press Enter)")
    return " | ".join(parts)


def _estimates(adapted: Sequence[Quantity], row: NDArray[np.void]) -> Table:
    """What the recursive estimator knows by now, beside what the run began with."""
    table = Table(box=None, padding=(0, 2, 0, 0))
    for head in ("parameter", "estimate", "+-", "began with", "+-", "unit"):
        table.add_column(head, justify="left" if head in ("parameter", "unit") else "right", overflow="fold")
    std = np.sqrt(np.diagonal(row["covariance"]))
    for quantity, value, deviation in zip(adapted, row["value"], std, strict=True):
        begun = f"{quantity.value[0]:.5g}", f"{quantity.uncertainty:.2g}"
        table.add_row(quantity.name, f"{value:.5g}", f"{deviation:.2g}", *begun, quantity.unit)
    return table


def _screen(title: str, progress: Progress) -> Group:
    parts: list[Text | Table] = [Text(printable(title), "bold")]
    # What waits for the operator stands first: of a screen that is too long the end is cut off.
    if progress.held:
        parts.append(Text("PAUSED: p resumes", "bold yellow"))
    if progress.prompt is not None:
        parts.append(Text(f"{printable(progress.prompt)}, then press Enter", "bold yellow"))
    sample, observation = progress.sample, progress.observation
    if sample is not None:
        table = Table(box=None, padding=(0, 2, 0, 0))
        for head in ("actuator", "set-point [bar]", "measured [bar]", "difference [bar]"):
            table.add_column(head, justify="right", overflow="fold", min_width=7)
        for i, (setpoint, measured) in enumerate(zip(sample["setpoint_pa"], sample["measured_pa"], strict=True), 1):
            table.add_row(str(i), _bar(setpoint), _bar(measured), f"{(measured - setpoint) / PA_PER_BAR:+.3f}")
        parts.append(table)
    if observation is not None:
        table = Table(box=None, padding=(0, 2, 0, 0))
        for head in ("tip", "x y z [mm]", "+- [mm]"):
            table.add_column(head, justify="right", overflow="fold", min_width=8)
        if observation["seen"] == DetectionStatus.MEASURED:
            std = np.sqrt(np.diagonal(observation["covariance_m2"]))
            table.add_row("measured", _point(observation["measured_m"]), _point(std))
        else:
            reason = DetectionStatus(int(observation["seen"])).name.lower().replace("_", " ")
            table.add_row("measured", Text(f"none: {reason}", "yellow"), "")
        table.add_row("model", _point(observation["model_m"]), "" if observation["model_ok"] else "not solved")
        table.add_row("error", Text(f"{_error_mm(progress):.2f} mm", "bold cyan"), "")
        parts.append(table)
    if sample is not None:
        late = f"control late by {sample['lateness_ns'] / 1e3:.0f} us, deadlines missed {progress.missed}"
        parts.append(Text(late, "yellow" if progress.missed else "dim"))
    left = _clock(progress.duration_s - progress.protocol_s)
    way = Table.grid(Column(max_width=50), Column(no_wrap=True), padding=(0, 1))
    bar = ProgressBar(total=progress.duration_s, completed=progress.protocol_s)
    way.add_row(bar, f"{_clock(progress.protocol_s)} of {_clock(progress.duration_s)}, {left} left")
    parts.append(way)
    parts.append(Text("p pauses, Ctrl-C stops", "dim"))
    if progress.adaptation is not None:
        parts.append(_estimates(progress.adapted, progress.adaptation))
    return Group(*parts)
