"""The report: one self-contained file in which simulated data is marked."""

from __future__ import annotations

import base64
import dataclasses
import re
import resource
import signal
from html.parser import HTMLParser
from pathlib import Path
from xml.etree import ElementTree as ET

import numpy as np
import pytest

import runs
import tests.support.synthetic_runs as made_up
from runs.archive.writer import finalise
from runs.journal.journal import JournalWriter
from runs.records import DetectionStatus, Event, Level, RunFooter, Status
from runs.report import colours, figure_export, pictures
from runs.report import page as report
from runs.report.comparison import by_axis, by_model
from runs.report.figure_specifications import figure_specifications
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
def text(archive: Path) -> str:
    return report.write(archive).read_text(encoding="utf-8")


def test_the_report_is_written_beside_the_archive(archive: Path, text: str) -> None:
    assert archive.with_suffix(".html").exists()
    assert not list(archive.parent.glob("*.part"))
    assert text.startswith("<!doctype html>")


def test_nothing_is_loaded_from_elsewhere(text: str) -> None:
    page = Page(text)
    assert [src for src in page.loaded if not src.startswith(("data:", "#"))] == []
    assert "url(http" not in text
    assert "@import" not in text
    assert "<script" not in text


def test_every_figure_is_a_sound_drawing_with_ids_of_its_own(archive: Path, text: str) -> None:
    run = runs.open(archive)
    drawings = re.findall(r"<svg(?! viewBox).*?</svg>", text, re.DOTALL)
    assert len(drawings) == len(list(figure_specifications(run, summarise(run)))) > 0
    ids: list[str] = []
    for shown in drawings:
        root = ET.fromstring(shown)
        assert root.attrib["aria-label"]
        ids += re.findall(r'<(?:clipPath|path) id="([^"]+)"', shown)
    assert len(ids) == len(set(ids)), "figures on one page share their ids"


def test_the_report_marks_simulated_data(text: str, tmp_path: Path) -> None:
    assert "This run was simulated." in text
    made_up.write_journal(tmp_path / "real.mcap", duration_s=0.1, simulated=False)
    real = report.write(finalise(tmp_path / "real.mcap")).read_text(encoding="utf-8")
    assert "simulated" not in re.sub(r"<style>.*?</style>", "", real, flags=re.DOTALL)


def test_the_report_states_the_provenance(archive: Path, text: str) -> None:
    shown = " ".join(Page(text).text)
    for said in ("finished", "A. Tester", "rig run stairs --fast", "0123abc", "seed 7", "numpy", "# µ and ° survive"):
        assert said in shown
    assert runs.open(archive).sha256 in shown
    assert "289142" in shown


def test_the_pictures_are_inside(text: str) -> None:
    data = re.findall(r'href="data:image/jpeg;base64,([^"]+)"', text)
    stored = [made_up.picture(index).data for index in range(5)]
    assert data
    assert all(base64.b64decode(encoded) in stored for encoded in data)


def test_annotations_are_drawn_into_the_pictures(archive: Path, text: str) -> None:
    drawn = re.findall(r'<circle cx="([\d.]+)" cy="([\d.]+)"', text)
    for k in (moment.k for moment in pictures.moments(runs.open(archive), summarise(runs.open(archive)))):
        marks = made_up.marks(k)
        for u, v in (*marks.corners_px, *([marks.tip_px] if len(marks.corners_px) else [])):
            assert (f"{u:.2f}", f"{v:.2f}") in drawn


def test_only_the_boards_first_corner_is_drawn_filled_and_none_where_it_is_hidden(tmp_path: Path) -> None:
    path = tmp_path / "hidden.mcap"
    writer = JournalWriter(path, made_up.header("hidden", 1.0))
    writer.observations(made_up.observations(1.0))
    for index in range(2):
        shown = made_up.picture(index)
        corners = shown.marks.corners_px.copy()
        corners[0 if index else 1] = np.nan
        writer.picture(dataclasses.replace(shown, marks=dataclasses.replace(shown.marks, corners_px=corners)))
    writer.close(RunFooter(made_up.START_NS + 10**9, Status.FINISHED, ""))
    run = runs.open(finalise(path))
    filled = [pictures._overlay(run, k, 1.0).count(f'fill="{colours.BOARD}"') for k in range(2)]
    assert filled == [1, 0]


