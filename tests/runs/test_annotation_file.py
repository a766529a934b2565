"""Notes and tags beside an archive, and what the catalogue makes of them and of specimens."""

from __future__ import annotations

import json
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import runs
import tests.support.synthetic_runs as made_up
from runs import annotation_file
from runs.annotations import AnnotationError, add_note, add_tags, remove_tags
from runs.archive.checked import ArchiveError
from runs.archive.writer import finalise
from runs.catalogue import catalogue, search, specimen_cycles
from runs.journal.journal import JournalWriter
from runs.pressure_cycles import pressure_cycles
from runs.records import RunFooter, Status
from runs.report.page import page
from tests.support.command_line import status_of
from tests.support.report_text import without_figures

ROOT = Path(__file__).parents[2]


def make(folder: Path, run_id: str, specimen: str = "", bar: tuple[float, ...] = (), **fields: str) -> Path:
    about = {"specimen": specimen} if specimen else {}
    header = replace(made_up.header(run_id, 1.0), metadata=about, **fields)  # type: ignore[arg-type]
    writer = JournalWriter(folder / f"{run_id}.mcap", header)
    rows = made_up.samples(1.0)[: len(bar)]
    rows["measured_pa"] = 0
    rows["measured_pa"][:, 1] = np.array(bar) * 1e5
    writer.samples(rows)
    writer.observations(made_up.observations(1.0))
    writer.close(RunFooter(header.started_t_ns + 10**9, Status.FINISHED, ""))
    return finalise(writer.path)


