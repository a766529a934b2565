"""Shared by every test."""

import os
import signal
from collections.abc import Iterator

# As `rig` does; before NumPy is imported.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import pytest
from hypothesis import settings
from hypothesis.internal.conjecture import providers

from rig.hardware.running import records
from tests.support.budget import register_profiles
from tests.support.repeated_work import avoid_repeated_work

register_profiles()
settings.load_profile("softrig")
if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
    # A shell ignores Ctrl-C for what it starts in the background, and the tests' commands would inherit that.
    signal.signal(signal.SIGINT, signal.default_int_handler)


@pytest.hookimpl(trylast=True)
def pytest_configure() -> None:
    """Examples of `make test` depend on nothing but the test.

    Hypothesis also draws constants from the source of every module that is imported by then: other examples in another
    order of tests, and in a checkout below a folder called tests.
    """
    if settings.default is not None and settings.default.derandomize:
        none = providers.Constants()
        providers._get_local_constants = lambda: none


@pytest.hookimpl(optionalhook=True)
def pytest_xdist_auto_num_workers() -> int:
    """One more test process than processors: tests wait for processes, disks and clocks of their own."""
    return len(os.sched_getaffinity(0)) + 1


def pytest_terminal_summary(terminalreporter: pytest.TerminalReporter) -> None:
    """Print why a test was repeated."""
    for report in terminalreporter.getreports("rerun"):
        terminalreporter.write_sep("_", f"first failure of {report.nodeid}")
        terminalreporter.write_line(report.longreprtext)


def pytest_sessionstart(session: pytest.Session) -> None:
    """Tests of `rig vent` end what this user runs."""
    runs, _ = records()
    real = [run for run in runs if not run.simulated and run.process.alive]
    if real and not hasattr(session.config, "workerinput"):
        pytest.exit(f"the tests would end a running experiment: {real[0].purpose}, process {real[0].process.pid}", 2)


def pytest_collection_finish() -> None:
    """Test processes run hundreds of commands."""
    avoid_repeated_work()


@pytest.fixture(autouse=True)
def _no_priority_kept() -> Iterator[None]:
    """What a test calls in its own process leaves it no real-time priority: it would starve the tests beside it."""
    yield
    assert os.sched_getscheduler(0) not in (os.SCHED_FIFO, os.SCHED_RR), "this test left its process in real time"
