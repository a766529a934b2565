"""Imports a text by a mapping, for the tests of `rig import`."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest

import runs
from protocols import BadInputError
from rig.importing import ImportResult, import_table
from runs.records import Level
from runs.run import Run

# Other columns, units, separators and conventions than the example's: gauge kPa, tip already seen from the base.
BENCH = """\
title: Two bellows on the lab bench
started: 2024-05-06T07:08:09+02:00
file: {delimiter: semicolon, decimal: comma, skip_lines: 2, lines_after_header: 1, comment: "%", missing: ["--"]}
time: {column: clock, unit: ms}
pressures: {columns: [right, left], unit: [kPa, mbar], reading: gauge}
setpoints: {columns: [want right, want left], unit: kPa}
valves: {columns: [valve], unit: mV}
weight: {column: load, unit: g}
tip: {position: {columns: [X, Y, Z], unit: [mm, mm, cm]}, uncertainty_mm: [0.1, 0.2, 0.3]}
"""
BENCH_CSV = """\
Bench 3, file 17

Z;clock;valve;want left;want right;left;right;X;Y;remark;load
cm;ms;mV;kPa;kPa;mbar;kPa;mm;mm;;g
16,5;1000,0;5000;10;20;99,5;20,25;1,5;-2,0;start;0
% the operator sneezed
16,25;1050,0;5250;10;20;100,5;20,5;2,5;-2,25;;0

--;1100,0;5500;10;20;101,0;20,75;--;;lost;100
"""

# The shortest mapping; columns by number.
SMALL = """\
title: Small
file: {first_column: 0, header: false}
time: {column: 0, unit: s}
pressures: {columns: [1], unit: bar, reading: gauge}
tip: {position: {columns: [2, 3, 4], unit: mm}}
"""

Bring = Callable[..., Run]


def imported_in(folder: Path, data: str | Path, mapping: str) -> ImportResult:
    file = data if isinstance(data, Path) else folder / "data.csv"
    if isinstance(data, str):
        file.write_text(data, encoding="utf-8")
    (folder / "mapping.yaml").write_text(mapping, encoding="utf-8")
    return import_table(file, folder / "mapping.yaml", folder / "archives")


def run_imported(folder: Path, data: str | Path, mapping: str) -> Run:
    return runs.open(imported_in(folder, data, mapping).archive)


def warnings_of(run: Run) -> str:
    return "\n".join(event.message for event in run.events if event.level is Level.WARNING)


def complaint(bring: Bring, data: str | Path, mapping: str = SMALL) -> str:
    with pytest.raises(BadInputError) as caught:
        bring(data, mapping)
    return str(caught.value)
