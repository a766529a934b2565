"""The reference firmware for tests, which need a compiler for it."""

from __future__ import annotations

from pathlib import Path

import pytest

from scripts.pressure_controller import NoCompilerError, compiled


def firmware(folder: Path) -> Path:
    """The reference firmware as a program; skips where there is no compiler."""
    try:
        return compiled(folder)
    except NoCompilerError as missing:
        pytest.skip(str(missing))
