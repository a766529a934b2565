"""The report: one file, whole in itself, honest about what was simulated."""

from __future__ import annotations

import base64
import dataclasses
import re
from html.parser import HTMLParser
from pathlib import Path
from xml.etree import ElementTree as ET

import numpy as np
import pytest
import runs_made_up as made_up

import runs
from runs import plates, report
from runs.archive import finalise
from runs.journal import JournalWriter
from runs.records import Event, Level, RunFooter, Seen, Status
from runs.summary import summarise

VOID = {"meta", "img", "br", "input", "link"}


class Page(HTMLParser):
    """Checks that every element is closed, and collects what would be loaded."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.open: list[str] = []
        self.loaded: list[str] = []
        self.text: list[str] = []
        self.feed(text)
        assert self.open == []

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        if tag not in VOID:
            self.open.append(tag)
        self.loaded += [value or "" for name, value in attrs if name in ("src", "href", "xlink:href", "data")]

    def handle_startendtag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.loaded += [value or "" for name, value in attrs if name in ("src", "href", "xlink:href", "data")]

    def handle_endtag(self, tag: str) -> None:
        assert self.open.pop() == tag

    def handle_data(self, data: str) -> None:
        self.text.append(data)


@pytest.fixture(scope="module")
def archive(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("report") / "run.mcap"
    made_up.write_journal(path)
    return finalise(path)


@pytest.fixture(scope="module")
def short(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A run so short that no camera frame was seen."""
    path = tmp_path_factory.mktemp("report") / "short.mcap"
    made_up.write_journal(path, duration_s=0.03)
    return finalise(path)


@pytest.fixture(scope="module")
def text(archive: Path) -> str:
    return report.write(archive).read_text(encoding="utf-8")


def test_it_stands_beside_the_archive(archive: Path, text: str) -> None:
    assert archive.with_suffix(".html").exists()
    assert not list(archive.parent.glob("*.part"))
    assert text.startswith("<!doctype html>")


def test_nothing_is_loaded_from_elsewhere(text: str) -> None:
    page = Page(text)
    assert [src for src in page.loaded if not src.startswith(("data:", "#"))] == []
    assert "url(http" not in text
    assert "@import" not in text
    assert "<script" not in text


def test_every_figure_is_a_sound_drawing_with_ids_of_its_own(text: str) -> None:
    drawings = re.findall(r"<svg.*?</svg>", text, re.DOTALL)
    assert len(drawings) == 6
    ids: list[str] = []
    for drawing in drawings:
        root = ET.fromstring(drawing)
        assert root.attrib["aria-label"]
        ids += re.findall(r'<(?:clipPath|path) id="([^"]+)"', drawing)
    assert len(ids) == len(set(ids)), "figures on one page share their ids"


def test_it_says_what_was_simulated(text: str, tmp_path: Path) -> None:
    assert "This run was simulated." in text
    made_up.write_journal(tmp_path / "real.mcap", duration_s=0.1, simulated=False)
    real = report.write(finalise(tmp_path / "real.mcap")).read_text(encoding="utf-8")
    assert "simulated" not in re.sub(r"<style>.*?</style>", "", real, flags=re.DOTALL)


def test_it_tells_how_the_run_was_made(archive: Path, text: str) -> None:
    shown = " ".join(Page(text).text)
    for said in ("finished", "A. Tester", "rig run stairs --fast", "0123abc", "seed 7", "numpy", "# µ and ° survive"):
        assert said in shown
    assert runs.open(archive).sha256 in shown
    assert "289142" in shown


def test_the_pictures_are_inside(text: str) -> None:
    data = re.findall(r'src="data:image/jpeg;base64,([^"]+)"', text)
    assert len(data) == 4
    assert base64.b64decode(data[0]) == made_up.picture(0).data


def test_the_same_archive_gives_the_same_report(archive: Path, text: str) -> None:
    assert report.page([runs.open(archive)]) == text


