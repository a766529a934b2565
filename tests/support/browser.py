"""The browser of the tests of the live page: skips where it is missing, fails where CI is set."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

from scripts import browser as program
from scripts.browser import Browser
from tests.support.absent import absent


@contextmanager
def browsing() -> Iterator[Browser]:
    """A browser with a new profile."""
    try:
        program.chromium()
    except FileNotFoundError as missing:
        absent(str(missing))
    with program.browsing() as browser:
        yield browser
