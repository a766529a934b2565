"""The run in the terminal: a live table on a terminal, plain lines elsewhere."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass
from enum import IntEnum
from types import TracebackType
from typing import IO, TextIO, cast

import numpy as np
from numpy.typing import NDArray
from rich.columns import Columns
from rich.console import Console, ConsoleOptions, Group, RenderableType, RenderResult
from rich.live import Live
from rich.measure import Measurement
from rich.progress_bar import ProgressBar
from rich.table import Column, Table
from rich.text import Text

from rig.cli.keyboard import Keyboard
from rig.cli.nonblocking_writer import NonBlockingWriter
from rig.cli.printable import printable
from rig.execution.plan import Progress
from rig.sections.quantities import PA_PER_BAR
from runs.records import DetectionStatus, Event, Level, Quantity

LINE_EVERY_S = 2.0
UNBOUNDED = 1000


class DisplayPriority(IntEnum):
    """Priority of a block on a small screen; the lowest is shortened first."""

    HINT = 0
    TIMING = 1
    ESTIMATES = 2
    PRESSURES = 3
    TIP = 4
    TITLE = 5
    ALL = 6


@dataclass(frozen=True)
class DisplayBlock:
    """One part of the screen in several forms, the longest first."""

    forms: tuple[RenderableType, ...]
    keep: DisplayPriority = DisplayPriority.ALL


class FittedDisplay:
    """A column of blocks, shortened to the height of the terminal; forms wider than the terminal are excluded."""

    def __init__(self, blocks: Sequence[DisplayBlock]) -> None:
        self._blocks = blocks

    def __rich_console__(self, console: Console, options: ConsoleOptions) -> RenderResult:
        """Render the chosen forms."""
        forms = [_wide_enough(console, options, block.forms) for block in self._blocks]
        heights = [[len(console.render_lines(form, options)) for form in row] for row in forms]
        chosen = [0] * len(forms)
        while sum(row[i] for row, i in zip(heights, chosen, strict=True)) >= options.size.height:
            shorter = [n for n, row in enumerate(forms) if chosen[n] + 1 < len(row)]
            if not shorter:
                break
            # Every block uses its second form before any block uses its third.
            chosen[min(shorter, key=lambda n: (chosen[n], self._blocks[n].keep))] += 1
        for row, i in zip(forms, chosen, strict=True):
            yield row[i]


def _wide_enough(
    console: Console, options: ConsoleOptions, forms: tuple[RenderableType, ...]
) -> tuple[RenderableType, ...]:
    """Return the forms that fit the width without wrapping; the last one always."""
    unbounded = options.update_width(UNBOUNDED)  # a measurement never exceeds its width limit
    fits = [f for f in forms[:-1] if Measurement.get(console, unbounded, f).minimum <= options.max_width]
    return (*fits, forms[-1])


NOTHING = Group()
_STYLE = {Level.INFO: "dim", Level.WARNING: "yellow", Level.FAULT: "bold red"}


class Terminal:
    """Shows a run and reads the operator's answers. A closed terminal does not stop a run."""

    def __init__(self, console: Console, stop_reason: Callable[[], str | None], title: str) -> None:
        self._console = console
        self._stop_reason = stop_reason
        self._title = title
        self._live = Live(console=console, auto_refresh=False, transient=True) if console.is_terminal else None
        self._line_at = -LINE_EVERY_S
        self._keys = Keyboard()
        self._writer: NonBlockingWriter | None = None
        self._typed = ""
        self._prompted = False
        self._no_operator = False

    def __enter__(self) -> Terminal:
        self._keys.__enter__()
        # The terminal may block; the run must not wait for it.
        with suppress(OSError, ValueError):
            self._stream = cast(TextIO, self._console.file)
            self._writer = NonBlockingWriter(self._stream)
            self._console.file = cast(IO[str], self._writer)
        if self._live is not None:
            self._live.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if self._live is not None:
            with suppress(OSError):
                self._live.stop()
        if self._writer is not None:
            self._console.file = self._stream
            self._writer.close()
        self._keys.__exit__(kind, error, trace)

    def show(self, progress: Progress) -> None:
        """Show the progress of the run."""
        if self._live is not None and progress.prompt is None:
            self._typed = self._typed.replace("\n", "")  # Enter answers the current prompt only, not a later one
        with suppress(OSError):
            if self._live is not None:
                self._live.update(_screen(self._title, progress), refresh=True)
            elif time.monotonic() - self._line_at >= LINE_EVERY_S:
                self._line_at = time.monotonic()
                self._console.print(_line(progress), soft_wrap=True, highlight=False)

    def report(self, event: Event) -> None:
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
        answered = self._consume("\n")
        self._no_operator = self._keys.ended and not answered
        return answered

    def pause_toggled(self) -> bool:
        """True once the operator has pressed p."""
        return self._consume("p")

    def _consume(self, key: str) -> bool:
        """Remove one occurrence of a key from the input; a pipe is read only after the first prompt."""
        if self._live is not None or self._prompted:
            self._typed += self._keys.pressed()
        before, found, after = self._typed.partition(key)
        if found:
            self._typed = before + after
        return bool(found)

    def stop_requested(self) -> str | None:
        """Return the reason to stop; None where there is none."""
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