def test_pictures_show_the_ends_of_steps_the_largest_error_and_where_the_board_was_lost(tmp_path: Path) -> None:
    path = tmp_path / "run.mcap"
    header = made_up.header("run", 4.0)
    writer = JournalWriter(path, header)
    rows = made_up.observations(4.0)
    rows["seen"][90:100], rows["measured_m"][90:100] = DetectionStatus.NO_BOARD, np.nan
    rows["model_m"][50] += 0.004
    writer.samples(made_up.samples(4.0))
    writer.observations(rows)
    for index in range(40):
        shown = made_up.picture(index)
        writer.picture(
            dataclasses.replace(shown, t_ns=int(rows["t_ns"][3 * index]), frame=int(rows["frame"][3 * index]))
        )
    writer.close(RunFooter(made_up.START_NS + 4 * 10**9, Status.FINISHED, ""))
    run = runs.open(finalise(path))
    chosen = {moment.why: int(run.frames.index[moment.k]) for moment in pictures.moments(run, summarise(run))}
    assert chosen == {
        "end of step 1": 28,
        f"near the largest error ({np.nanmax(run.tip.error_mm):.2f} mm)": 52,
        "end of step 2": 58,
        "end of step 3": 88,
        "nothing measured (no board)": 91,
        "end of step 4": 118,
    }


