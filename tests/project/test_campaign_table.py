"""The table of the fault campaign: one row per fault, and failures in the line above it."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path

from scripts.faults import table
from scripts.faults.catalogue import CATALOGUE
from scripts.faults.fault import FaultTrial

FAULT = CATALOGUE["sensor open"]
GOOD = FaultTrial(FAULT.name, "real", 1.0, "aborted", "sensor 1 reads 10 V", safe_s=0.005, lost_s=0.0, wrong="")


def test_a_fault_has_one_row_with_the_times_of_both_executors() -> None:
    trials = [GOOD, replace(GOOD, safe_s=0.007), replace(GOOD, executor="virtual", safe_s=1.5)]
    text = table.table([FAULT], trials)
    assert "| sensor open | 3 | 6 ms (7 ms) / 1.5 s (1.5 s) | aborted |" in text


def test_failed_and_unsafe_trials_are_counted() -> None:
    text = table.table([FAULT], [GOOD, replace(GOOD, wrong="NOT SAFE: valve 1")])
    assert "2 trials of 1 faults" in text
    assert "**1 left unsafe where a program can help, 0 not reported, 1 failed**" in text
    assert "| sensor open | 2, 1 failed |" in text


def test_what_could_not_be_tried_says_why() -> None:
    skipped = replace(GOOD, skipped="needs root", safe_s=math.nan)
    assert "| sensor open | not tried: needs root |" in table.table([FAULT], [skipped])


def test_only_the_part_between_the_marks_is_replaced(tmp_path: Path) -> None:
    page = tmp_path / "page.md"
    page.write_text(f"before\n{table.BEGIN}\nold\n{table.END}\nafter\n")
    table.write(page, [FAULT], [GOOD])
    text = page.read_text()
    assert text.startswith("before\n")
    assert text.endswith("\nafter\n")
    assert "old" not in text
    assert "| sensor open | 1 |" in text
