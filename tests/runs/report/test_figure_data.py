"""The CSV beside an exported figure."""

from __future__ import annotations

import csv
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

from runs.report import figure_data


def test_labels_hold_no_control_characters(tmp_path: Path) -> None:
    figure = Figure()
    axes = figure.add_subplot()
    axes.plot([0.0, 1.0], [1.0, 2.0], label="\x1b[31mload")
    axes.set_xlabel("\u202etime")
    axes.set_ylabel("\x07force")
    figure_data.write(figure, tmp_path / "load.csv")
    with (tmp_path / "load.csv").open(newline="") as file:
        head = next(csv.reader(file))
    curve = r"panel 1 line 1 (\x1b[31mload): "
    assert head == [curve + r"\u202etime", curve + r"\x07force", "remark"]


def test_panels_that_share_the_x_axis_all_have_its_label(tmp_path: Path) -> None:
    figure = Figure()
    upper, lower = figure.subplots(2, 1, sharex=True)
    upper.plot([0.0, 1.0], [1.0, 2.0])
    lower.plot([0.0, 1.0], [1.0, 2.0])
    lower.set_xlabel("time [s]")
    figure_data.write(figure, tmp_path / "load.csv")
    with (tmp_path / "load.csv").open(newline="") as file:
        head = next(csv.reader(file))
    assert [name for name in head if name.endswith(": time [s]")] == [
        "panel 1 line 1: time [s]",
        "panel 2 line 1: time [s]",
    ]


def test_a_gap_of_a_line_is_an_empty_cell() -> None:
    figure = Figure()
    figure.add_subplot().plot([0.0, 1.0, 2.0], [1.0, np.nan, 2.0])
    assert figure_data.table(figure, "simulated").splitlines()[1:] == ["0,1,simulated", "1,,simulated", "2,2,simulated"]
