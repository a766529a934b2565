"""Figures drawn in two processes: in their order, and none is lost."""

from __future__ import annotations

import os
from collections.abc import Callable
from functools import partial

import pytest

from runs.report.drawing import drawn


def name_and_process(name: str) -> str:
    return f"{name} {os.getpid()}"


@pytest.mark.parametrize("count", [0, 1, 2, 5])
def test_results_are_in_the_order_of_the_figures(count: int) -> None:
    names = [f"figure {k}" for k in range(count)]
    found = drawn([partial(name_and_process, name) for name in names])
    assert [text.rpartition(" ")[0] for text in found] == names


@pytest.mark.skipif(len(os.sched_getaffinity(0)) < 2, reason="this machine has one processor")
def test_a_second_process_draws_every_other_figure() -> None:
    processes = [text.rpartition(" ")[2] for text in drawn([partial(name_and_process, "a")] * 4)]
    assert processes[0] == processes[2] == str(os.getpid())
    assert processes[1] == processes[3] != str(os.getpid())


def dies_in_a_child(parent: int) -> str:
    if os.getpid() != parent:
        os._exit(9)
    return "drawn"


def test_what_a_child_that_dies_leaves_undone_is_drawn_here() -> None:
    assert drawn([partial(dies_in_a_child, os.getpid())] * 3) == ["drawn"] * 3


def test_the_error_of_a_figure_is_raised() -> None:
    def fails() -> str:
        raise ValueError("no data")

    figures: list[Callable[[], str]] = [lambda: "drawn", fails]
    with pytest.raises(ValueError, match="no data"):
        drawn(figures)
