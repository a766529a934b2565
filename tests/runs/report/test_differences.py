"""What a comparison shows of the difference between runs."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from pathlib import Path

import matplotlib.colors
import numpy as np
import pytest
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

import runs
from runs.archive.writer import finalise
from runs.records import Quantity
from runs.report import comparison, page
from runs.report.colours import RUNS
from runs.report.differences import of_equal_steps, tips_at_equal_times
from runs.report.settings import differing
from runs.run import Run
from tests.support import synthetic_runs

pytestmark = pytest.mark.slow


@pytest.fixture
def pair(tmp_path: Path) -> list[Run]:
    for name in ("one", "two"):
        synthetic_runs.write_journal(tmp_path / f"{name}.mcap", duration_s=1.0, pictures=0)
    return [runs.open(finalise(tmp_path / f"{name}.mcap")) for name in ("one", "two")]


def test_only_settings_that_differ_are_listed_with_the_value_of_each_run(pair: list[Run]) -> None:
    assert differing(pair) == {}
    peaks = [(Quantity("protocol", "peak", (bar,), "bar", ""),) for bar in (0.2, 0.4)]
    for run, quantities in zip(pair, peaks, strict=True):
        run.header = dataclasses.replace(run.header, quantities=quantities)
    pair[1].header = dataclasses.replace(pair[1].header, metadata={"specimen": "A7"})
    assert differing(pair) == {"protocol peak [bar]": ("0.2", "0.4"), "metadata specimen": ("", "A7")}
    text = page.page(pair)
    assert "<td>protocol peak [bar]</td><td>0.2</td><td>0.4</td>" in text


def test_settings_of_the_rig_file_are_compared_one_by_one(pair: list[Run]) -> None:
    for run, text in zip(pair, ("limits: {tracking_s: 1}\n", "# slower\nlimits: {tracking_s: 2}\n"), strict=True):
        run.header = dataclasses.replace(run.header, rig_yaml=text)
    assert differing(pair) == {"rig limits tracking_s": ("1", "2")}
    texts = ("valves: [{channel: 0}, {channel: 1}]", "valves: [{channel: 0}, {channel: 2}]")
    for run, text in zip(pair, texts, strict=True):
        run.header = dataclasses.replace(run.header, rig_yaml=text)
    assert differing(pair) == {"rig valves 2 channel": ("1", "2")}


def test_tips_are_compared_at_equal_protocol_times(pair: list[Run]) -> None:
    time_s, tips = tips_at_equal_times(pair)
    assert len(time_s) > 10
    np.testing.assert_allclose(tips[0], tips[1])


@pytest.mark.parametrize("draw", [comparison.tips, comparison.errors])
def test_the_curves_of_equal_runs_are_all_visible(pair: list[Run], draw: Callable[..., None]) -> None:
    figure = Figure(figsize=(9, 4), dpi=200)
    draw(figure, pair, [run.summary for run in pair])
    for axes in figure.axes:
        axes.get_legend().remove()
    canvas = FigureCanvasAgg(figure)
    canvas.draw()
    pixels = np.asarray(canvas.buffer_rgba())[..., :3].astype(int)
    counts = [
        (np.abs(pixels - np.multiply(255, matplotlib.colors.to_rgb(colour))).max(axis=-1) < 30).sum()
        for colour in RUNS[:2]
    ]
    assert min(counts) > 0.3 * max(counts)


@pytest.mark.parametrize("draw", [comparison.tips, comparison.errors])
def test_the_curves_of_many_equal_runs_are_all_visible(pair: list[Run], draw: Callable[..., None]) -> None:
    many = [pair[0]] * 9
    figure = Figure(figsize=comparison.comparison_figures(many, [run.summary for run in many])[0].size, dpi=200)
    draw(figure, many, [run.summary for run in many])
    limits = {(axes.get_xlim(), axes.get_ylim()) for axes in figure.axes}
    assert len(limits) == 1
    for axes in figure.axes:
        axes.get_legend().remove()
    canvas = FigureCanvasAgg(figure)
    canvas.draw()
    pixels = np.asarray(canvas.buffer_rgba())[..., :3].astype(int)
    for colour in RUNS:
        seen = np.abs(pixels - np.multiply(255, matplotlib.colors.to_rgb(colour))).max(axis=-1) < 30
        assert seen.sum() > 1000, colour


def test_tips_of_other_steps_have_no_distance(pair: list[Run]) -> None:
    first, second = pair
    second.header = dataclasses.replace(second.header, intervals=second.header.intervals[:-1])
    assert of_equal_steps(pair) == (first,)
    assert "Distance between the tips" not in page.page(pair)


def test_a_comparison_repeats_no_whole_report(pair: list[Run]) -> None:
    text = page.page(pair)
    assert "Repeatability" in text
    assert "Distance between the tips" in text
    assert "How it was made" not in text
    assert "How it was made" in page.page(pair[:1])
