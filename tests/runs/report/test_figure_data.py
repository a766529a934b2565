"""The CSV beside an exported figure."""

from __future__ import annotations

import csv
from pathlib import Path

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
        row = next(csv.DictReader(file))
    assert (row["label"], row["x_label"], row["y_label"]) == (r"\x1b[31mload", r"\u202etime", r"\x07force")


def test_panels_that_share_the_x_axis_all_have_its_label(tmp_path: Path) -> None:
    figure = Figure()
    upper, lower = figure.subplots(2, 1, sharex=True)
    upper.plot([0.0, 1.0], [1.0, 2.0])
    lower.plot([0.0, 1.0], [1.0, 2.0])
    lower.set_xlabel("time [s]")
    figure_data.write(figure, tmp_path / "load.csv")
    with (tmp_path / "load.csv").open(newline="") as file:
        assert {row["x_label"] for row in csv.DictReader(file)} == {"time [s]"}
