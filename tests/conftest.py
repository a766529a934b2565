"""Shared by every test."""

import os
from collections.abc import Iterator

import pytest
from hypothesis import settings

# Machines are shared and noisy: how long an example takes says nothing about the code.
settings.register_profile("softrig", deadline=None)
settings.load_profile("softrig")


@pytest.fixture(autouse=True)
def _no_priority_kept() -> Iterator[None]:
    """What a test calls in its own process leaves it no real-time priority: it would starve the tests beside it."""
    yield
    assert os.sched_getscheduler(0) not in (os.SCHED_FIFO, os.SCHED_RR), "this test left its process in real time"
