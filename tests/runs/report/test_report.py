"""The report: one self-contained file in which simulated data is marked."""

from __future__ import annotations

import base64
import csv
import dataclasses
import re
import resource
import signal
from html.parser import HTMLParser
from pathlib import Path
from types import SimpleNamespace
from typing import Any
from xml.etree import ElementTree as ET

import matplotlib as mpl
import numpy as np
import pytest
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

import runs
import tests.support.synthetic_runs as made_up
from runs.archive.writer import finalise
from runs.export.exporters import ExportError
from runs.journal.journal import JournalWriter
from runs.records import DetectionStatus, Event, Level, RunFooter, Status
from runs.report import colours, drawing, figure_export, figure_specifications, pictures, reference_figure
from runs.report import page as report
from runs.report.comparison import by_axis, by_model
from runs.report.drawing import STYLE
from runs.report.figures import pressures, steps
from runs.summary import settled_steps, summarise

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


def test_every_figure_is_a_sound_drawing_with_ids_of_its_own(text: str) -> None:
    drawings = re.findall(r"<svg(?! viewBox).*?</svg>", text, re.DOTALL)
    assert len(drawings) == 7
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


def test_a_run_cut_off_between_a_frame_and_its_estimate_has_a_report(tmp_path: Path) -> None:
    path = made_up.write_cut_off_while_adapting(tmp_path / "adapting.mcap")
    page = Page(report.write(finalise(path)).read_text(encoding="utf-8"))
    assert "Parameters estimated online" in "".join(page.text)


def test_a_long_run_is_drawn_with_few_points_and_keeps_its_extremes(tmp_path: Path) -> None:
    from runs.report.drawing import POINTS, decimated

    x = np.arange(200_000) / 200
    y = np.sin(x)
    y[123_456], y[7] = 9.0, -9.0
    few_x, few_y = decimated(x, y)
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


def test_only_figures_with_data_are_drawn(archive: Path, short: Path) -> None:
    run, brief = runs.open(archive), runs.open(short)
    everything = ["pressures", "trajectory", "backbones", "steps", "tip", "error", "timing"]
    assert [figure.name for figure in figure_specifications.figure_specifications(run, summarise(run))] == everything
    assert [figure.name for figure in figure_specifications.figure_specifications(brief, summarise(brief))] == [
        "pressures",
        "timing",
    ]


def test_a_spatial_motion_is_drawn_from_two_sides(archive: Path) -> None:
    run = runs.open(archive)
    turn = np.linspace(0, 2 * np.pi, len(run.tip.time_s))
    circle = np.column_stack((20 * np.cos(turn), 20 * np.sin(turn), 170 + 0 * turn))
    run.tip = run.tip.replaced(measured_mm=circle, model_mm=circle + 1.0)
    found = summarise(run)
    assert np.isnan(found.plane_deg)
    (specification,) = [
        one for one in figure_specifications.figure_specifications(run, found) if one.name == "trajectory"
    ]
    figure = Figure(figsize=specification.size)
    specification.draw(figure, run, found)
    assert [(axes.get_xlabel(), axes.get_ylabel()) for axes in figure.axes] == [
        ("x [mm]", "y [mm]"),
        ("x [mm]", "z, along the arm [mm]"),
    ]
    for axes in figure.axes:
        low, high = sorted(axes.get_xlim())
        assert low < -20 < 21 < high
    run.tip = run.tip.replaced(measured_mm=circle[:1] + 0 * circle, model_mm=circle[:1] + 0 * circle)
    assert "trajectory" not in [
        figure.name for figure in figure_specifications.figure_specifications(run, summarise(run))
    ]


def test_measurements_without_model_and_set_points_are_drawn_without_them(archive: Path) -> None:
    run = runs.open(archive)
    nothing = np.full_like(run.tip.model_mm, np.nan)
    run.header = dataclasses.replace(run.header, executor="imported")
    run.tip = run.tip.replaced(model_mm=nothing, error_mm=nothing[:, 0])
    run.pressure = run.pressure.replaced(setpoint_bar=np.full_like(run.pressure.setpoint_bar, np.nan))
    run.timing = run.timing.replaced(lateness_us=np.zeros_like(run.timing.lateness_us))
    run.simulated = run.backbone = None
    found = summarise(run)
    assert found.plane_deg == pytest.approx(0.0, abs=1.0)
    shown = list(figure_specifications.figure_specifications(run, found))
    assert [figure.name for figure in shown] == ["pressures", "trajectory", "tip"]
    for specification in shown:
        figure = Figure(figsize=specification.size)
        specification.draw(figure, run, found)
        for axes in figure.axes:
            assert axes.has_data()
            legend = axes.get_legend()
            labels = [text.get_text() for text in legend.get_texts()] if legend else []
            assert not [label for label in labels if "model" in label or "set-point" in label]
    assert "Timing of the control loop" not in report.page([run])


