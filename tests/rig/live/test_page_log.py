"""The log of the page, which shares the terminal of the run."""

from __future__ import annotations

import logging

import pytest

from rig.live.server import PageLog


@pytest.fixture
def log() -> logging.Logger:
    """A logger of its own, with the handler of the page."""
    logger = logging.Logger("page")
    logger.addHandler(PageLog())
    return logger


def test_a_traceback_in_a_message_is_reported_by_its_reason(
    log: logging.Logger, capsys: pytest.CaptureFixture[str]
) -> None:
    # As uvicorn reports that the page could not start.
    log.error('Traceback (most recent call last):\n  File "x.py", line 1, in f\nOSError: No space left on device\n')
    assert capsys.readouterr().err == "live page: OSError: No space left on device\n"


def test_an_exception_is_reported_in_one_line(log: logging.Logger, capsys: pytest.CaptureFixture[str]) -> None:
    log.error("in the stream\nof a client", exc_info=ValueError("bad"))
    assert capsys.readouterr().err == "live page: in the stream (ValueError: bad)\n"
