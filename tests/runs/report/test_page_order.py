"""The pages of reports: what stands first, what is folded, what each figure holds, how wide and long they are."""

from __future__ import annotations

import base64
import csv
import dataclasses
import re
from html.parser import HTMLParser
from pathlib import Path
from urllib.parse import unquote
from xml.etree import ElementTree as ET

import pytest

import runs
import tests.support.synthetic_runs as made_up
from runs.archive.writer import finalise
from runs.journal.journal import JournalWriter
from runs.records import RunFooter, Status
from runs.report import colours, comparison, html, overlay, page
from runs.report.figure_specifications import LEADING, figure_specifications
from runs.report.html import DASH
from runs.run import Run
from tests.support.browser import browsing
from tests.support.report_text import without_figures


class Outline(HTMLParser):
    """The elements of a page in their order, each with whether it is folded."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.depth = 0
        self.elements: list[tuple[str, bool]] = []
        self.feed(text)

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.depth += tag == "details"
        kind = dict(attrs).get("class") or ""
        self.elements.append((f"{tag}.{kind}" if kind else tag, self.depth > 0))

    def handle_endtag(self, tag: str) -> None:
        self.depth -= tag == "details"


@pytest.fixture(scope="module")
def text(archive: Path) -> str:
    return page.page([runs.open(archive)])


def finished_and_aborted(folder: Path) -> list[Run]:
    """Two runs of a protocol, the second of which was aborted."""
    chosen = []
    for name, status in (("whole", Status.FINISHED), ("cut", Status.ABORTED)):
        writer = JournalWriter(folder / f"{name}.mcap", made_up.header(name, 2.0))
        writer.samples(made_up.samples(2.0))
        writer.observations(made_up.observations(2.0))
        writer.close(RunFooter(made_up.START_NS + 2 * 10**9, status, ""))
        chosen.append(runs.open(finalise(writer.path)))
    return chosen


def test_the_conclusion_and_four_figures_stand_first_and_the_rest_is_folded(archive: Path, text: str) -> None:
    run = runs.open(archive)
    elements = Outline(text).elements
    figures = [folded for name, folded in elements if name == "figure.drawn"]
    assert figures == [False] * LEADING + [True] * (len(list(figure_specifications(run, run.summary))) - LEADING)
    names = [name for name, _ in elements]
    assert names.index("p.conclusion") < names.index("div.tiles") < names.index("figure.drawn") < names.index("details")
    assert all(folded for name, folded in elements if name.startswith(("table", "pre")))


def test_the_settings_of_a_run_stand_after_its_results(text: str) -> None:
    titles = re.findall(r"<summary>(.*?)</summary>", text)
    assert titles.index("All numbers") < titles.index("Segments") < titles.index("How it was made")
    assert titles.index("How it was made") < titles.index("Rig, verbatim")


def test_at_most_four_numbers_stand_out_and_all_are_in_the_table(archive: Path, text: str) -> None:
    summary = runs.open(archive).summary
    leading, every = page.leading_numbers(summary), page.all_numbers(summary)
    assert 0 < len(leading) <= 4 < len(every)
    assert not [value for value, _ in leading if DASH in value]
    assert len({name for name, _ in every}) == len(every)
    for name, value in every:
        assert f"<tr><th>{name}</th><td>{value}</td></tr>" in text


def test_every_figure_holds_itself_as_a_drawing_and_its_data(archive: Path, text: str) -> None:
    run = runs.open(archive)
    names = [f"{run.header.run_id}-{figure.name}" for figure in figure_specifications(run, run.summary)]
    drawings = dict(re.findall(r'download="([^"]+)\.svg" href="data:image/svg\+xml;base64,([^"]+)"', text))
    tables = dict(re.findall(r'download="([^"]+)\.csv" href="data:text/csv;charset=utf-8,([^"]+)"', text))
    assert list(drawings) == list(tables) == names
    for name in names:
        drawing = ET.fromstring(base64.b64decode(drawings[name]))
        assert drawing.tag.endswith("svg")
        assert "simulated" in "".join(drawing.itertext()), "a drawing leaves its page without the mark"
        rows = list(csv.DictReader(unquote(tables[name]).splitlines()))
        assert rows
        assert {row["remark"] for row in rows} == {"simulated"}


def test_the_page_has_a_dark_form_in_which_no_line_keeps_the_ink_of_the_light_one(text: str) -> None:
    dark = re.search(r"prefers-color-scheme: dark\) \{ :root \{(.*?)\}", text)
    assert dark is not None
    for name, (light, other) in colours.ON_PAGE.items():
        assert f"--{name}: {other};" in dark[1]
        assert light != other
    shown = re.findall(r'<svg role="img".*?</svg>', text, re.DOTALL)
    assert shown
    for drawing in shown:
        assert not [light for light, _ in colours.ON_PAGE.values() if light.lower() in drawing]
        assert "var(--ink)" in drawing


def test_the_scale_of_a_phase_ends_in_the_colour_in_which_it_begins() -> None:
    scale = colours.phases()
    assert scale(0.0) == pytest.approx(scale(1.0))
    assert colours.amounts()(0.0) != pytest.approx(colours.amounts()(1.0))


def test_a_run_that_did_not_finish_is_marked_in_every_table_and_counts_in_no_mean(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    without_figures(monkeypatch)
    chosen = finished_and_aborted(tmp_path)
    chosen[1].header = dataclasses.replace(chosen[1].header, seed=8)
    text = page.page(chosen)
    tables = re.findall(r"<table.*?</table>", text, re.DOTALL)
    naming = [table for table in tables if "cut" in table]
    assert len(naming) > 2
    assert all("cut (simulated) (aborted)" in table for table in naming)
    means = comparison.by_model(chosen, [run.summary for run in chosen])
    assert means == comparison.by_model(chosen[:1], [chosen[0].summary])
    assert "1 of 2 runs finished" in comparison.conclusion(chosen, [run.summary for run in chosen])


def test_the_settings_of_compared_runs_are_folded_at_the_end(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    without_figures(monkeypatch)
    text = page.page(finished_and_aborted(tmp_path))
    (errors, *_), titles = re.findall("<table", text), re.findall(r"<summary>(.*?)</summary>", text)
    assert titles[-1] == "Differing settings"
    assert text.index("conclusion") < text.index(errors) < text.index("<details>")


@pytest.mark.slow
def test_pages_fit_their_windows_and_twelve_runs_need_no_long_page(tmp_path: Path) -> None:
    whole, cut = finished_and_aborted(tmp_path)
    pages = {"one": page.page([whole]), "twelve": page.page([whole, cut] * 6)}
    with browsing() as browser:
        tab = browser.tab()
        for name, text in pages.items():
            file = tmp_path / f"{name}.html"
            file.write_text(text, encoding="utf-8")
            for width in (390, 1280, 1440):
                tab.size(width, 900)
                tab.go(file.as_uri())
                tab.until(f"document.readyState === 'complete' && location.href.endsWith('{name}.html')")
                assert tab.value("document.documentElement.scrollWidth") <= width
                if width == 1440:
                    cut_off = (
                        "[...document.querySelectorAll('.scroll')].filter(e => e.scrollWidth > e.clientWidth).length"
                    )
                    assert tab.value(cut_off) == 0
                    assert tab.value("document.documentElement.scrollHeight") < 3300


def test_many_runs_are_shown_in_panels_of_one_figure() -> None:
    assert overlay.panel_count(12) == 3
    width, height = overlay.size(12, 1.9)
    assert height < 1.2 * width
    assert html.figures([]) == ""
