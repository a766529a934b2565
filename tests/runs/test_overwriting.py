"""Errors of a full disk name the file that was written; no half of it is left."""

from __future__ import annotations

import resource
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import pytest

from rig.calibrate.view_collection import store
from runs.overwriting import staged, write_text


@contextmanager
def no_room() -> Iterator[None]:
    """The kernel refuses to write more than some bytes into a file, as on a full disk."""
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (10, before[1]))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)


def test_a_text_that_does_not_fit_on_the_disk_is_named_and_leaves_the_old_file(tmp_path: Path) -> None:
    file = tmp_path / "page.html"
    file.write_text("old")
    with no_room(), pytest.raises(OSError, match=r"page\.html") as full:
        write_text(file, "x" * 100_000)
    assert full.value.filename == str(file)
    assert [path.name for path in tmp_path.iterdir()] == ["page.html"]
    assert file.read_text() == "old"


def test_a_folder_of_files_that_do_not_fit_on_the_disk_is_named(tmp_path: Path) -> None:
    with no_room(), pytest.raises(OSError, match="figures"), staged(tmp_path / "figures") as stage:
        (stage / "a.svg").write_text("x" * 100_000)
    assert not list((tmp_path / "figures").iterdir())


def test_a_picture_that_does_not_fit_on_the_disk_is_named(tmp_path: Path) -> None:
    with no_room(), pytest.raises(OSError, match=r"view-1\.png"):
        store(np.zeros((40, 40), np.uint8), tmp_path, "view-1")
