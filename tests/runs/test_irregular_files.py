"""Named pipes, folders and links in a data folder: whoever may write there cannot make a command wait for ever."""

from __future__ import annotations

import os
from collections.abc import Callable
from pathlib import Path

import pytest

import tests.support.synthetic_runs as made_up
from runs import annotation_file, recovery
from runs.annotations import add_note
from runs.archive.checked import ArchiveError
from runs.archive.writer import finalise
from runs.catalogue import INDEX, catalogue


def link_to_itself(path: Path) -> None:
    path.symlink_to(path.name)


def link_to_endless_zeros(path: Path) -> None:
    path.symlink_to("/dev/zero")


IRREGULAR = pytest.mark.parametrize("make", [os.mkfifo, Path.mkdir, link_to_itself, link_to_endless_zeros])


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """A data folder with one archive."""
    made_up.write_journal(tmp_path / "run.mcap")
    finalise(tmp_path / "run.mcap")
    return tmp_path


@IRREGULAR
def test_what_is_no_file_is_no_journal(folder: Path, make: Callable[[Path], None]) -> None:
    make(folder / "odd.mcap")
    make(folder / "odd.h5.part")
    assert recovery.orphans(folder) == ()
    assert [outcome.path.name for outcome in recovery.recover(folder)] == ["run.mcap"]


@IRREGULAR
def test_a_folder_is_listed_whatever_has_the_name_of_its_index(folder: Path, make: Callable[[Path], None]) -> None:
    make(folder / INDEX)
    assert [entry.run_id for entry in catalogue(folder)] == ["run"]


@IRREGULAR
def test_notes_are_neither_read_from_nor_added_to_what_is_no_file(folder: Path, make: Callable[[Path], None]) -> None:
    notes = annotation_file.path_of(folder / "run.h5")
    make(notes)
    with pytest.raises(ArchiveError, match="not a regular file"):
        annotation_file.read(folder / "run.h5")
    with pytest.raises(ArchiveError, match="not a regular file"):
        add_note(folder / "run.h5", "never written")
    (entry,) = catalogue(folder)
    assert "not a regular file" in entry.problem
