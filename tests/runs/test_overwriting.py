"""Errors of a full disk name the file that was written; no half of it is left."""

from __future__ import annotations

import resource
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import pytest

from rig.calibrate import board_drawing
from rig.calibrate.view_collection import store
from rig.config.loader import load
from runs.overwriting import staged, write_text
from runs.report import drawing

NO_FILES = Path("/sys/kernel")
"""A folder in which not even root can make a file."""


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


WRITERS: dict[str, Callable[[Path], object]] = {
    "a.yaml": lambda file: write_text(file, "text"),
    "view.png": lambda file: store(np.zeros((4, 4), np.uint8), file.parent, file.stem),
    "figure.png": lambda file: drawing.save(lambda figure: None, (2, 2), file),
    "board.pdf": lambda file: board_drawing.write(load("mock").board, "mock", file),
}


@pytest.mark.parametrize("name", WRITERS)
def test_a_file_in_a_folder_that_takes_none_is_named_as_the_user_named_it(name: str) -> None:
    file = NO_FILES / name
    with pytest.raises(OSError, match=name) as refused:
        WRITERS[name](file)
    assert refused.value.filename == str(file)
    assert refused.value.filename2 is None


def test_files_in_a_folder_that_takes_none_name_the_folder() -> None:
    with pytest.raises(OSError, match="sys") as refused, staged(NO_FILES):
        pass
    assert refused.value.filename == str(NO_FILES)


def test_an_error_in_a_temporary_folder_names_the_file_in_the_real_one(tmp_path: Path) -> None:
    with pytest.raises(OSError, match="name too long") as refused, staged(tmp_path) as stage:
        (stage / ("x" * 300)).write_text("text")
    assert refused.value.filename == str(tmp_path / ("x" * 300))
    assert not list(tmp_path.iterdir())


def test_a_figure_that_does_not_fit_on_the_disk_leaves_the_old_one(tmp_path: Path) -> None:
    file = tmp_path / "figure.png"
    file.write_text("old")
    with no_room(), pytest.raises(OSError, match=r"figure\.png"):
        drawing.save(lambda figure: None, (2, 2), file)
    assert file.read_text() == "old"
    assert list(tmp_path.iterdir()) == [file]


def test_a_folder_of_files_that_do_not_fit_on_the_disk_is_named(tmp_path: Path) -> None:
    with no_room(), pytest.raises(OSError, match="figures"), staged(tmp_path / "figures") as stage:
        (stage / "a.svg").write_text("x" * 100_000)
    assert not list((tmp_path / "figures").iterdir())


def test_a_picture_that_does_not_fit_on_the_disk_is_named(tmp_path: Path) -> None:
    with no_room(), pytest.raises(OSError, match=r"view-1\.png"):
        store(np.zeros((40, 40), np.uint8), tmp_path, "view-1")
