"""Data kept beside the checkout, for tests only."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

SHARED = Path(__file__).resolve().parents[3] / "shared"


def shared_data(*parts: str) -> Path:
    """A data file kept beside the checkout; skips where it is missing, fails where CI is set."""
    path = SHARED.joinpath("data", *parts)
    if not path.exists():
        reason = f"{path} is not here: this test needs the data folder beside the checkout"
        if os.environ.get("CI"):
            pytest.fail(reason)
        pytest.skip(reason)
    return path