def test_notes_and_tags_are_shown_and_the_archive_stays(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    without_figures(monkeypatch)
    archive, other = make(tmp_path, "one"), make(tmp_path, "two")
    before = archive.read_bytes()
    assert catalogue(tmp_path)[0].tags == ()
    assert status_of("note", archive, "the <tube> slipped") == 0
    assert status_of("tag", archive, "bad", "leak", "bad") == 0
    assert status_of("tag", archive, "leak", "--remove") == 0
    assert archive.read_bytes() == before

    assert annotation_file.read(archive).tags == ("bad",)
    assert [note.text for note in annotation_file.read(archive).notes] == ["the <tube> slipped"]
    assert [entry.run_id for entry in search(catalogue(tmp_path), tag="bad")] == ["one"]
    assert [entry.run_id for entry in search(catalogue(tmp_path), "BAD")] == ["one"]
    text = page([runs.open(archive)])
    assert "the &lt;tube&gt; slipped" in text
    assert '<span class="badge">bad</span>' in text
    capsys.readouterr()
    assert status_of("show", archive) == 0
    shown = capsys.readouterr().out
    assert "the <tube> slipped" in shown
    assert status_of("show", archive, "--json") == 0
    assert json.loads(capsys.readouterr().out)["annotations"]["tags"] == ["bad"]
    assert status_of("runs", tmp_path) == 0
    assert "bad" in capsys.readouterr().out
    assert status_of("runs", tmp_path, "--tag", "bad", "--json") == 0
    assert [entry["file"] for entry in json.loads(capsys.readouterr().out)] == [archive.name]
    assert not annotation_file.path_of(other).exists()


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (("tag", "two words"), "tag 'two words': expected a word of"),
        (("tag", "badd", "--remove"), "tag badd: expected a tag of this run: bad"),
        (("note", "  "), "expected a note, which is not empty"),
    ],
)
def test_what_is_no_tag_or_note_is_refused(
    words: tuple[str, ...], said: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    archive = make(tmp_path, "one")
    add_tags(archive, ["bad"])
    before = annotation_file.path_of(archive).read_bytes()
    assert status_of(words[0], archive, *words[1:]) == 2
    assert said in capsys.readouterr().err
    assert annotation_file.path_of(archive).read_bytes() == before


def test_python_takes_a_run_by_its_id_and_refuses_what_the_command_refuses(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "data").mkdir()
    make(tmp_path / "data", "one")
    monkeypatch.chdir(tmp_path)
    file = add_note("last", " the tube slipped ")
    assert add_tags("one", ["bad", "leak", "bad"]) == remove_tags("last", ["leak"]) == file
    found = annotation_file.read(Path("data/one.h5"))
    assert ([note.text for note in found.notes], found.tags) == (["the tube slipped"], ("bad",))
    with pytest.raises(AnnotationError, match="a list of tags"):
        add_tags("one", "bad")
    with pytest.raises(AnnotationError, match="which is not empty"):
        add_note("one", " ")
    with pytest.raises(AnnotationError, match="a tag of this run: bad"):
        remove_tags("one", ["bad", "leak"])
    assert annotation_file.read(Path("data/one.h5")) == found


@pytest.mark.parametrize(
    "line", ["", "[]", "5", "null", '{"time": 1, "tag": "x"}', '{"time": "t", "tags": "x"}', '{"ta']
)
def test_a_damaged_line_is_reported_with_its_number_and_the_run_stays_listed(tmp_path: Path, line: str) -> None:
    archive = make(tmp_path, "one")
    add_tags(archive, ["bad"])
    path = annotation_file.path_of(archive)
    path.write_text(path.read_text() + line + "\n")
    with pytest.raises(ArchiveError, match=r"one\.notes\.jsonl:2: found "):
        annotation_file.read(archive)
    (entry,) = catalogue(tmp_path)
    assert (entry.run_id, entry.status) == ("one", "finished")
    assert "notes.jsonl:2" in entry.problem


def test_a_byte_that_is_no_utf_8_spoils_its_letter_only(tmp_path: Path) -> None:
    archive = make(tmp_path, "one")
    add_note(archive, "hot")
    path = annotation_file.path_of(archive)
    path.write_bytes(path.read_bytes().replace(b"hot", b"h\xf6t"))
    assert [note.text for note in annotation_file.read(archive).notes] == ["h\ufffdt"]
    assert status_of("show", archive) == 0


# A process without threads may fork, and what it has imported need not be imported in each writer again.
WRITERS = """
import multiprocessing
import pathlib
import sys
from runs.annotations import add_note

def add(who):
    for number in range(50):
        add_note(pathlib.Path(sys.argv[1]), f"{who} {number}")

fork = multiprocessing.get_context("fork")
writers = [fork.Process(target=add, args=(who,)) for who in range(3)]
for writer in writers:
    writer.start()
for writer in writers:
    writer.join()
"""


def test_notes_of_several_processes_are_all_kept(tmp_path: Path) -> None:
    archive = make(tmp_path, "one")
    subprocess.run([sys.executable, "-c", WRITERS, str(archive)], cwd=ROOT, check=True)
    notes = [note.text for note in annotation_file.read(archive).notes]
    assert sorted(notes) == sorted(f"{who} {number}" for who in range(3) for number in range(50))


def test_the_pressure_cycles_of_a_specimen_are_counted_over_its_runs(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    make(tmp_path, "first", "A7", (0, 0.3, 0, 0.2, 0.1))
    make(tmp_path, "second", "A7", (0.1, 0.6))  # interrupted under pressure
    make(tmp_path, "other", "A8", (0, 0.3, 0))
    make(tmp_path, "without", "", (0, 0.3, 0))
    make(tmp_path, "again", "A7", (0, 0.3, 0), parent="first")
    make(tmp_path, "computed", "A7", (0, 0.3, 0), executor="model alone")
    for _ in range(2):  # the second time from the index
        entries = catalogue(tmp_path)
        assert specimen_cycles(entries, "A7") == (3, 2)
        assert specimen_cycles(entries, "A9") == (0, 0)
        found = search(entries, specimen="A7")
        assert {e.run_id: e.pressure_cycles for e in found} == {
            "first": 2,
            "second": 1,
            "again": None,
            "computed": None,
        }
    assert status_of("runs", tmp_path, "--specimen", "A7") == 0
    assert "specimen A7: 3 pressure cycles in 2 runs" in capsys.readouterr().out


@given(
    count=st.integers(0, 30), low=st.floats(0, 0.3), rise=st.floats(0.06, 0.5), noise=st.floats(0, 0.02),
    seed=st.integers(0, 1000),
)  # fmt: skip
def test_cycles_are_rises_and_falls_whatever_the_noise(
    count: int, low: float, rise: float, noise: float, seed: int
) -> None:
    corners = [low, *(level for _ in range(count) for level in (low + rise + 2 * noise, low)), low + rise]
    pressure = np.interp(np.linspace(0, len(corners) - 1, 40 * len(corners)), range(len(corners)), corners)
    pressure = pressure + np.random.default_rng(seed).uniform(-noise, noise, len(pressure))
    steady = np.full_like(pressure, 0.2)
    steady[::7] = np.nan
    assert pressure_cycles(np.stack([steady, pressure], axis=1)) == count + 1  # vented after the last row


def test_a_note_on_what_is_no_archive_is_refused(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    empty = tmp_path / "empty.h5"
    empty.touch()
    assert status_of("note", empty, "a good run") == 2
    assert status_of("tag", empty, "good") == 2
    assert "empty.h5" in capsys.readouterr().err
    assert [file.name for file in tmp_path.iterdir()] == ["empty.h5"]
