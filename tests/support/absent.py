"""Skips tests whose requirements the machine lacks."""

from __future__ import annotations

import os
from typing import NoReturn

import pytest


def absent(reason: str) -> NoReturn:
    """Skip this test, and say why; where CI is set, fail: CI must have everything."""
    if os.environ.get("CI"):
        pytest.fail(reason)
    pytest.skip(reason)
