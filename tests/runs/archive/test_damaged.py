"""Damaged archives: each is refused in one sentence before it is parsed, or read as far as possible with force."""

from __future__ import annotations

import os
import secrets
import shutil
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import h5py
import numpy as np
import pytest

import runs
import tests.support.synthetic_runs as made_up
from runs.archive import digest
from runs.archive.digest import ArchiveError, DamagedArchiveError
from runs.archive.writer import finalise
from runs.catalogue import catalogue
from runs.export.exporters import export
from runs.journal.journal import JournalWriter
from runs.records import Quantity, RecordedFile, RunFooter, Status, adaptation_dtype
from tests.support.changed_archive import changed
from tests.support.command_line import status_of

SEARCHED = 3000
"""Archives that a search damages."""


def write_everything(path: Path) -> Path:
    """An archive with every group that there is."""
    adapted = (Quantity("adaptation", "shear_ratio", (0.4,), "", "", 0.1),)
    files = (RecordedFile.of("pressures.csv", "csv", "0,0\n"),)
    vector = Quantity("calibration", "front.rotation", (0.0, 1.0, 0.0), "rad", "rig.yaml")
    header = made_up.header(path.stem)
    header = replace(
        header, adapted=adapted, protocol_files=files, calibrations=files, quantities=(*header.quantities, vector)
    )
    with_pictures, seen = JournalWriter(path.with_suffix(".mcap"), header), made_up.observations(3.0)
    with_pictures.event(made_up.ARMED)
    with_pictures.samples(made_up.samples(3.0))
    with_pictures.observations(seen)
    rows = np.zeros(len(seen), adaptation_dtype(1))
    for name in ("t_ns", "frame"):
        rows[name] = seen[name]
    rows["used"], rows["value"], rows["covariance"] = 1, 0.4, 0.01
    rows["start_model_m"] = seen["model_m"]
    with_pictures.adaptations(rows)
    for index in range(5):
        with_pictures.picture(made_up.picture(index))
    end_ns = made_up.START_NS + 3_000_000_000
    with_pictures.close(RunFooter(end_ns, Status.FINISHED, "", {"ring_overflows": 0, "missed_deadlines": 2}))
    return finalise(with_pictures.path)


