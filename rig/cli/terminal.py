"""The run in the terminal: a live table on a terminal, plain lines elsewhere."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from contextlib import suppress
from typing import IO, TextIO, cast

import numpy as np
from numpy.typing import NDArray
from rich.columns import Columns
from rich.console import Console, Group, RenderableType
from rich.live import Live
from rich.progress_bar import ProgressBar
from rich.table import Column, Table
from rich.text import Text

from model.units import PA_PER_BAR
from rig.cli.keyboard import Keyboard
from rig.cli.nonblocking_writer import NonBlockingWriter
from rig.execution.plan import Progress
from runs.printable_text import printable
from runs.records import DetectionStatus, Event, Level, Quantity

LINE_EVERY_S = 2.0


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

    def __exit__(self, *error: object) -> None:
        if self._live is not None:
            with suppress(OSError):
                self._live.stop()
        if self._writer is not None:
            self._console.file = self._stream
            self._writer.close()
        self._keys.__exit__(*error)

    def show(self, progress: Progress) -> None:
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


def _point(metres: NDArray[np.float64]) -> str:
    return " ".join(f"{1e3 * x:.2f}" for x in metres)


def _clock(seconds: float) -> str:
    minutes, rest = divmod(max(0, round(seconds)), 60)
    return f"{minutes}:{rest:02d}"


def _line(progress: Progress) -> str:
    parts = [f"{progress.protocol_s:7.1f} of {progress.duration_s:.1f} s"]
    if progress.sample is not None:
        pairs = zip(progress.sample["setpoint_pa"], progress.sample["measured_pa"], strict=True)
        parts.append("bar " + " ".join(f"{s / PA_PER_BAR:.3f}/{m / PA_PER_BAR:.3f}" for s, m in pairs))
        parts += _auxiliary(progress)
    if progress.observation is not None and progress.observation["seen"] == DetectionStatus.MEASURED:
        tip = f"tip{_earlier(progress)} mm {_point(progress.observation['measured_m'])}"
        parts.append(f"{tip}, error {progress.error_mm:.2f}")
        if np.isfinite(path := progress.path_error_mm):
            parts.append(f"path error {path:.2f}")
    elif progress.observation is not None and progress.observation["seen"] == DetectionStatus.NO_CAMERA:
        parts.append(f"model tip mm {_point(progress.observation['model_m'])}, not measured: no camera")
    if progress.missed or progress.dropped:
        parts.append(_losses(progress))
    if progress.paused:
        parts.append("PAUSED")
    if progress.prompt is not None:
        parts.append(f"WAITING: {progress.prompt} (then press Enter)")
    return " | ".join(parts)


def _earlier(progress: Progress) -> str:
    """How long before the sample the tip was seen, where a tenth of a second or more: as in virtual time."""
    if progress.sample is None or progress.observation is None:
        return ""
    age_s = 1e-9 * (int(progress.sample["t_ns"]) - int(progress.observation["t_ns"]))
    return f" {age_s:.1f} s earlier" if age_s >= 0.1 else ""


def _losses(progress: Progress) -> str:
    deadlines = f"deadlines missed {progress.missed}"
    return deadlines if progress.dropped is None else f"{deadlines}, frames dropped {progress.dropped}"


def _screen(title: str, progress: Progress) -> Group:
    """Return the screen of a run, the most important first: a small terminal cuts off the end."""
    sample, observation = progress.sample, progress.observation
    parts: list[RenderableType] = [Text(printable(title), "bold")]
    if progress.paused:
        parts.append(Text("PAUSED: p resumes", "bold yellow"))
    if progress.prompt is not None:
        parts.append(Text(f"{printable(progress.prompt)}, then press Enter", "bold yellow"))
    clock = f"{_clock(progress.protocol_s)} of {_clock(progress.duration_s)}"
    bar = Table.grid(Column(max_width=50), Column(no_wrap=True), padding=(0, 1))
    bar.add_row(ProgressBar(total=progress.duration_s, completed=progress.protocol_s), clock)
    parts.append(bar)
    if sample is not None:
        parts += [Text("actuator: set-point / measured [bar]", "bold"), _cells(_pressures(sample))]
        if inputs := _auxiliary(progress):
            parts.append(_cells(inputs))
    if observation is not None:
        parts += _tip(progress, observation)
    if progress.adaptation is not None:
        parts += [Text("estimates", "bold"), _cells(_estimates(progress.adapted, progress.adaptation))]
    if sample is not None:
        late = f"control late by {sample['lateness_ns'] / 1e3:.0f} us, {_losses(progress)}"
        parts.append(Text(late, "yellow" if progress.missed or progress.dropped else "dim"))
    parts.append(Text("p pauses, Ctrl-C stops", "dim"))
    return Group(*parts)


def _auxiliary(progress: Progress) -> list[str]:
    if progress.sample is None or not progress.auxiliary:
        return []
    values = progress.sample["aux"].tolist()
    return [f"{one.name} {value:.4g} {one.unit}" for one, value in zip(progress.auxiliary, values, strict=True)]


def _pressures(sample: NDArray[np.void]) -> list[str]:
    pairs = zip(sample["setpoint_pa"] / PA_PER_BAR, sample["measured_pa"] / PA_PER_BAR, strict=True)
    return [f"{i}: {setpoint:.3f} / {measured:.3f}" for i, (setpoint, measured) in enumerate(pairs, 1)]


def _reference(observation: NDArray[np.void]) -> str:
    """Return the reference of the tip; a coordinate that is not controlled has none."""
    return " ".join(f"{1e3 * x:8.2f}" if np.isfinite(x) else f"{'free':>8}" for x in observation["reference_m"])


def _uncertainty(std_m: NDArray[np.float64]) -> str:
    """Return standard uncertainties [mm] with two significant digits: a small one is not zero."""
    return " ".join(f"{1e3 * value:#.2g}" for value in std_m)


def _tip(progress: Progress, observation: NDArray[np.void]) -> list[Text]:
    """Return the tips of measurement, model and reference, and their distances."""
    seen = DetectionStatus(int(observation["seen"]))
    solved = "" if observation["model_ok"] else ", model not solved"
    model = Text.assemble(f"model tip {_point(observation['model_m'])} mm", (solved, "yellow"))
    if seen is DetectionStatus.NO_CAMERA:
        return [Text.assemble(model, "; not measured: the rig has no camera")]
    if seen is not DetectionStatus.MEASURED:
        return [Text(f"tip not measured: {seen.words}", "yellow"), model]
    std_mm = _uncertainty(np.sqrt(np.diagonal(observation["covariance_m2"])))
    error = f"error {progress.error_mm:.2f} mm"
    if np.isfinite(path := progress.path_error_mm):
        error += f", path error {path:.2f} mm"
    lines = [
        Text(error, "bold cyan"),
        Text(f"measured tip {_point(observation['measured_m'])} mm, +- {std_mm} mm"),
        model,
    ]
    if observation["tip_motion"]:
        lines.append(Text(f"reference {_reference(observation)} mm"))
    return lines


def _estimates(adapted: Sequence[Quantity], row: NDArray[np.void]) -> list[str]:
    std = np.sqrt(np.diagonal(row["covariance"]))
    return [
        f"{quantity.name} {value:.5g} +- {deviation:.2g} {quantity.unit}".rstrip()
        for quantity, value, deviation in zip(adapted, row["value"], std, strict=True)
    ]


def _cells(texts: Sequence[str]) -> Columns:
    """Return short texts in columns; a text wider than the terminal wraps between words."""
    return Columns([Text(text) for text in texts], padding=(0, 3))