def _path_error_mm(row: NDArray[np.void]) -> float:
    """Distance from the reference in the controlled coordinates; NaN without a reference."""
    off = row["measured_m"] - row["reference_m"]
    return 1e3 * float(np.sqrt(np.nansum(off**2))) if np.isfinite(off).any() and row["tip_motion"] else float("nan")


def _line(progress: Progress) -> str:
    parts = [f"{progress.protocol_s:7.1f} of {progress.duration_s:.1f} s"]
    if progress.sample is not None:
        pairs = zip(progress.sample["setpoint_pa"], progress.sample["measured_pa"], strict=True)
        parts.append("bar " + " ".join(f"{s / PA_PER_BAR:.3f}/{m / PA_PER_BAR:.3f}" for s, m in pairs))
        parts += _auxiliary(progress)
    if progress.observation is not None and progress.observation["seen"] == DetectionStatus.MEASURED:
        parts.append(f"tip mm {_point(progress.observation['measured_m'])}, error {_error_mm(progress):.2f}")
        if np.isfinite(path := _path_error_mm(progress.observation)):
            parts.append(f"path error {path:.2f}")
    elif progress.observation is not None and progress.observation["seen"] == DetectionStatus.NO_CAMERA:
        parts.append(f"model tip mm {_point(progress.observation['model_m'])}, not measured: no camera")
    if progress.missed or progress.dropped:
        parts.append(_losses(progress))
    if progress.held:
        parts.append("PAUSED")
    if progress.prompt is not None:
        parts.append(f"WAITING: {progress.prompt} (then press Enter)")
    return " | ".join(parts)


def _losses(progress: Progress) -> str:
    deadlines = f"deadlines missed {progress.missed}"
    return deadlines if progress.dropped is None else f"{deadlines}, frames dropped {progress.dropped}"


def _screen(title: str, progress: Progress) -> FittedDisplay:
    """Return the screen of a run, each part with its shorter forms."""
    sample, observation = progress.sample, progress.observation
    blocks = [DisplayBlock((Text(printable(title), "bold"), NOTHING), DisplayPriority.TITLE)]
    # Prompts come first, because the end of a screen that is too long is cut off.
    if progress.held:
        blocks.append(DisplayBlock((Text("PAUSED: p resumes", "bold yellow"),)))
    if progress.prompt is not None:
        blocks.append(DisplayBlock((Text(f"{printable(progress.prompt)}, then press Enter", "bold yellow"),)))
    if sample is not None:
        blocks.append(DisplayBlock((_pressures(sample), _pressures_short(sample)), DisplayPriority.PRESSURES))
        if inputs := _auxiliary(progress):
            blocks.append(DisplayBlock((_cells(inputs),), DisplayPriority.PRESSURES))
    if observation is not None and observation["seen"] == DetectionStatus.NO_CAMERA:
        blocks.append(DisplayBlock((_prediction(observation),), DisplayPriority.TIP))
    elif observation is not None:
        error = Text(f"error {_error_mm(progress):.2f} mm", "bold cyan")
        short = Text.assemble(error, ("" if observation["model_ok"] else ", model not solved", "yellow"))
        short = Text.assemble(short, f", tip {_tip(observation)}")
        blocks.append(DisplayBlock((_positions(progress, observation), short, error), DisplayPriority.TIP))
    if sample is not None:
        late = f"control late by {sample['lateness_ns'] / 1e3:.0f} us, {_losses(progress)}"
        style = "yellow" if progress.missed or progress.dropped else "dim"
        blocks.append(DisplayBlock((Text(late, style), NOTHING), DisplayPriority.TIMING))
    clock = f"{_clock(progress.protocol_s)} of {_clock(progress.duration_s)}"
    way = Table.grid(Column(max_width=50), Column(no_wrap=True), padding=(0, 1))
    way.add_row(ProgressBar(total=progress.duration_s, completed=progress.protocol_s), clock)
    blocks.append(DisplayBlock((way, Text(clock))))
    blocks.append(DisplayBlock((Text("p pauses, Ctrl-C stops", "dim"), NOTHING), DisplayPriority.HINT))
    if progress.adaptation is not None:
        found = _estimates(progress.adapted, progress.adaptation)
        blocks.append(
            DisplayBlock((*found, Text("the estimates need a larger terminal", "yellow")), DisplayPriority.ESTIMATES)
        )
    return FittedDisplay(blocks)


