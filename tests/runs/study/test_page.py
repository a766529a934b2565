"""The page of a study: what its tables say of each level."""

from __future__ import annotations

import csv
import re
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from runs.archive.writer import finalise
from runs.journal.journal import JournalWriter
from runs.records import RunFooter, Status, StudyRole, StudyRun
from runs.report.html import DASH
from runs.study.page import StudyTable, _response, tabulate, write
from runs.study.responses import RESPONSES
from tests.support.synthetic_runs import header


def test_the_page_shows_the_mean_and_the_scatter_of_each_combination() -> None:
    factors = {"peak_bar": (0.1, 0.2, 0.1, 0.2), "hold_s": (1.0, 1.0, 1.0, 2.0)}
    table = StudyTable((("1",),) * 4, factors, ((1.0, 5.0, 3.0, 7.0),), (1,) * 4, (1, 2, 3, 4), (True,) * 4)
    text = " ".join(_response(RESPONSES[0], factors, table))
    rows = [re.findall(r"<td[^>]*>(.*?)</td>", row) for row in re.findall(r"<tr>(.*?)</tr>", text)]
    assert [row[:5] for row in rows if row] == [
        ["0.1", "1", "2", "2", "1.4"],
        ["0.2", "1", "1", "5", DASH],
        ["0.2", "2", "1", "7", DASH],
    ]


@pytest.mark.parametrize("blocks", [(1,) * 6, (1,) * 3 + (2,) * 3])
def test_the_caption_names_blocks_and_levels_only_where_there_are_some(blocks: tuple[int, ...]) -> None:
    values = tuple(np.random.default_rng(0).normal(0.0, 0.1, 6).tolist())
    for factors in ({}, {"peak_bar": (0.1, 0.2) * 3}):
        table = StudyTable((("1",),) * 6, factors, (values,), blocks, tuple(range(1, 7)), (True,) * 6)
        text = " ".join(_response(RESPONSES[0], factors, table))
        assert ("coloured by block" in text) == (len(set(blocks)) > 1)
        assert ("means of the levels" in text) == bool(factors)


def archive(folder: Path, number: int, began: int, **about: Any) -> Path:
    """A run of a study in a folder, that began at this second."""
    place = StudyRun("dwell", StudyRole.RUN, number, 1, 1, "", "")
    run_id = f"run-{number}"
    head = replace(header(run_id), started_utc_ns=began * 10**9, study=place, **about)
    writer = JournalWriter(folder / f"{run_id}.mcap", head)
    writer.close(RunFooter(head.started_t_ns, Status.FINISHED, "", {}))
    return finalise(folder / f"{run_id}.mcap")


def test_the_order_of_the_runs_is_that_in_which_they_really_began(tmp_path: Path) -> None:
    files = [archive(tmp_path, number, began) for number, began in ((1, 300), (2, 100), (3, 200))]
    assert tabulate(files).order == (3, 1, 2)


def test_the_page_and_the_table_say_whose_runs_are_analysed_together(tmp_path: Path) -> None:
    people = ("A. Name", "B. Name", "A. Name")
    files = [archive(tmp_path, n, n, operator=name, simulated=n == 1) for n, name in enumerate(people, 1)]
    page, rows = write("dwell", "Dwell", 3, files, tmp_path)
    assert "Runs of more than one operator are shown together: A. Name (2), B. Name (1)." in page.read_text()
    table = list(csv.DictReader(rows.read_text().splitlines()))
    assert [row["operator"] for row in table] == list(people)
    assert [row["simulated"] for row in table] == ["1", "0", "0"]


def test_a_text_in_the_table_is_no_formula_of_a_spreadsheet(tmp_path: Path) -> None:
    _, rows = write("dwell", "Dwell", 1, [archive(tmp_path, 1, 1, operator="=1+1")], tmp_path)
    (row,) = csv.DictReader(rows.read_text().splitlines())
    assert row["operator"] == "'=1+1"