def test_what_the_operator_writes_is_shown_and_not_run(tmp_path: Path) -> None:
    path = tmp_path / "odd.mcap"
    bad = '<script>alert("x")</script>&amp;'
    header = dataclasses.replace(
        made_up.header("odd"), title=bad, notes=bad, operator=bad, protocol_yaml=bad, git_diff=bad, host=bad
    )
    writer = JournalWriter(path, header)
    writer.event(Event(made_up.START_NS, Level.FAULT, bad, bad))
    writer.close(RunFooter(made_up.START_NS, Status.ABORTED, bad))
    text = report.write(finalise(path)).read_text(encoding="utf-8")
    assert "<script" not in text
    assert bad in "".join(Page(text).text)


@pytest.mark.parametrize("seconds", [0.0, 0.05])
def test_a_run_of_any_length_has_a_report(tmp_path: Path, seconds: float) -> None:
    made_up.write_journal(tmp_path / "a.mcap", duration_s=seconds)
    Page(report.write(finalise(tmp_path / "a.mcap")).read_text(encoding="utf-8"))


def test_a_run_that_never_saw_its_tip_has_a_report(tmp_path: Path) -> None:
    path = tmp_path / "blind.mcap"
    rows = made_up.observations(3.0)
    rows["seen"] = Seen.NO_BOARD
    rows["measured_m"] = rows["covariance_m2"] = np.nan
    writer = JournalWriter(path, made_up.header("blind"))
    writer.observations(rows)
    writer.close(RunFooter(made_up.START_NS, Status.FINISHED, ""))
    Page(report.write(finalise(path)).read_text(encoding="utf-8"))


def test_a_long_run_is_drawn_with_few_points_and_keeps_its_extremes(tmp_path: Path) -> None:
    from runs.figures import POINTS, thin

    x = np.arange(200_000) / 200
    y = np.sin(x)
    y[123_456], y[7] = 9.0, -9.0
    few_x, few_y = thin(x, y)
    assert len(few_x) <= 2 * POINTS
    assert (few_y.max(), few_y.min()) == (9.0, -9.0)
    assert (few_x[0], few_x[-1]) == (x[0], x[-1])
    assert (np.diff(few_x) > 0).all()


def test_several_runs_stand_side_by_side(short: Path, tmp_path: Path) -> None:
    made_up.write_journal(tmp_path / "second.mcap", duration_s=0.2, simulated=False)
    out = report.write([short, finalise(tmp_path / "second.mcap")], tmp_path / "both.html")
    text = out.read_text(encoding="utf-8")
    page = Page(text)
    assert "2 runs" in page.text
    assert {"short", "second"} <= set(page.text)
    ids = re.findall(r'<(?:clipPath|path) id="([^"]+)"', text)
    assert len(ids) == len(set(ids))
    assert "nothing here was measured" in text


def test_a_run_has_the_figures_that_it_has_data_for(archive: Path, short: Path) -> None:
    run, brief = runs.open(archive), runs.open(short)
    everything = ["pressures", "trajectory", "steps", "tip", "error", "timing"]
    assert [plate.name for plate in plates.plates(run, summarise(run))] == everything
    assert [plate.name for plate in plates.plates(brief, summarise(brief))] == ["pressures", "timing"]


@pytest.mark.parametrize(("kind", "begins"), [("pdf", b"%PDF"), ("png", b"\x89PNG"), ("svg", b"<?xml")])
def test_figures_can_be_had_as_files_for_a_paper(short: Path, tmp_path: Path, kind: str, begins: bytes) -> None:
    written = plates.write(short, tmp_path / "figures", kind)
    assert [path.name for path in written] == [f"short-pressures.{kind}", f"short-timing.{kind}"]
    assert all(path.read_bytes().startswith(begins) for path in written)


def test_figures_of_an_unknown_kind_are_refused(archive: Path, tmp_path: Path) -> None:
    with pytest.raises(ValueError, match="there are pdf, png, svg"):
        plates.write(archive, tmp_path, "doc")
