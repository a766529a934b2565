"""Imports into the folder of the test."""

from __future__ import annotations

from functools import partial
from pathlib import Path

import pytest

from tests.support.import_bench import Bring, run_imported


@pytest.fixture
def bring(tmp_path: Path) -> Bring:
    """Imports a text or a file by a mapping and opens the archive."""
    return partial(run_imported, tmp_path)