@pytest.fixture(scope="module")
def sound(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_everything(tmp_path_factory.mktemp("sound") / "run.h5")


@pytest.fixture
def copy(sound: Path, tmp_path: Path) -> Path:
    return Path(shutil.copy(sound, tmp_path / "copy.h5"))


def refusal(path: Path) -> ArchiveError:
    """The error of an archive that is refused, which is one line with its name."""
    with pytest.raises(ArchiveError, match=path.name) as caught:
        runs.open(path)
    assert "\n" not in str(caught.value)
    return caught.value


def flipped(content: bytes, place: int, bit: int) -> bytes:
    changed = bytearray(content)
    changed[place] ^= 1 << bit
    return bytes(changed)


def test_a_sound_archive_is_read(sound: Path) -> None:
    assert runs.open(sound).adaptation is not None


def test_an_archive_that_was_copied_moved_or_renamed_is_read(sound: Path, tmp_path: Path) -> None:
    copied = Path(shutil.copy(sound, tmp_path / "other name.h5"))
    os.utime(copied, (0, 0))
    assert runs.open(copied).sha256 == runs.open(sound).sha256


def test_a_flipped_bit_is_found_wherever_it_is(sound: Path, copy: Path) -> None:
    content = sound.read_bytes()
    trailer = range(len(content) - digest.TRAILER_BYTES, len(content))
    random = np.random.default_rng(1)
    places = [(place, bit) for place in (*range(8), *trailer) for bit in range(8)]
    places += [(int(random.integers(len(content))), int(random.integers(8))) for _ in range(300)]
    missed = []
    for place, bit in places:
        copy.write_bytes(flipped(content, place, bit))
        try:
            digest.checked(copy)
        except DamagedArchiveError:
            continue
        except ArchiveError:
            assert place in trailer or place < 8
            continue
        missed.append((place, bit))
    assert missed == []


def overwritten(content: bytes, random: np.random.Generator) -> bytes:
    size = int(random.integers(1, 600))
    place = int(random.integers(len(content) - size))
    return (
        content[:place]
        + [bytes(size), b"\xff" * size, random.bytes(size)][random.integers(3)]
        + content[place + size :]
    )


def cut_off(content: bytes, random: np.random.Generator) -> bytes:
    return content[: random.integers(len(content))]


def with_bytes_missing(content: bytes, random: np.random.Generator) -> bytes:
    place = int(random.integers(len(content) - 64))
    return content[:place] + content[place + int(random.integers(1, 64)) :]


def with_bytes_twice(content: bytes, random: np.random.Generator) -> bytes:
    place = int(random.integers(len(content) - 64))
    return content[: place + int(random.integers(1, 64))] + content[place:]


DAMAGES = (overwritten, cut_off, with_bytes_missing, with_bytes_twice)


@pytest.mark.parametrize("damage", DAMAGES)
def test_an_archive_with_other_bytes_is_refused(
    sound: Path, copy: Path, damage: Callable[[bytes, np.random.Generator], bytes]
) -> None:
    content = sound.read_bytes()
    for seed in range(30):
        copy.write_bytes(damage(content, np.random.default_rng(seed)))
        if copy.read_bytes() != content:
            refusal(copy)


@pytest.mark.fuzz
def test_no_damaged_archive_is_read(sound: Path, copy: Path) -> None:
    content = sound.read_bytes()
    first = int(os.environ.get("FUZZ_SEED", secrets.randbits(32)))
    for seed in range(first, first + SEARCHED):
        random = np.random.default_rng(seed)
        copy.write_bytes(DAMAGES[random.integers(len(DAMAGES))](content, random))
        if copy.read_bytes() != content:
            refusal(copy)


def spoil(path: Path, change: Callable[[h5py.File], object]) -> Path:
    with h5py.File(path, "r+") as file:
        change(file)
    return path


def put(path: str, **options: object) -> Callable[[h5py.File], object]:
    def change(file: h5py.File) -> object:
        units = file[path].attrs.get("units")
        del file[path]
        node = file.create_dataset(path, **options)
        if units is not None:
            node.attrs["units"] = units
        return node

    return change


def link(path: str, to: object) -> Callable[[h5py.File], object]:
    def change(file: h5py.File) -> None:
        del file[path]
        file[path] = to

    return change


def fill(path: str, value: object) -> Callable[[h5py.File], object]:
    def change(file: h5py.File) -> None:
        file[path][...] = value

    return change


def text_for_a_dimension_list(file: h5py.File) -> None:
    del file["entry/tip/measured_mm"].attrs["DIMENSION_LIST"]
    file["entry/tip/measured_mm"].attrs["DIMENSION_LIST"] = "time"


@pytest.mark.parametrize(
    "change",
    [
        put("entry/tip/error_mm", shape=(2_000_000_000,), dtype="f8", chunks=(1000,), fillvalue=1.0),
        put("entry/pressure/cycle", shape=(600,), dtype="i8", external=[("/etc/passwd", 0, 4800)]),
        link("entry/tip", h5py.SoftLink("/entry/pressure")),
        link("entry/rig/yaml", h5py.ExternalLink("/etc/passwd", "/")),
        fill("entry/tip/time", np.nan),
        fill("entry/tip/model_mm", np.inf),
        fill("entry/notes", b"caf\xe9"),
        text_for_a_dimension_list,
        lambda file: file["entry"].create_dataset("mine", data="a remark"),
    ],
)
def test_an_archive_that_another_program_changed_is_refused(copy: Path, change: Callable[[h5py.File], object]) -> None:
    assert isinstance(refusal(spoil(copy, change)), DamagedArchiveError)


def test_an_archive_whose_heap_never_ends_is_refused(copy: Path) -> None:
    content = bytearray(copy.read_bytes())
    heap = content.index(b"GCOL")
    # Index 0 is the free rest of a heap; HDF5 goes on by its size, and would never return.
    content[heap + 16 : heap + 32] = bytes(16)
    copy.write_bytes(content)
    refusal(copy)


@pytest.fixture
def damaged(copy: Path) -> Path:
    """An archive with a flipped bit in the numbers of its tip."""
    with h5py.File(copy) as file:
        place = file["entry/tip/time"].id.get_chunk_info(0).byte_offset
    copy.write_bytes(flipped(copy.read_bytes(), place + 20, 3))
    return copy


@pytest.mark.parametrize(
    "words",
    [
        ("show",),
        ("export", "--format", "csv"),
        ("report",),
        ("note", "a note"),
        ("replay", "--out", "replayed"),
        ("identify", "--free", "shear_ratio"),
        ("publish", "--creator", "Ada Lovelace", "--licence", "CC-BY-4.0"),
    ],
    ids=lambda words: str(words[0]),
)
def test_every_command_ends_with_one_sentence_and_status_1(
    damaged: Path, words: tuple[str, ...], capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(damaged.parent)
    assert status_of(words[0], damaged, *words[1:]) == 1
    said = capsys.readouterr()
    assert "copy.h5: damaged: its content does not have the SHA-256 that it ends with" in " ".join(said.err.split())
    assert [path.name for path in damaged.parent.iterdir()] == ["copy.h5"]


def test_a_damaged_archive_is_listed_with_its_problem(damaged: Path) -> None:
    (entry,) = catalogue(damaged.parent)
    assert "damaged" in entry.problem
    assert status_of("runs", damaged.parent) == 0


def test_force_reads_a_damaged_archive_as_far_as_possible(copy: Path, capsys: pytest.CaptureFixture[str]) -> None:
    spoil(copy, fill("entry/notes", "changed by hand"))
    refusal(copy)
    assert status_of("show", copy, "--force") == 0
    assert "changed by hand" in capsys.readouterr().out
    assert status_of("export", copy, "--force") == 0
    assert (copy.parent / "copy-tip.csv").exists()


def test_force_ends_in_one_sentence_where_nothing_can_be_read(
    damaged: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert status_of("export", damaged, "--force") in (1, 2)
    assert "entry/tip/time: cannot be read" in " ".join(capsys.readouterr().err.split())


def test_a_large_archive_is_read_once_for_its_digest(
    copy: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    read: list[int] = []
    of_content = digest._of_content
    monkeypatch.setattr(digest, "_of_content", lambda *file: read.append(1) or of_content(*file))
    monkeypatch.setattr(digest, "REMEMBERED_BYTES", 1000)
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    for _ in range(3):
        digest.checked(copy)
        digest._digests.clear()  # as in another process
    assert len(read) == 1
    time.sleep(0.01)
    copy.write_bytes(flipped(copy.read_bytes(), 5000, 0))
    refusal(copy)
    # A folder in which others can write is not believed.
    (tmp_path / "cache" / "softrig" / "digests").chmod(0o777)
    shutil.copy(copy, tmp_path / "again.h5")
    for _ in range(2):
        with pytest.raises(DamagedArchiveError):
            digest.checked(tmp_path / "again.h5")


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (put("entry/tip/time", data=["x"] * 90), "entry/tip/time: found text of shape .90,., expected 64-bit floats"),
        (
            put("entry/tip/error_mm", data=np.zeros(80)),
            r"entry/tip/error_mm: found shape .80,., expected .90,. .as entry/tip/time",
        ),
        (put("entry/notes", data=np.float64(1)), "entry/notes: found 64-bit floats of shape .., expected text"),
        (lambda f: f["entry"].move("tip", "top"), "entry/tip: found nothing, expected a group"),
        (put("entry/backbone/time", data=np.zeros(3)), "entry/backbone/time: found shape .3,., expected .90,."),
        (
            lambda f: f["entry/tip/error_mm"].attrs.modify("units", "m"),
            "entry/tip/error_mm@units: found 'm', expected 'mm'",
        ),
    ],
)
def test_an_archive_of_another_structure_is_refused(
    copy: Path, change: Callable[[h5py.File], object], said: str
) -> None:
    with changed(copy) as file:
        change(file)
    with pytest.raises(ArchiveError, match=rf"copy\.h5: {said}"):
        runs.open(copy)


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (fill("entry/status", "well"), "entry/status: found 'well', expected one of finished, interrupted, aborted"),
        (fill("entry/tip/seen", 9), r"entry/tip/seen.0.: found 9, expected one of 0, 1, 2"),
    ],
)
def test_a_value_that_is_none_of_its_enumeration_is_reported_when_it_is_read(
    copy: Path, change: Callable[[h5py.File], object], said: str
) -> None:
    with changed(copy) as file:
        change(file)
    run = runs.open(copy)
    with pytest.raises(ArchiveError, match=rf"copy\.h5: {said}"):
        assert [run.header, run.status, run.tip]


@pytest.mark.parametrize("rig", ["../../etc/passwd", "name: [unclosed", "- 1", "calibrations: 5"])
def test_inputs_are_exported_of_an_archive_with_any_rig_text_or_refused(copy: Path, tmp_path: Path, rig: str) -> None:
    with changed(copy) as file:
        file["entry/rig/yaml"][...] = rig
    if rig == "calibrations: 5":
        assert export(copy, "yaml", tmp_path)
        return
    with pytest.raises(ArchiveError, match=r"copy\.h5: entry/rig/yaml: found no YAML mapping"):
        export(copy, "yaml", tmp_path)


def test_datasets_that_no_archive_has_are_ignored(copy: Path) -> None:
    with changed(copy) as file:
        file["entry"].create_dataset("mine", data="a remark")
    assert runs.open(copy).header.operator == "A. Tester"


def test_an_archive_that_changes_while_it_is_open_is_refused(copy: Path) -> None:
    run = runs.open(copy)
    spoil(copy, put("entry/tip/error_mm", data=np.zeros(80)))
    with pytest.raises(DamagedArchiveError):
        _ = run.tip
