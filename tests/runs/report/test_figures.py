"""The figures of a report: which are drawn, what they show, and their files."""

from __future__ import annotations

import csv
import dataclasses
import re
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import matplotlib as mpl
import numpy as np
import pytest
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

import runs
from runs.export.exporters import ExportError
from runs.report import drawing, figure_export, figure_specifications, further_figures
from runs.report import page as report
from runs.report.drawing import STYLE
from runs.report.figures import pressures, steps, timing
from runs.run import Run
from runs.summary import settled_steps, summarise

MEASURED = ("pressures", "trajectory", "tip", "timing")
MODELLED = ("backbones", "steps", "error")
OF_OTHER_RUNS = ("inputs", "sections", "reference", "adaptation")
"""Figures for which the archive of these tests has no data."""


def names(run: Run) -> list[str]:
    """The figures of a run, in the order of the page."""
    return [figure.name for figure in figure_specifications.figure_specifications(run, summarise(run))]


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


def test_only_figures_with_data_are_drawn(archive: Path, short: Path) -> None:
    drawn, drawn_of_brief = names(runs.open(archive)), names(runs.open(short))
    assert set(drawn).issuperset((*MEASURED, *MODELLED))
    assert set(drawn).isdisjoint(OF_OTHER_RUNS)
    assert drawn.index("pressures") < drawn.index("tip") < drawn.index("timing")
    assert set(drawn_of_brief).issuperset(("pressures", "timing"))
    assert set(drawn_of_brief).isdisjoint(("trajectory", "tip", *MODELLED, *OF_OTHER_RUNS))


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
    assert "trajectory" not in names(run)


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
    shown_names = {figure.name for figure in shown}
    assert shown_names.issuperset(("pressures", "trajectory", "tip"))
    assert shown_names.isdisjoint(("timing", *MODELLED))
    for specification in shown:
        figure = Figure(figsize=specification.size)
        specification.draw(figure, run, found)
        for axes in figure.axes:
            assert axes.has_data()
            legend = axes.get_legend()
            labels = [text.get_text() for text in legend.get_texts()] if legend else []
            assert not [label for label in labels if "model" in label or "set-point" in label]
    assert "Timing of the control loop" not in report.page([run])


@pytest.mark.slow
@pytest.mark.parametrize(("kind", "begins"), [("pdf", b"%PDF"), ("png", b"\x89PNG"), ("svg", b"<?xml")])
def test_figures_can_be_exported_as_files(short: Path, tmp_path: Path, kind: str, begins: bytes) -> None:
    written = figure_export.write([short], tmp_path / "figures", kind)
    exported = [*names(runs.open(short)), "pictures"]
    assert [path.name for path in written] == [f"short-{name}.{kind}" for name in exported]
    assert all(path.read_bytes().startswith(begins) for path in written)
    # Text that can be searched shows the mark of a simulated run.
    assert runs.open(short).header.simulated
    if kind == "svg":
        assert all(">simulated</text>" in path.read_text(encoding="utf-8") for path in written)


@pytest.mark.slow
def test_the_data_of_a_figure_lie_beside_it(archive: Path, tmp_path: Path) -> None:
    written = figure_export.write([archive], tmp_path, "svg")
    assert {path.with_suffix(".csv") for path in written} == set(tmp_path.glob("*.csv"))
    figure = next(path for path in written if path.stem.endswith("-tip"))
    rows = list(csv.reader(figure.with_suffix(".csv").read_text().splitlines()))
    head, *points = rows
    table = [dict(zip(head, row, strict=True)) for row in points]
    drawn = np.array([float(row["panel 1 line 1 (measured, 95 % band): x [mm]"] or np.nan) for row in table])
    measured = runs.open(archive).tip.measured_mm[:, 0]
    np.testing.assert_allclose(drawn[np.isfinite(drawn)], measured[np.isfinite(measured)], rtol=1e-6)


@pytest.mark.slow
def test_figures_for_print_are_as_wide_as_a_column_with_every_word_inside(
    archive: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    drawn: list[Figure] = []
    keep = figure_export.drawing.figure_data.write
    monkeypatch.setattr(
        "runs.report.figure_data.write", lambda figure, path, mark: (drawn.append(figure), keep(figure, path, mark))[0]
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

    drawing.save(draw, (3.0, 2.0), tmp_path / "one.svg", mark="simulated")
    with (tmp_path / "one.csv").open(newline="") as file:
        rows = list(csv.DictReader(file))
    assert {row["remark"] for row in rows} == {"simulated"}

    def points(curve: str, *names: str) -> list[tuple[float, ...]]:
        columns = [f"panel 1 {curve}: {name}" for name in names]
        return [tuple(float(row[name]) for name in columns) for row in rows if row[columns[0]]]

    assert points("error bar 1 (measured)", "x", "y", "low", "high") == [(1.0, 3.0, 2.5, 3.5), (2.0, 4.0, 3.75, 4.25)]
    assert points("bar 1 (error)", "x", "y") == [(1.0, 5.0), (2.0, 6.0)]
    assert set(points("band 1 (band)", "x", "y")) == {(0, 0), (1, 1), (0, 2), (1, 3)}
    assert not [name for name in rows[0] if " line " in name]


def test_z_points_down_in_the_figure_of_a_path_in_a_vertical_plane(archive: Path) -> None:
    tip = runs.open(archive).tip
    phase = np.linspace(0.0, 6.0, len(tip.time_s))
    circle = np.column_stack((10 * np.cos(phase), 0 * phase, 170 + 10 * np.sin(phase)))
    path = SimpleNamespace(reference_mm=circle, predicted_mm=circle, period=np.ones(len(phase)), error_mm=0 * phase)
    figure = Figure()
    run: Any = SimpleNamespace(reference=path, tip=tip, simulated=None)
    further_figures.reference(figure, run, summarise(runs.open(archive)))
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


@pytest.mark.filterwarnings("error")
def test_the_timing_of_a_run_of_one_cycle_is_drawn(archive: Path) -> None:
    run = runs.open(archive)
    first = slice(0, 1)
    run.timing = run.timing.replaced(
        time_s=run.timing.time_s[first], lateness_us=np.array([0.104]), overruns=run.timing.overruns[first]
    )
    timing(Figure(), run, summarise(run))