@pytest.mark.parametrize(("kind", "begins"), [("pdf", b"%PDF"), ("png", b"\x89PNG"), ("svg", b"<?xml")])
def test_figures_can_be_exported_as_files(short: Path, tmp_path: Path, kind: str, begins: bytes) -> None:
    written = figure_export.write([short], tmp_path / "figures", kind)
    assert [path.name for path in written] == [f"short-{name}.{kind}" for name in ("pressures", "timing", "pictures")]
    assert all(path.read_bytes().startswith(begins) for path in written)
    # Text that can be searched shows the mark of a simulated run.
    assert runs.open(short).header.simulated
    if kind == "svg":
        assert all(">simulated</text>" in path.read_text(encoding="utf-8") for path in written)


def test_the_data_of_a_figure_lie_beside_it(archive: Path, tmp_path: Path) -> None:
    written = figure_export.write([archive], tmp_path, "svg")
    assert {path.with_suffix(".csv") for path in written} == set(tmp_path.glob("*.csv"))
    figure = next(path for path in written if path.stem.endswith("-tip"))
    rows = list(csv.reader(figure.with_suffix(".csv").read_text().splitlines()))
    head, *points = rows
    table = [dict(zip(head, row, strict=True)) for row in points]
    drawn = np.array([float(row["y"]) for row in table if (row["panel"], row["label"]) == ("1", "measured, 95 % band")])
    measured = runs.open(archive).tip.measured_mm[:, 0]
    np.testing.assert_allclose(drawn[np.isfinite(drawn)], measured[np.isfinite(measured)])


