"""Figures as files of their own, for a paper."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from runs.export.exporters import ExportError
from runs.report import comparison, figures
from runs.report.figure_specifications import figure_specifications, of_pictures
from runs.run import Run
from runs.summary import summarise

KINDS = ("pdf", "png", "svg")
_MARK = "simulated"


def write(archives: Sequence[Path | str], folder: Path | str, kind: str = "pdf") -> tuple[Path, ...]:
    """Write each figure of each run as `<run>-<figure>.pdf` (or png, svg) for a paper; return the files.

    Of several runs also those that compare them, `compared-<figure>.pdf`. What was simulated says so in its corner.
    """
    if kind not in KINDS:
        raise ExportError(f"no figures as {kind!r}; there are {', '.join(KINDS)}")
    runs, place = [Run(archive) for archive in archives], Path(folder)
    summaries = [summarise(run) for run in runs]
    try:
        place.mkdir(parents=True, exist_ok=True)
        written = []
        for run, summary in zip(runs, summaries, strict=True):
            for plate in (*figure_specifications(run, summary), *of_pictures(run, summary)):
                path = place / f"{run.path.stem}-{plate.name}.{kind}"
                figures.save(plate.draw, plate.size, path, run, summary, mark=_MARK * summary.simulated)
                written.append(path)
        mark = _MARK * any(summary.simulated for summary in summaries)
        for plate in comparison.plates(runs) if len(runs) > 1 else ():
            path = place / f"compared-{plate.name}.{kind}"
            figures.save(plate.draw, plate.size, path, runs, summaries, mark=mark)
            written.append(path)
    except OSError as fault:
        raise ExportError(f"cannot write to {place}: {fault.strerror or fault}") from fault
    return tuple(written)
