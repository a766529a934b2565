"""The table (CSV) and the page (HTML) of a study."""

from __future__ import annotations

import csv
import math
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from html import escape
from io import StringIO
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray

from runs.overwriting import refuse_existing, write_text
from runs.printable_text import spreadsheet_text
from runs.report import html
from runs.report.colours import MEASURED, MUTED, RUNS
from runs.report.drawing import FigureSpecification
from runs.report.html import DASH, html_document, html_table, significant
from runs.run import Run
from runs.study.responses import RESPONSES, ResponseVariable

ORDER = "order"
_FACTS = ("number", "run", "block", "combination", "start_utc", "executor", "specimen", "operator")
_ALWAYS = ("number", "run")
"""Facts that the page shows even where all are equal."""
_PANEL = (3.6, 2.6)
"""Size of a panel in inches."""


@dataclass(frozen=True)
class StudyTable:
    """The runs of a study: facts, settings by name, and responses in the order of `RESPONSES`, NaN where unknown.

    `order` counts the runs from 1 by the times at which they really began.
    """

    facts: tuple[tuple[str, ...], ...]
    settings: dict[str, tuple[float, ...]]
    responses: tuple[tuple[float, ...], ...]
    blocks: tuple[int, ...]
    order: tuple[int, ...]
    simulated: tuple[bool, ...]


def tabulate(archives: Sequence[Path]) -> StudyTable:
    """Read the runs of a study."""
    facts, settings, responses, blocks, began, simulated = [], [], [], [], [], []
    for path in archives:
        run = Run(path)
        place = run.header.study
        assert place is not None
        header = run.header
        start = str(np.datetime64(header.started_utc_ns, "ns").astype("datetime64[s]"))
        conditions = (header.executor, header.metadata.get("specimen", ""), header.operator)
        facts.append((str(place.number), header.run_id, str(place.block), str(place.combination), start, *conditions))
        settings.append({q.name: q.value[0] for q in run.header.protocol_parameters})
        responses.append([response.of(run) for response in RESPONSES])
        blocks.append(place.block)
        began.append((header.started_utc_ns, place.number))
        simulated.append(header.simulated)
    names = list(settings[0]) if settings else []
    return StudyTable(
        facts=tuple(facts),
        settings={name: tuple(row[name] for row in settings) for name in names},
        responses=tuple(zip(*responses, strict=True)),
        blocks=tuple(blocks),
        order=tuple(sorted(began).index(start) + 1 for start in began),
        simulated=tuple(simulated),
    )


def write(name: str, title: str, planned: int, archives: Sequence[Path], folder: Path) -> tuple[Path, Path]:
    """Write `NAME.study.html` and `NAME.study.csv` from the finished runs; return both paths.

    Raises:
        WouldOverwriteError: a file of this name is not the table or the page of this study.
    """
    table = tabulate(archives)
    page, rows = folder / f"{name}.study.html", folder / f"{name}.study.csv"
    mark = f'<meta name="softrig-study" content="{escape(name)}">'
    text = _csv(table)
    refuse_existing([page], made=lambda file: mark in file.read_text(encoding="utf-8", errors="replace"))
    head = ",".join(_FACTS)
    refuse_existing([rows], made=lambda file: file.read_text(encoding="utf-8", errors="replace").startswith(head))
    body = "\n".join(_body(name, title, planned, table))
    write_text(rows, text)
    write_text(page, html_document(escape(title), mark, body))
    return page, rows


def _csv(table: StudyTable) -> str:
    out = StringIO()
    writer = csv.writer(out, lineterminator="\n")
    writer.writerow([*_FACTS, *table.settings, *(f"{r.name}_{r.unit}" for r in RESPONSES), "simulated"])
    for row, facts in enumerate(table.facts):
        numbers = [values[row] for values in (*table.settings.values(), *table.responses)]
        texts = (f"{value:.9g}" if math.isfinite(value) else "" for value in numbers)
        writer.writerow([*map(spreadsheet_text, facts), *texts, int(table.simulated[row])])
    return out.getvalue()


def _body(name: str, title: str, planned: int, table: StudyTable) -> Iterator[str]:
    simulated = any(table.simulated)
    beneath = f"study {escape(name)} · {len(table.facts)} of {planned} runs finished"
    yield f'<section class="run">{html.heading(escape(title), beneath, simulated=simulated)}'
    if simulated:
        yield html.note("<b>Runs of this study were simulated.</b> They measure no real manipulator.")
    yield from _mixed(table)
    factors = {key: values for key, values in table.settings.items() if len(set(values)) > 1}
    known = {
        response: np.array(values)
        for response, values in zip(RESPONSES, table.responses, strict=True)
        if values and np.isfinite(values).all()
    }
    yield from _summary(known, factors)
    if missing := [response.title.lower() for response in RESPONSES if response not in known]:
        yield html.small(f"Not known for every run, and so not shown: {', '.join(missing)}.")
    for response in known:
        yield from _response(response, factors, table)
    yield html.folded("Runs", _runs(table))
    yield "</section>"


def _summary(
    known: Mapping[ResponseVariable, NDArray[np.float64]], factors: Mapping[str, tuple[float, ...]]
) -> Iterator[str]:
    """For each response, what it is over all runs, and at which levels its mean is lowest and highest."""
    heads = ["", "mean", "standard<br>deviation", "lowest", "highest"]
    heads += ["lowest mean at", "highest mean at"] if factors else []
    rows = []
    for response, y in known.items():
        spread = significant(float(y.std(ddof=1)), 2) if len(y) > 1 else DASH
        cells = [f"{response.title} [{response.unit}]", significant(float(y.mean()), 4), spread]
        cells += [significant(float(value), 4) for value in (y.min(), y.max())]
        if factors:
            means = {chosen: float(y[own].mean()) for chosen, own in _combinations(factors, y)}
            cells += [_levels(factors, choose(means, key=means.__getitem__)) for choose in (min, max)]
        rows.append(cells)
    if rows:
        yield f"<h2>Summary</h2>\n{html_table(heads, rows, words=1)}"