def test_figures_for_print_are_as_wide_as_a_column_with_every_word_inside(
    archive: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    drawn: list[Figure] = []
    keep = figure_export.drawing.figure_data.write
    monkeypatch.setattr(
        "runs.report.figure_data.write", lambda figure, path: (drawn.append(figure), keep(figure, path))[0]
    )
    written = figure_export.write([archive], tmp_path)
    for path, figure in zip(written, drawn, strict=True):
        box = re.search(rb"/MediaBox \[ 0 0 ([\d.]+) ", path.read_bytes())
        assert box is not None
        assert float(box[1]) == pytest.approx(88 / 25.4 * 72, abs=0.1)
        for axes in figure.axes:
            if (legend := axes.get_legend()) is not None:
                extent = legend.get_window_extent()
                assert extent.x1 <= figure.bbox.width
                assert extent.y1 <= figure.bbox.height


@pytest.mark.parametrize("width_mm", [5.0, 4000.0, float("nan")])
def test_figures_of_an_absurd_width_are_refused(archive: Path, tmp_path: Path, width_mm: float) -> None:
    with pytest.raises(ExportError, match="60 to 300 mm"):
        figure_export.write([archive], tmp_path, width_mm=width_mm)


def test_the_data_beside_a_figure_have_its_bars_and_error_bars(tmp_path: Path) -> None:
    def draw(figure: Figure) -> None:
        axes = figure.subplots()
        axes.errorbar([1.0, 2.0], [3.0, 4.0], [0.5, 0.25], fmt="o", capsize=2, label="measured")
        axes.bar([1.0, 2.0], [5.0, 6.0], label="error")
        axes.fill_between([0.0, 1.0], [0.0, 1.0], [2.0, 3.0], label="band")

    drawing.save(draw, (3.0, 2.0), tmp_path / "one.svg")
    with (tmp_path / "one.csv").open(newline="") as file:
        rows = list(csv.DictReader(file))
    found = {kind: [row for row in rows if row["kind"] == kind] for kind in ("error bar", "bar", "band", "line")}
    bars = [tuple(float(row[name]) for name in ("x", "y", "low", "high")) for row in found["error bar"]]
    assert bars == [(1.0, 3.0, 2.5, 3.5), (2.0, 4.0, 3.75, 4.25)]
    assert [(float(row["x"]), float(row["y"])) for row in found["bar"]] == [(1.0, 5.0), (2.0, 6.0)]
    assert {(float(row["x"]), float(row["y"])) for row in found["band"]} == {(0, 0), (1, 1), (0, 2), (1, 3)}
    assert not found["line"]


def test_z_points_down_in_the_figure_of_a_path_in_a_vertical_plane(archive: Path) -> None:
    tip = runs.open(archive).tip
    phase = np.linspace(0.0, 6.0, len(tip.time_s))
    circle = np.column_stack((10 * np.cos(phase), 0 * phase, 170 + 10 * np.sin(phase)))
    path = SimpleNamespace(reference_mm=circle, predicted_mm=circle, period=np.ones(len(phase)), error_mm=0 * phase)
    figure = Figure()
    run: Any = SimpleNamespace(reference=path, tip=tip, simulated=None)
    reference_figure.draw(figure, run, summarise(runs.open(archive)))
    assert figure.axes[0].yaxis_inverted()


def test_a_settled_tip_that_rises_is_drawn_upwards(archive: Path) -> None:
    run = runs.open(archive)
    found = summarise(run)
    rising = [dataclasses.replace(s, measured_mm=(0.0, 0.0, 200.0 - 5 * k)) for k, s in enumerate(found.steps)]
    figure = Figure()
    steps(figure, run, dataclasses.replace(found, steps=tuple(rising)))
    axes = figure.axes[0]
    marks = next(one for one in axes.containers if str(one.get_label()).endswith("z (up)"))
    drawn = np.asarray(marks[0].get_ydata(), float)
    assert len(drawn) > 1
    assert (np.diff(drawn) > 0).all()
    assert not axes.yaxis_inverted()


def test_figures_of_an_unknown_kind_are_refused(archive: Path, tmp_path: Path) -> None:
    with pytest.raises(ExportError, match="there are pdf, png, svg"):
        figure_export.write([archive], tmp_path, "doc")


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
    assert cells[1][:4] == ["stairs (simulated)", "inhomogeneous+rpe", "0.3269", "1.7349"]
    assert cells[1][4:] == ["other (simulated)", "homogeneous", "0.8019", "1.6247"]


def test_runs_of_one_protocol_and_model_have_different_labels(archive: Path, short: Path) -> None:
    first, second = runs.open(archive), runs.open(short)
    found = dataclasses.replace(summarise(first), rmse_mm=(1.7, 0.1, 0.3))
    cells = re.findall(r"<td>([^<]*)</td>", by_axis([first, second], [found] * 2))
    assert cells[::2] == ["run (simulated)", "short (simulated)"]


def test_steps_are_counted_in_whole_numbers(archive: Path) -> None:
    run = runs.open(archive)
    found = summarise(run)
    level = found.steps[0].level_bar
    found = dataclasses.replace(found, steps=tuple(dataclasses.replace(step, level_bar=level) for step in found.steps))
    figure = Figure(figsize=(9, 3.6))
    steps(figure, run, found)
    for axes in figure.axes:
        assert axes.get_xlabel() == "step"
        assert (axes.get_xticks() % 1 == 0).all()


@pytest.mark.parametrize("moved_mm", [0.1, 30.0])
def test_the_caption_of_errors_is_that_of_their_axis(
    archive: Path, monkeypatch: pytest.MonkeyPatch, moved_mm: float
) -> None:
    run = runs.open(archive)
    found = summarise(run)
    distances = np.full(len(settled_steps(found.steps)), moved_mm)
    monkeypatch.setattr("runs.report.figures.from_rest_mm", lambda *_: distances)
    figure = Figure(figsize=(9, 3.6))
    steps(figure, run, found)
    (specification,) = [one for one in figure_specifications.figure_specifications(run, found) if one.name == "steps"]
    normalised = figure.axes[1].get_ylabel().endswith("[%]")
    assert normalised is (moved_mm > 1)
    assert ("rest without pressure" in specification.caption) is normalised


@pytest.mark.parametrize("actuators", [1, 6, 12])
def test_the_names_of_any_number_of_actuators_stand_inside_the_figure(archive: Path, actuators: int) -> None:
    run = runs.open(archive)
    bar = np.tile(run.pressure.setpoint_bar[:, :1], (1, actuators))
    run.pressure = run.pressure.replaced(setpoint_bar=bar, measured_bar=bar + 0.001)
    figure = Figure(figsize=(9, 4.1))
    canvas = FigureCanvasAgg(figure)
    with mpl.rc_context(STYLE):
        pressures(figure, run, summarise(runs.open(archive)))
    shown = figure.axes[0].get_legend()
    assert shown is not None
    assert len(shown.get_texts()) == actuators + 1
    box = shown.get_window_extent(canvas.get_renderer())
    assert figure.bbox.x0 <= box.x0 <= box.x1 <= figure.bbox.x1
    assert figure.bbox.y0 <= box.y0 <= box.y1 <= figure.bbox.y1


def test_means_do_not_mix_measured_and_simulated_runs(archive: Path) -> None:
    run = runs.open(archive)
    simulated, measured = (
        dataclasses.replace(summarise(run), normalised_percent=percent, simulated=mark)
        for percent, mark in ((2.0, True), (4.0, False))
    )
    cells = re.findall(r"<td class=n>([^<]*)</td>", by_model([run] * 3, [simulated, measured, measured]))
    assert cells == ["4.00", "2", "2.00", "1 (simulated)"]


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
