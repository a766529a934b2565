"""The catalogue lists a folder quickly, and correctly with any damage to its index."""

from __future__ import annotations

import dataclasses
import json
import os
import shutil
from pathlib import Path

import pytest
from hypothesis import HealthCheck, given
from hypothesis import strategies as st

import tests.support.synthetic_runs as made_up
from runs import catalogue as module
from runs.archive.writer import finalise
from runs.catalogue import INDEX, Entry, catalogue, search
from runs.journal.journal import JournalWriter
from runs.records import RunFooter, RunHeader, Status
from tests.support.budget import examples


def make(folder: Path, run_id: str, **fields: object) -> Path:
    header: RunHeader = dataclasses.replace(made_up.header(run_id, 1.0), **fields)  # type: ignore[arg-type]
    writer = JournalWriter(folder / f"{run_id}.mcap", header)
    writer.observations(made_up.observations(1.0))
    writer.close(RunFooter(header.started_t_ns + 10**9, Status.FINISHED, ""))
    return finalise(folder / f"{run_id}.mcap")


@pytest.fixture(scope="module")
def recorded(tmp_path_factory: pytest.TempPathFactory) -> Path:
    place, day = tmp_path_factory.mktemp("recorded"), 86_400_000_000_000
    for i, run_id in enumerate(("first", "second", "third")):
        make(place, run_id, started_utc_ns=made_up.header().started_utc_ns + i * day, protocol_name=f"ramp-{i}")
    return place


@pytest.fixture
def folder(recorded: Path, tmp_path: Path) -> Path:
    return Path(shutil.copytree(recorded, tmp_path, dirs_exist_ok=True))


def names(entries: tuple[Entry, ...]) -> list[str]:
    return [entry.run_id or entry.file for entry in entries]


def forbid_reading(monkeypatch: pytest.MonkeyPatch) -> None:
    def never(path: Path) -> Entry:
        raise AssertionError(f"{path} was opened although it had not changed")

    monkeypatch.setattr(module, "_read", never)


def test_it_lists_the_newest_first(folder: Path) -> None:
    found = catalogue(folder)
    assert names(found) == ["third", "second", "first"]
    assert found[0].start_time.startswith("2026-01-04T03:04:05")
    assert (found[0].status, found[0].protocol, found[0].operator) == ("finished", "ramp-2", "A. Tester")
    assert found[0].mean_error_mm == pytest.approx(1.2, abs=0.2)
    assert found[0].simulated


def test_an_unchanged_archive_is_not_opened_again(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    before = catalogue(folder)
    forbid_reading(monkeypatch)
    stamp = (folder / INDEX).stat().st_mtime_ns
    assert catalogue(folder) == before
    assert (folder / INDEX).stat().st_mtime_ns == stamp


def test_it_follows_the_folder(folder: Path) -> None:
    catalogue(folder)
    (folder / "first.h5").unlink()
    make(folder, "fourth", started_utc_ns=0)
    shutil.copy(folder / "third.h5", folder / "second.h5")
    assert names(catalogue(folder)) == ["third", "third", "fourth"]


@examples(30, HealthCheck.function_scoped_fixture)
@given(rubbish=st.binary(max_size=200) | st.sampled_from([b"{}", b"[]", b"null", b'{"form": 1, "files": 3}']))
def test_any_rubbish_in_the_index_heals(tmp_path_factory: pytest.TempPathFactory, rubbish: bytes) -> None:
    folder = tmp_path_factory.getbasetemp() / "heals"
    if not folder.exists():
        folder.mkdir()
        make(folder, "only")
    (folder / INDEX).write_bytes(rubbish)
    assert names(catalogue(folder)) == ["only"]
    assert json.loads((folder / INDEX).read_text())["form"] == module._FORM


def test_an_index_with_odd_entries_heals(folder: Path) -> None:
    right = catalogue(folder)
    index = json.loads((folder / INDEX).read_text())
    index["files"]["first.h5"]["entry"] = {"colour": "blue"}
    (folder / INDEX).write_text(json.dumps(index))
    assert catalogue(folder) == right


@pytest.mark.parametrize(
    ("field", "value"),
    [
        ("title", 7),
        ("start_time", None),
        ("duration_s", "long"),
        ("simulated", "no"),
        ("frames", 1.5),
        ("mean_error_mm", "small"),
        ("operator", ["a"]),
        ("problem", {}),
        ("file", "second.h5"),
        ("notes", "\ud800"),
    ],
)
def test_an_index_with_values_of_another_type_heals(folder: Path, field: str, value: object) -> None:
    right = catalogue(folder)
    index = json.loads((folder / INDEX).read_text())
    index["files"]["first.h5"]["entry"][field] = value
    (folder / INDEX).write_text(json.dumps(index))
    assert catalogue(folder) == right
    assert json.loads((folder / INDEX).read_text())["files"]["first.h5"]["entry"][field] != value


@pytest.mark.parametrize(
    "entry", [None, 3, [], [1, 2], {"stamp": [1, 2], "entry": None}, {"stamp": "a", "entry": {}}, {"a": 1}]
)
def test_an_index_with_entries_of_another_shape_heals(folder: Path, entry: object) -> None:
    right = catalogue(folder)
    index = json.loads((folder / INDEX).read_text())
    index["files"]["first.h5"] = entry
    (folder / INDEX).write_text(json.dumps(index))
    assert catalogue(folder) == right


def test_a_folder_that_cannot_be_written_is_still_listed(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse(*_: object, **__: object) -> int:
        raise PermissionError(13, "Permission denied")

    monkeypatch.setattr(Path, "write_text", refuse)
    assert names(catalogue(folder)) == ["third", "second", "first"]
    assert not (folder / INDEX).exists()


def test_a_file_that_is_not_an_archive_is_named_and_the_others_are_listed(folder: Path) -> None:
    (folder / "broken.h5").write_bytes(b"no archive")
    os.truncate(folder / "first.h5", 5000)
    found = catalogue(folder)
    assert names(found) == ["third", "second", "first.h5", "broken.h5"]
    assert "not an archive of softrig" in found[-1].problem


def test_journals_and_half_archives_are_not_listed(folder: Path) -> None:
    (folder / "half.h5.part").write_bytes(b"half")
    assert len(catalogue(folder)) == 3


def test_an_empty_or_missing_folder_is_an_empty_catalogue(tmp_path: Path) -> None:
    assert catalogue(tmp_path) == ()
    assert catalogue(tmp_path / "none") == ()
    assert not (tmp_path / "none").exists()


def test_it_searches(folder: Path) -> None:
    make(folder, "other", operator="Grace", notes="stiffer tube", protocol_name="sine-1", started_utc_ns=0)
    found = catalogue(folder)
    assert names(search(found, "grace TUBE")) == ["other"]
    assert names(search(found, "grace ramp")) == []
    assert names(search(found, "ramp")) == ["third", "second", "first"]
    assert names(search(found, since="2026-01-03")) == ["third", "second"]
    assert names(search(found, since="2026-01-03", until="2026-01-03")) == ["second"]
    assert names(search(found, until="1970")) == ["other"]
    assert names(search(found, "aborted")) == []
    assert names(search(found, "tester finished")) == ["third", "second", "first"]
