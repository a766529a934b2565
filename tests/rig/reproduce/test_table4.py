"""The paper's Table 4 again: which schemes hold, how the errors compare, and how far ahead the live solver is."""

from __future__ import annotations

from pathlib import Path

import pytest

from rig.reproduce.table4 import PRINTED_SCHEMES, Table4Row, drawing, table4
from runs.report.drawing import save
from scripts.backbones import backbones

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def rows() -> tuple[Table4Row, ...]:
    return table4(horizon_s=4.0, steps_along=(20,))


def test_the_grid_is_complete(rows: tuple[Table4Row, ...]) -> None:
    assert {(row.space, row.scheme) for row in rows} == {
        (s, name) for s in ("euler", "rk4") for name, _, _ in PRINTED_SCHEMES
    }


def test_bdf3_fails_after_seconds_and_the_others_do_not(rows: tuple[Table4Row, ...]) -> None:
    for row in rows:
        if row.scheme == "BDF3":
            assert 1.0 < row.held_s < 4.0
        elif row.scheme != "Trapezoidal":
            assert row.held_s == 4.0


def test_the_live_solver_is_as_exact_as_the_papers_rk4_and_better_than_its_euler(rows: tuple[Table4Row, ...]) -> None:
    for row in rows:
        if row.space == "rk4":
            assert row.ours_error_mm == pytest.approx(row.error_mm, rel=0.02)
        else:
            assert row.ours_error_mm < row.error_mm


def test_the_figure_is_drawn(rows: tuple[Table4Row, ...], tmp_path: Path) -> None:
    drawn = drawing(rows)
    save(drawn.draw, drawn.size, tmp_path / "table4.svg", *drawn.about)
    assert "live solver" in (tmp_path / "table4.svg").read_text()


def test_the_backbones_are_drawn(tmp_path: Path) -> None:
    backbones(tmp_path / "backbones.svg")
    assert "inhomogeneous+rpe" in (tmp_path / "backbones.svg").read_text()
