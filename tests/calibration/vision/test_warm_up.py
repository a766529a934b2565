"""The pictures of a warm-up show a board as a camera would: the whole way of a measurement is taken."""

from __future__ import annotations

import pytest

from benchmarks.support.boards import BOARDS
from calibration.vision.board import Board
from calibration.vision.checkerboard import Checkerboard
from calibration.vision.warm_up import warm_up
from runs.records import DetectionStatus

KINDS: dict[str, Board] = {"checkerboard": Checkerboard(7, 6, 0.008)} | BOARDS


@pytest.mark.parametrize("kind", KINDS)
def test_a_warm_up_measures_each_kind_of_board(kind: str) -> None:
    assert warm_up(KINDS[kind]) is DetectionStatus.MEASURED
