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
from runs.report.colours import MEASURED, MUTED, RUNS
from runs.report.drawing import svg
from runs.report.html_table import DASH, html_table, significant
from runs.report.page import html_document
from runs.run import Run
from runs.study.responses import RESPONSES, ResponseVariable

ORDER = "order"
_FACTS = ("number", "run", "block", "combination", "start_utc", "executor", "specimen", "operator")


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
    badge = '<span class="badge simulated">simulated</span>' if any(table.simulated) else ""
    yield f'<section class="run"><header class="run"><h1>{escape(title)}{badge}</h1>'
    yield f'<p class="sub">study {escape(name)} · {len(table.facts)} of {planned} runs finished</p></header>'
    if any(table.simulated):
        yield '<p class="note"><b>Runs of this study were simulated.</b> They measure no real manipulator.</p>'
    yield from _mixed(table)
    factors = {key: values for key, values in table.settings.items() if len(set(values)) > 1}
    shown = []
    for response, values in zip(RESPONSES, table.responses, strict=True):
        if values and np.isfinite(values).all():
            shown.append(response)
            yield from _response(response, factors, table)
    missing = [response.name for response in RESPONSES if response not in shown]
    if missing:
        yield f"<p class=small>Not known for every run, and so not shown: {', '.join(missing)}.</p>"
    yield "<h2>Runs</h2>"
    heads = [*_FACTS, *table.settings, *(f"{r.name} [{r.unit}]" for r in RESPONSES)]
    rows = [
        [*facts, *(significant(values[k], 4) for values in (*table.settings.values(), *table.responses))]
        for k, facts in enumerate(table.facts)
    ]
    yield _table(heads, rows)
    yield "</section>"


def _mixed(table: StudyTable) -> Iterator[str]:
    """Say which conditions differ between runs that are shown together."""
    for name in ("executor", "specimen", "operator"):
        column = _FACTS.index(name)
        counts = Counter(facts[column] for facts in table.facts)
        if len(counts) > 1:
            each = ", ".join(f"{escape(value) or 'none stated'} ({count})" for value, count in sorted(counts.items()))
            yield f'<p class="note">Runs of more than one {name} are shown together: {each}.</p>'


def _response(response: ResponseVariable, factors: Mapping[str, tuple[float, ...]], table: StudyTable) -> Iterator[str]:
    """The runs over each factor and over their order, and the mean of each combination."""
    y = np.array(table.responses[RESPONSES.index(response)])
    yield f"<h2>{response.name.replace('_', ' ').capitalize()} [{response.unit}]</h2>"
    yield f"<p>{escape(response.about)}.</p>"
    # A drawing for each panel: on a narrow page they stand below each other, with the letters still large enough.
    drawings = "".join(
        svg(_draw, (3.6, 2.6), f"study/{response.name}/{name}", response, name, factors.get(name), table, y)
        for name in (*factors, ORDER)
    )
    coloured = ", coloured by block" if len(set(table.blocks)) > 1 else ""
    means = "First: means of the levels with one standard deviation. Last: runs" if factors else "Runs"
    caption = f"Points are runs. {means} in the order in which they began{coloured}."
    yield f"<figure><div class=panels>{drawings}</div><figcaption>{caption}</figcaption></figure>"
    yield _table([*factors, "runs", "mean", "standard deviation", "lowest", "highest"], list(_combinations(factors, y)))


def _combinations(factors: Mapping[str, tuple[float, ...]], y: NDArray[np.float64]) -> Iterator[list[str]]:
    """The row of each combination of levels, by level."""
    settings = list(zip(*factors.values(), strict=True)) or [()] * len(y)
    for chosen in sorted(set(settings)):
        own = y[[one == chosen for one in settings]]
        spread = significant(float(own.std(ddof=1)), 2) if len(own) > 1 else ""
        numbers = (significant(float(value), 4) for value in (own.mean(), own.min(), own.max()))
        mean, lowest, highest = numbers
        yield [*(f"{level:.12g}" for level in chosen), str(len(own)), mean, spread, lowest, highest]


def _table(heads: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    return html_table([*map(escape, heads)], [[escape(cell or DASH) for cell in row] for row in rows])


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
    panel.set_ylabel(f"{response.name.replace('_', ' ')} [{response.unit}]")
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
