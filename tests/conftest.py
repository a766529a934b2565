"""Shared by every test."""

import functools
import gc
import os
from collections.abc import Iterator

import pytest
import typer.main
from hypothesis import settings
from hypothesis.internal.conjecture import providers

from tests.support.budget import register_profiles

register_profiles()
settings.load_profile("softrig")


@pytest.hookimpl(trylast=True)
def pytest_configure() -> None:
    """Examples of `make test` depend on nothing but the test.

    Hypothesis also draws constants from the source of every module that is imported by then: other examples in another
    order of tests, and in a checkout below a folder called tests.
    """
    if settings.default is not None and settings.default.derandomize:
        none = providers.Constants()
        providers._get_local_constants = lambda: none


def pytest_collection_finish() -> None:
    """The garbage collector does not search the imported modules again and again, which takes a tenth of the time."""
    gc.collect()
    gc.freeze()
    gc.set_threshold(50_000, 20, 20)
    # A program builds its command line once; a test process that calls `main` hundreds of times needs no more.
    typer.main.get_command = functools.cache(typer.main.get_command)


@pytest.fixture(autouse=True)
def _no_priority_kept() -> Iterator[None]:
    """What a test calls in its own process leaves it no real-time priority: it would starve the tests beside it."""
    yield
    assert os.sched_getscheduler(0) not in (os.SCHED_FIFO, os.SCHED_RR), "this test left its process in real time"
