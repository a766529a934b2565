"""The pictures of a rehearsal show a board as a camera would: the whole way of a measurement is taken."""

from __future__ import annotations

import pytest

from benchmarks.boards import BOARDS
from calibration.vision.board import Board
from calibration.vision.checkerboard import Checkerboard
from calibration.vision.rehearsal import rehearse
from runs.records import DetectionStatus

KINDS: dict[str, Board] = {"checkerboard": Checkerboard(7, 6, 0.008)} | BOARDS


@pytest.mark.parametrize("kind", KINDS)
def test_a_rehearsal_measures_each_kind_of_board(kind: str) -> None:
    assert rehearse(KINDS[kind]) is DetectionStatus.MEASURED
