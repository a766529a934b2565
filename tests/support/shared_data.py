"""Data kept beside the checkout, for tests only."""

from __future__ import annotations

from pathlib import Path

from tests.support.absent import absent

SHARED = Path(__file__).resolve().parents[3] / "shared"


def shared_data(*parts: str) -> Path:
    """A data file kept beside the checkout; skips where it is missing, fails where CI is set."""
    path = SHARED.joinpath("data", *parts)
    if not path.exists():
        absent(f"{path} is not here: this test needs the data folder beside the checkout")
    return path