def _levels(factors: Mapping[str, tuple[float, ...]], chosen: tuple[float, ...]) -> str:
    return ", ".join(f"{escape(name)} = {level:.6g}" for name, level in zip(factors, chosen, strict=True))


def _runs(table: StudyTable) -> str:
    """The table of the runs, without the facts and settings that are equal in all of them: the CSV file has those."""
    facts = dict(zip(_FACTS, zip(*table.facts, strict=True), strict=False))
    shown: dict[str, Sequence[str]] = {
        escape(name): [escape(text or DASH) for text in column]
        for name, column in facts.items()
        if name in _ALWAYS or len(set(column)) > 1
    }
    words = len(shown)
    shown |= {
        escape(name): [significant(value, 4) for value in values]
        for name, values in table.settings.items()
        if len(set(values)) > 1
    }
    shown |= {
        f"{r.title.lower()}<br>[{r.unit}]": [significant(value, 4) for value in values]
        for r, values in zip(RESPONSES, table.responses, strict=True)
    }
    return html_table(list(shown), list(zip(*shown.values(), strict=True)), words=words)


def _mixed(table: StudyTable) -> Iterator[str]:
    """Say which conditions differ between runs that are shown together."""
    for name in ("executor", "specimen", "operator"):
        column = _FACTS.index(name)
        counts = Counter(facts[column] for facts in table.facts)
        if len(counts) > 1:
            each = ", ".join(f"{escape(value) or 'none stated'} ({count})" for value, count in sorted(counts.items()))
            yield html.note(f"Runs of more than one {name} are shown together: {each}.")


def _response(response: ResponseVariable, factors: Mapping[str, tuple[float, ...]], table: StudyTable) -> Iterator[str]:
    """The runs over each factor and over their order, and the mean of each combination."""
    y = np.array(table.responses[RESPONSES.index(response)])
    yield f"<h2>{response.title} [{response.unit}]</h2>"
    yield f"<p>{escape(response.about[:1].upper() + response.about[1:])}.</p>"
    # A drawing for each panel: on a narrow page they stand below each other, with the letters still large enough.
    mark = "simulated" * any(table.simulated)
    drawings = "".join(
        html.figure(
            FigureSpecification(
                name,
                f"over {name}" if name in factors else "over the order of the runs",
                _draw,
                _PANEL,
                about=(response, name, factors.get(name), table, y),
            ),
            f"{response.name}-{name}",
            mark,
        )
        for name in (*factors, ORDER)
    )
    coloured = ", coloured by block" if len(set(table.blocks)) > 1 else ""
    means = "First: means of the levels with one standard deviation. Last: runs" if factors else "Runs"
    yield f"<div class=panels>{drawings}</div>"
    yield html.small(f"Points are runs. {means} in the order in which they began{coloured}.")
    heads = [*map(escape, factors), "runs", "mean", "standard deviation", "lowest", "highest"]
    rows = [
        (*(f"{level:.12g}" for level in chosen), str(own.sum()), *_statistics(y[own]))
        for chosen, own in _combinations(factors, y)
    ]
    yield html.folded("Mean of each combination", html_table(heads, rows, words=len(factors)))


def _statistics(own: NDArray[np.float64]) -> tuple[str, ...]:
    spread = significant(float(own.std(ddof=1)), 2) if len(own) > 1 else DASH
    mean, lowest, highest = (significant(float(value), 4) for value in (own.mean(), own.min(), own.max()))
    return mean, spread, lowest, highest


def _combinations(
    factors: Mapping[str, tuple[float, ...]], y: NDArray[np.float64]
) -> Iterator[tuple[tuple[float, ...], NDArray[np.bool_]]]:
    """Each combination of levels, by level, and which runs have it."""
    settings = list(zip(*factors.values(), strict=True)) or [()] * len(y)
    for chosen in sorted(set(settings)):
        yield chosen, np.array([one == chosen for one in settings])


def _draw(
    figure: Figure,
    response: ResponseVariable,
    name: str,
    levels: tuple[float, ...] | None,
    table: StudyTable,
    y: NDArray[np.float64],
) -> None:
    """Responses over a factor with the means of its levels, or, without levels, over the order of the runs."""
    panel = figure.subplots()
    panel.set_ylabel(f"{response.title.lower()} [{response.unit}]")
    if levels is None:
        for block in sorted(set(table.blocks)):
            chosen = [k for k, b in enumerate(table.blocks) if b == block]
            panel.plot([table.order[k] for k in chosen], y[chosen], "o", ms=3, color=RUNS[(block - 1) % len(RUNS)])
        panel.set_xlabel("run, by its start")
        return
    panel.plot(levels, y, "o", color=MUTED, ms=2.5, alpha=0.6)
    each = sorted(set(levels))
    at = [y[[level == one for level in levels]] for one in each]
    spreads = [float(own.std(ddof=1)) if len(own) > 1 else 0.0 for own in at]
    means = [float(own.mean()) for own in at]
    panel.errorbar(each, means, spreads, fmt="o-", color=MEASURED, ms=4, lw=1, capsize=3)
    panel.set_xlabel(name)
    panel.margins(x=0.15)