def _auxiliary(progress: Progress) -> list[str]:
    """The auxiliary inputs of the rig, each with its name and unit."""
    if progress.sample is None or not progress.auxiliary:
        return []
    values = progress.sample["aux"].tolist()
    return [f"{one.name} {value:.4g} {one.unit}" for one, value in zip(progress.auxiliary, values, strict=True)]


def _pressures(sample: NDArray[np.void]) -> Table:
    table = Table(box=None, padding=(0, 1, 0, 0))
    for head in ("actuator", "set-point [bar]", "measured [bar]", "difference [bar]"):
        table.add_column(head, justify="right", overflow="fold", min_width=7)
    for i, (setpoint, measured) in enumerate(zip(sample["setpoint_pa"], sample["measured_pa"], strict=True), 1):
        table.add_row(str(i), _bar(setpoint), _bar(measured), f"{(measured - setpoint) / PA_PER_BAR:+.3f}")
    return table


def _pressures_short(sample: NDArray[np.void]) -> Group:
    pairs = zip(sample["setpoint_pa"], sample["measured_pa"], strict=True)
    cells = [f"{i}: {_bar(s).strip()} / {_bar(m).strip()}" for i, (s, m) in enumerate(pairs, 1)]
    return Group(Text("actuator: set-point / measured [bar]", "bold"), _cells(cells))


def _positions(progress: Progress, observation: NDArray[np.void]) -> Table:
    table = Table(box=None, padding=(0, 2, 0, 0))
    for head in ("tip", "x y z [mm]", "+- [mm]"):
        table.add_column(head, justify="right", overflow="fold", min_width=8)
    if observation["seen"] == DetectionStatus.MEASURED:
        std = np.sqrt(np.diagonal(observation["covariance_m2"]))
        table.add_row("measured", _point(observation["measured_m"]), _uncertainty(std))
    else:
        table.add_row("measured", Text(f"none: {_unseen(observation)}", "yellow"), "")
    table.add_row("model", _point(observation["model_m"]), "" if observation["model_ok"] else "not solved")
    table.add_row("error", Text(f"{_error_mm(progress):.2f} mm", "bold cyan"), "")
    return table


def _uncertainty(std_m: NDArray[np.float64]) -> str:
    """Return standard uncertainties [mm] with two significant digits: a small one is not zero."""
    return " ".join(f"{1e3 * value:#7.2g}" for value in std_m)


def _prediction(observation: NDArray[np.void]) -> Text:
    """Return the model's tip of a rig without cameras, which has no error."""
    solved = "" if observation["model_ok"] else ", model not solved"
    point = " ".join(_point(observation["model_m"]).split())
    return Text.assemble(f"tip of the model {point} mm", (solved, "yellow"), "; not measured: the rig has no camera")


def _tip(observation: NDArray[np.void]) -> str:
    if observation["seen"] != DetectionStatus.MEASURED:
        return f"not measured: {_unseen(observation)}"
    return f"{' '.join(_point(observation['measured_m']).split())} mm"


def _unseen(observation: NDArray[np.void]) -> str:
    return DetectionStatus(int(observation["seen"])).words


def _estimates(adapted: Sequence[Quantity], row: NDArray[np.void]) -> tuple[RenderableType, RenderableType]:
    """Return the current estimates in two forms: beside their initial values, and alone."""
    table = Table(box=None, padding=(0, 2, 0, 0))
    for head in ("parameter", "estimate", "+-", "began with", "+-", "unit"):
        # Only names may wrap, because a wrapped number can be misread.
        table.add_column(head, justify="left" if head in ("parameter", "unit") else "right", no_wrap=True)
    table.columns[0].no_wrap, table.columns[0].overflow = False, "fold"
    std = np.sqrt(np.diagonal(row["covariance"]))
    cells = []
    for quantity, value, deviation in zip(adapted, row["value"], std, strict=True):
        initial = f"{quantity.value[0]:.5g}", f"{quantity.uncertainty:.2g}"
        table.add_row(quantity.name, f"{value:.5g}", f"{deviation:.2g}", *initial, quantity.unit)
        cells.append(f"{quantity.name} {value:.5g} +- {deviation:.2g} {quantity.unit}".rstrip())
    return table, Group(Text("estimates", "bold"), _cells(cells))


def _cells(texts: Sequence[str]) -> Columns:
    """Return short texts in columns; a text wider than the terminal wraps between words."""
    return Columns([Text(text) for text in texts], padding=(0, 3))
