"""Frames that are missing: counted, stated, and not bridged by a curve."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from matplotlib.figure import Figure
from rich.console import Console

import runs
import tests.support.synthetic_runs as made_up
from rig.cli.archive_output import summary_table
from runs.archive.writer import finalise
from runs.journal.journal import JournalWriter
from runs.records import PlayedSegment, RunFooter, Status
from runs.report import comparison, figures, gaps
from runs.report.drawing import POINTS, decimated_indices, path_indices
from runs.run import Run
from runs.summary import summarise


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> Run:
    """A dwell and a sine of 4 s, in which 16 frames are dropped, and a stretch of cycles is lost."""
    played = (
        PlayedSegment(0.0, 2.0, "dwell", "rest", (5000.0, 0.0, 0.0)),
        PlayedSegment(2.0, 4.0, "sine", "", (5000.0, 0.0, 0.0)),
    )
    path = tmp_path_factory.mktemp("gaps") / "run.mcap"
    writer = JournalWriter(path, replace(made_up.header("run", 4.0), intervals=played))
    cycles, frames = made_up.samples(4.0), made_up.observations(4.0)
    frames["dropped"] = 0
    frames["dropped"][66] = 16
    writer.samples(np.delete(cycles, slice(300, 400)))
    writer.observations(np.delete(frames, slice(50, 66)))
    writer.close(RunFooter(made_up.START_NS + 4_000_000_000, Status.FINISHED, "", {"dropped_frames": 16}))
    return runs.open(finalise(path))


def lines(figure: Figure) -> dict[str, np.ndarray]:
    """The drawn lines (n, 2) by name."""
    return {str(line.get_label()): np.asarray(line.get_xydata()) for axes in figure.axes for line in axes.lines}


def is_bridged(line: np.ndarray, low_s: float, high_s: float) -> bool:
    """Tell whether two neighbours on a line over time stand on either side of a gap."""
    both = np.isfinite(line).all(axis=1)
    return bool((both[:-1] & both[1:] & (line[:-1, 0] < low_s) & (line[1:, 0] > high_s)).any())


def shown(run: Run) -> str:
    console = Console(width=120)
    with console.capture() as printed:
        console.print(summary_table(summarise(run), {}))
    return printed.get()


def test_dropped_frames_are_expected_and_stated(run: Run) -> None:
    found = summarise(run)
    assert (found.frames_measured, found.frames, found.frames_dropped, found.frames_expected) == (102, 104, 16, 120)
    assert found.measured_fraction == pytest.approx(102 / 120)
    words = shown(run).split()
    assert "frames measured 102 of 120" in " ".join(words)
    assert "frames dropped 16" in " ".join(words)


def test_every_segment_has_its_error(run: Run) -> None:
    rows = [line.split() for line in shown(run).splitlines()]
    by_name = {row[0]: row for row in rows if row}
    assert float(by_name["sine"][1]) == pytest.approx(summarise(run).steps[1].error_mm, abs=0.006)
    assert float(by_name["rest"][1]) > 0


@pytest.mark.parametrize("draw", [figures.coordinates, figures.error])
def test_no_curve_bridges_dropped_frames(run: Run, draw: object) -> None:
    figure = Figure(figsize=(9, 6))
    draw(figure, run, summarise(run))  # type: ignore[operator]
    before, after = run.tip.time_s[49], run.tip.time_s[50]
    drawn = {name: line for name, line in lines(figure).items() if len(line) > 20}
    assert len(drawn) >= 2
    assert not [name for name, line in drawn.items() if is_bridged(line, before + 1e-6, after - 1e-6)]


def test_no_path_bridges_dropped_frames(run: Run) -> None:
    figure = Figure(figsize=(9, 6))
    figures.around(figure, run, summarise(run))
    model = lines(figure)["model"]
    assert np.isnan(model[50]).all()
    assert np.isfinite(model[[49, 51]]).all()


def test_no_curve_of_several_runs_bridges_dropped_frames(run: Run) -> None:
    figure = Figure(figsize=(9, 6))
    comparison.errors(figure, [run], [summarise(run)])
    (line,) = lines(figure).values()
    assert np.isnan(line[50, 1])


def test_no_pressure_bridges_lost_cycles(run: Run) -> None:
    figure = Figure(figsize=(9, 6))
    figures.pressures(figure, run, summarise(run))
    assert not is_bridged(lines(figure)["actuator 1"], 1.4999, 1.9999)


def test_a_gap_survives_decimation() -> None:
    y = np.sin(np.linspace(0, 9, 20 * POINTS))
    y[7777] = np.nan
    assert 7777 in decimated_indices(y)
    assert 7777 in path_indices(np.column_stack((y, y)))
    assert len(decimated_indices(y)) < 5 * POINTS


def test_even_rows_have_no_gaps() -> None:
    time = np.arange(100) / 30
    assert len(gaps.after_gaps(time)) == 0
    assert len(gaps.after_gaps(time[:1])) == len(gaps.after_gaps(time[:0])) == 0
    assert gaps.after_gaps(np.delete(time, slice(40, 50))).tolist() == [40]
