"""The page of a study: what its tables say of each level."""

from __future__ import annotations

import csv
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from runs.archive.writer import finalise
from runs.journal.journal import JournalWriter
from runs.records import RunFooter, Status, StudyRole, StudyRun
from runs.study.linear_model import TIME, fit
from runs.study.page import StudyTable, _response, tabulate, write
from runs.study.responses import RESPONSES
from tests.support.synthetic_runs import header


@pytest.mark.parametrize(("share", "said"), [(0.0, 0), (1.0, 1)])
def test_a_sentence_warns_of_means_whose_effect_depends_on_another_factor(share: float, said: int) -> None:
    first, second, order = (0.1, 0.1, 0.2, 0.2) * 6, (1.0, 2.0) * 12, tuple(range(1, 25))
    y = np.random.default_rng(0).normal(0.0, 0.1, 24) + share * (np.array(first) > 0.15) * (np.array(second) > 1.5)
    factors, blocks = {"peak_bar": first, "hold_s": second}, (1,) * 24
    table = StudyTable((("1",),) * 24, factors, (tuple(y.tolist()),), blocks, order, (True,) * len(y))
    text = " ".join(_response(RESPONSES[0], factors, table, y, fit(factors, blocks, order, y)))
    assert text.count("The effect of peak_bar depends on hold_s") == said


def test_only_the_first_level_is_the_reference_also_where_another_has_no_effect() -> None:
    pressures, order = (0.1, 0.2) * 6, tuple(range(1, 13))
    y = np.zeros(12)
    factors = {"peak_bar": pressures}
    blocks = (1,) * 12
    model = fit(factors, blocks, order, y)
    table = StudyTable((("1",),) * 12, factors, (tuple(y.tolist()),), blocks, order, (True,) * len(y))
    text = " ".join(_response(RESPONSES[0], factors, table, y, model))
    assert text.count("<td>reference</td>") == 1
    assert "± 0.0" not in text


@pytest.mark.parametrize("blocks", [(1,) * 6, (1,) * 3 + (2,) * 3])
def test_the_caption_names_blocks_and_levels_only_where_there_are_some(blocks: tuple[int, ...]) -> None:
    order, y = tuple(range(1, 7)), np.random.default_rng(0).normal(0.0, 0.1, 6)
    for factors in ({}, {"peak_bar": (0.1, 0.2) * 3}):
        table = StudyTable((("1",),) * 6, factors, (tuple(y.tolist()),), blocks, order, (True,) * 6)
        text = " ".join(_response(RESPONSES[0], factors, table, y, fit(factors, blocks, order, y)))
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
    assert "Runs of more than one operator are analysed together: A. Name (2), B. Name (1)." in page.read_text()
    table = list(csv.DictReader(rows.read_text().splitlines()))
    assert [row["operator"] for row in table] == list(people)
    assert [row["simulated"] for row in table] == ["1", "0", "0"]


def test_a_text_in_the_table_is_no_formula_of_a_spreadsheet(tmp_path: Path) -> None:
    _, rows = write("dwell", "Dwell", 1, [archive(tmp_path, 1, 1, operator="=1+1")], tmp_path)
    (row,) = csv.DictReader(rows.read_text().splitlines())
    assert row["operator"] == "'=1+1"


def test_a_sentence_says_that_blocks_and_order_cannot_be_told_apart() -> None:
    order, blocks = tuple(range(1, 13)), (1,) * 4 + (2,) * 4 + (3,) * 4
    y = np.random.default_rng(0).normal(0.0, 0.1, 12)
    model = fit({}, blocks, order, y)
    table = StudyTable((("1",),) * 12, {}, (tuple(y.tolist()),), blocks, order, (True,) * 12)
    text = " ".join(_response(RESPONSES[0], {}, table, y, model))
    assert f"Blocks share {100 * model.shared:.0f} % of the variance of the order of the runs" in text
    assert TIME in text
