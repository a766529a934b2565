"""Figures as files of their own, for a paper."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from runs import arguments
from runs.export.exporters import ExportError
from runs.overwriting import WouldOverwriteError, staged
from runs.report import comparison, drawing
from runs.report.figure_specifications import figure_specifications, of_pictures
from runs.run import Run, paths_of
from runs.summary import summarise

KINDS = ("pdf", "png", "svg")
LEAST_WIDTH_MM, LARGEST_WIDTH_MM = 60.0, 300.0
_MARK = "simulated"


def write(
    archives: Sequence[Run | Path | str],
    folder: Path | str,
    kind: str = "pdf",
    *,
    width_mm: float = drawing.COLUMN_MM,
    replace: bool = False,
) -> tuple[Path, ...]:
    """Write each figure of each run as `<run>-<figure>.pdf` (or png, svg) for a paper; return these files.

    The width is that of a column. Beside each figure, `<run>-<figure>.csv` has what it shows (see `figure_data`). Of
    several runs also those that compare them, `compared-<figure>.pdf`. What was simulated says so in its corner.

    Runs are given as `Run`, path, run id or `last`.

    Raises:
        ArchiveError: a run is not found.
        WouldOverwriteError: a file exists, and `replace` is False.
        ArgumentError: folder or width are of another type.
        ExportError: there is no such kind, or the files cannot be written.
    """
    if kind not in KINDS:
        raise ExportError(f"no figures as {kind!r}; there are {', '.join(KINDS)}")
    width_mm = arguments.number("width_mm", width_mm, "a number")
    if not LEAST_WIDTH_MM <= width_mm <= LARGEST_WIDTH_MM:
        raise ExportError(
            f"no figures {width_mm:g} mm wide; they are {LEAST_WIDTH_MM:g} to {LARGEST_WIDTH_MM:g} mm wide"
        )
    place = arguments.path("folder", folder, "the path of a folder")
    runs = [Run(path) for path in paths_of(archives)]
    try:
        with staged(place, replace=replace) as stage:
            names = _write(runs, stage, kind, width_mm)
    except WouldOverwriteError:
        raise
    except OSError as fault:
        raise ExportError(f"cannot write to {place}: {fault.strerror or fault}") from fault
    return tuple(place / name for name in names)


def _write(runs: Sequence[Run], folder: Path, kind: str, width_mm: float) -> list[str]:
    """Draw every figure into a folder; the names of the files."""
    names = []
    summaries = [summarise(run) for run in runs]
    for run, summary in zip(runs, summaries, strict=True):
        for figure in (*figure_specifications(run, summary), *of_pictures(run, summary)):
            names.append(f"{run.path.stem}-{figure.name}.{kind}")
            mark = _MARK * summary.simulated
            drawing.save(figure.draw, figure.print_size(width_mm), folder / names[-1], *figure.about, mark=mark)
    mark = _MARK * any(summary.simulated for summary in summaries)
    for figure in comparison.comparison_figures(runs, summaries) if len(runs) > 1 else ():
        names.append(f"compared-{figure.name}.{kind}")
        drawing.save(figure.draw, figure.print_size(width_mm), folder / names[-1], *figure.about, mark=mark)
    return names