def test_a_run_with_several_cameras_shows_every_view_of_a_moment(tmp_path: Path) -> None:
    path = tmp_path / "two.mcap"
    writer = JournalWriter(path, made_up.header("two", 1.0))
    writer.observations(made_up.observations(1.0))
    for index in range(5):
        for camera in ("front", "side"):
            writer.picture(dataclasses.replace(made_up.picture(index), camera=camera))
    writer.close(RunFooter(made_up.START_NS + 10**9, Status.FINISHED, ""))
    run = runs.open(finalise(path))
    chosen = [moment.k for moment in pictures.moments(run, summarise(run))]
    assert [run.frames.camera[k] for k in chosen] == ["front", "side"] * (len(chosen) // 2)
    Page(report.page([run]))


def test_the_same_archive_gives_the_same_report(archive: Path, text: str) -> None:
    assert report.page([runs.open(archive)]) == text


def test_text_of_the_operator_is_shown_and_not_executed(tmp_path: Path) -> None:
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


def test_a_title_sends_no_control_character_and_turns_no_text_round(tmp_path: Path) -> None:
    header = dataclasses.replace(made_up.header("odd"), title="a\x1b[2J \u202etxt.exe\u200d")
    writer = JournalWriter(tmp_path / "odd.mcap", header)
    writer.close(RunFooter(made_up.START_NS, Status.FINISHED, ""))
    text = report.write(finalise(writer.path)).read_text(encoding="utf-8")
    assert "a\\x1b[2J \\u202etxt.exe\u200d" in text
    assert not {"\x1b", "\u202e"} & set(text)


@pytest.mark.parametrize("seconds", [0.0, 0.05])
def test_a_run_of_any_length_has_a_report(tmp_path: Path, seconds: float) -> None:
    made_up.write_journal(tmp_path / "a.mcap", duration_s=seconds)
    Page(report.write(finalise(tmp_path / "a.mcap")).read_text(encoding="utf-8"))


def test_a_run_without_measured_tips_has_a_report(tmp_path: Path) -> None:
    path = tmp_path / "blind.mcap"
    rows = made_up.observations(3.0)
    rows["seen"] = DetectionStatus.NO_BOARD
    rows["measured_m"] = rows["covariance_m2"] = np.nan
    writer = JournalWriter(path, made_up.header("blind"))
    writer.observations(rows)
    writer.close(RunFooter(made_up.START_NS, Status.FINISHED, ""))
    Page(report.write(finalise(path)).read_text(encoding="utf-8"))


@pytest.mark.slow
def test_a_run_cut_off_between_a_frame_and_its_estimate_has_a_report(tmp_path: Path) -> None:
    path = made_up.write_cut_off_while_adapting(tmp_path / "adapting.mcap")
    page = Page(report.write(finalise(path)).read_text(encoding="utf-8"))
    assert "Parameters estimated online" in "".join(page.text)


def test_several_runs_stand_side_by_side(short: Path, tmp_path: Path) -> None:
    made_up.write_journal(tmp_path / "second.mcap", duration_s=0.2, simulated=False)
    out = report.write([short, finalise(tmp_path / "second.mcap")], tmp_path / "both.html")
    text = out.read_text(encoding="utf-8")
    page = Page(text)
    assert "2 runs" in page.text
    assert {"short", "second"} <= set(page.text)
    ids = re.findall(r'<(?:clipPath|path) id="([^"]+)"', text)
    assert len(ids) == len(set(ids))
    assert "short (simulated)" in text
    assert "second (simulated)" not in text


def test_several_runs_are_listed_in_the_form_of_the_papers_tables(archive: Path, tmp_path: Path) -> None:
    made_up.write_journal(tmp_path / "other.mcap", pictures=0)
    chosen = [runs.open(archive), runs.open(finalise(tmp_path / "other.mcap"))]
    chosen[1].header = dataclasses.replace(chosen[1].header, model_variant="homogeneous", protocol_name="other")
    summaries = [
        dataclasses.replace(summarise(run), normalised_percent=percent, rmse_mm=rmse)
        for run, percent, rmse in zip(chosen, (1.27, 17.2), ((1.7349, 0.1, 0.3269), (1.6247, 0.1, 0.8019)), strict=True)
    ]
    cells = [re.findall(r"<td[^>]*>([^<]*)</td>", table(chosen, summaries)) for table in (by_model, by_axis)]
    one = "1 (simulated)"
    assert cells[0] == ["\u2715", "\u2715", "17.20", one, "\u2714", "\u2714", "1.27", one]
    assert cells[1][:5] == ["stairs (simulated)", "inhomogeneous+rpe", "0.3269", "1.7349", "0.1000"]
    assert cells[1][5:] == ["other (simulated)", "homogeneous", "0.8019", "1.6247", "0.1000"]


def test_runs_of_one_protocol_and_model_have_different_labels(archive: Path, short: Path) -> None:
    first, second = runs.open(archive), runs.open(short)
    found = dataclasses.replace(summarise(first), rmse_mm=(1.7, 0.1, 0.3))
    cells = re.findall(r"<td>([^<]*)</td>", by_axis([first, second], [found] * 2))
    assert cells[::2] == ["run (simulated)", "short (simulated)"]


def test_means_do_not_mix_measured_and_simulated_runs(archive: Path) -> None:
    run = runs.open(archive)
    simulated, measured = (
        dataclasses.replace(summarise(run), normalised_percent=percent, simulated=mark)
        for percent, mark in ((2.0, True), (4.0, False))
    )
    cells = re.findall(r"<td class=n>([^<]*)</td>", by_model([run] * 3, [simulated, measured, measured]))
    assert cells == ["4.00", "2", "2.00", "1 (simulated)"]


@pytest.mark.slow
def test_several_runs_have_figures_that_compare_them(short: Path, tmp_path: Path) -> None:
    written = {path.stem for path in figure_export.write([short, short], tmp_path, "svg")}
    assert {"compared-tips", "compared-errors"} <= written


def test_a_report_that_does_not_fit_on_the_disk_leaves_no_file(tmp_path: Path) -> None:
    archive = finalise(made_up.write_journal(tmp_path / "run.mcap", duration_s=0.1).path)
    limits = resource.getrlimit(resource.RLIMIT_FSIZE)
    ignored = signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
    try:
        resource.setrlimit(resource.RLIMIT_FSIZE, (4096, limits[1]))
        with pytest.raises(OSError, match="File too large"):
            report.write(archive, tmp_path / "page.html")
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, limits)
        signal.signal(signal.SIGXFSZ, ignored)
    assert not list(tmp_path.glob("page.html*"))
