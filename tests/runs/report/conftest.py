"""Archives that the tests of reports share."""

from __future__ import annotations

from pathlib import Path

import pytest

import tests.support.synthetic_runs as made_up
from runs.archive.writer import finalise


@pytest.fixture(scope="module")
def archive(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("report") / "run.mcap"
    made_up.write_journal(path)
    return finalise(path)


@pytest.fixture(scope="module")
def short(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A run so short that no camera frame was seen."""
    path = tmp_path_factory.mktemp("report") / "short.mcap"
    made_up.write_journal(path, duration_s=0.03)
    return finalise(path)
