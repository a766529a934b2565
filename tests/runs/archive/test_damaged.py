"""Damaged archives: every reader refuses them in one sentence, and none crashes."""

from __future__ import annotations

import json
import os
import secrets
import select
import shutil
import subprocess
import sys
import zlib
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path

import h5py
import numpy as np
import pytest

import runs
import tests.support.archive_mutations as damage
import tests.support.synthetic_runs as made_up
from runs.archive.writer import ArchiveError, finalise
from runs.export.exporters import export
from runs.journal.journal import JournalWriter
from runs.records import Quantity, RecordedFile, RunFooter, Status, adaptation_dtype
from scripts.rig_process import BRIEF

ROOT = Path(__file__).parents[3]
PATIENCE_S = 300.0
SEARCHED = 1200
"""Archives that a search damages."""
THOROUGH = 0.2
"""Share of them that are also reported, replayed and identified from."""


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


class Readers:
    """A process that tries every reader on archives; another one where it died."""

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        self._process: subprocess.Popen[str] | None = None

    def troubles(self, path: Path, *, thorough: bool) -> list[str]:
        """Return what went wrong with an archive."""
        process = self._process = self._process or self._start()
        assert process.stdin is not None
        assert process.stdout is not None
        process.stdin.write(json.dumps([str(path), thorough]) + "\n")
        process.stdin.flush()
        ready, _, _ = select.select([process.stdout], [], [], PATIENCE_S)
        line = process.stdout.readline() if ready else ""
        if line:
            found: list[str] = json.loads(line)
            return found
        self.close()
        return [f"the process ended with {process.returncode}" if ready else "no answer"]

    def close(self) -> None:
        if self._process is not None:
            self._process.kill()
            self._process.communicate()
            self._process = None

    def _start(self) -> subprocess.Popen[str]:
        program = [sys.executable, "-m", "tests.support.archive_readers"]
        environment = {**os.environ, "COLUMNS": "200", "PYTHONPATH": str(ROOT)}
        return subprocess.Popen(
            program, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True, cwd=self._folder, env=environment
        )


@pytest.fixture(scope="module")
def readers(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Readers]:
    process = Readers(tmp_path_factory.mktemp("readers"))
    yield process
    process.close()


def tried(source: Path, folder: Path, seed: int, readers: Readers, thorough: bool, *mutations: object) -> list[str]:
    """Damage an archive, try every reader on it, and return what went wrong."""
    place = folder / str(seed)
    place.mkdir()
    path = place / "damaged.h5"
    chosen = mutations or damage.STRUCTURE + damage.BYTES
    said = damage.mutant(source, path, seed, chosen)  # type: ignore[arg-type]
    found = readers.troubles(path, thorough=thorough)
    shutil.rmtree(place)
    return [f"seed {seed}, {said}: {trouble}" for trouble in found]


def test_a_sound_archive_is_read_by_all(sound: Path, readers: Readers) -> None:
    assert readers.troubles(sound, thorough=False) == []
    assert runs.open(sound).adaptation is not None


@pytest.mark.slow
@pytest.mark.parametrize("mutation", damage.STRUCTURE + damage.BYTES, ids=lambda mutation: str(mutation.__name__))
def test_a_damaged_archive_is_read_or_refused(
    sound: Path, tmp_path: Path, readers: Readers, mutation: Callable[..., str]
) -> None:
    assert tried(sound, tmp_path, 1, readers, False, mutation) == []


@pytest.mark.fuzz
def test_no_damaged_archive_crashes_a_reader(sound: Path, tmp_path: Path, readers: Readers) -> None:
    (tmp_path / "brief.yaml").write_text(BRIEF)
    command = ["run", "brief.yaml", "--fast", "--yes", "--no-report", "--adapt", "--out", "real"]
    subprocess.run([sys.executable, "-m", "rig", *command], cwd=tmp_path, check=True, capture_output=True)
    (real,) = (tmp_path / "real").glob("*.h5")
    first = int(os.environ.get("FUZZ_SEED", secrets.randbits(32)))
    found = []
    for seed in range(first, first + SEARCHED):
        random = np.random.default_rng(seed)
        source, thorough = (real if random.random() < 0.5 else sound), random.random() < THOROUGH
        found += tried(source, tmp_path, seed, readers, thorough)
    assert found == [], f"FUZZ_SEED={first} finds these again"


def spoil(path: Path, change: Callable[[h5py.File], object]) -> Path:
    with h5py.File(path, "r+") as file:
        change(file)
    return path


def put(path: str, **options: object) -> Callable[[h5py.File], object]:
    def change(file: h5py.File) -> object:
        del file[path]
        return file.create_dataset(path, **options)

    return change


def compressed_zeros(path: str, rows: int) -> Callable[[h5py.File], object]:
    def change(file: h5py.File) -> None:
        del file[path]
        chunk = rows // 100
        node = file.create_dataset(path, shape=(rows,), dtype="i8", chunks=(chunk,), compression=9)
        packed = zlib.compress(bytes(8 * chunk), 9)
        for low in range(0, rows, chunk):
            node.id.write_direct_chunk((low,), packed)

    return change


def link(path: str, to: object) -> Callable[[h5py.File], object]:
    def change(file: h5py.File) -> None:
        del file[path]
        file[path] = to

    return change


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (put("entry/tip/time", data=["x"] * 90), "entry/tip/time: found text of shape .90,., expected 64-bit floats"),
        (
            put("entry/tip/error_mm", data=np.zeros(80)),
            r"entry/tip/error_mm: found shape .80,., expected .90,. .as entry/tip/time",
        ),
        (
            put("entry/tip/error_mm", shape=(2_000_000_000,), dtype="f8", chunks=(1000,), fillvalue=1.0),
            "entry/tip/error_mm: found 0 stored chunks",
        ),
        (put("entry/notes", data=np.float64(1)), "entry/notes: found 64-bit floats of shape .., expected text"),
        (lambda f: f["entry"].move("tip", "top"), "entry/tip: found nothing, expected a group"),
        (link("entry/tip", h5py.SoftLink("/entry/pressure")), "entry/tip: found a link to elsewhere, expected a group"),
        (link("entry/rig/yaml", h5py.ExternalLink("/etc/passwd", "/")), "entry/rig/yaml: found a link to elsewhere"),
        (link("entry/backbone/time", np.zeros(3)), "entry/backbone/time: found shape .3,., expected .90,."),
        (
            put("entry/pressure/cycle", shape=(600,), dtype="i8", external=[("/etc/passwd", 0, 4800)]),
            "entry/pressure/cycle: found data that is stored elsewhere, expected data in the file itself",
        ),
        (
            compressed_zeros("entry/pressure/cycle", 100_000_000),
            "all datasets together: found .* bytes once read, expected at most",
        ),
    ],
)
def test_a_wrong_structure_is_reported_when_the_archive_is_opened(
    copy: Path, change: Callable[[h5py.File], object], said: str
) -> None:
    spoil(copy, change)
    with pytest.raises(ArchiveError, match=rf"copy\.h5: {said}") as caught:
        runs.open(copy)
    assert "\n" not in str(caught.value)


def fill(path: str, value: object) -> Callable[[h5py.File], object]:
    def change(file: h5py.File) -> None:
        file[path][...] = value

    return change


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (fill("entry/status", "well"), "entry/status: found 'well', expected one of finished, interrupted, aborted"),
        (fill("entry/tip/seen", 9), r"entry/tip/seen.0.: found 9, expected one of 0, 1, 2"),
        (fill("entry/tip/time", np.nan), r"entry/tip/time.0.: found nan, expected a number"),
        (fill("entry/tip/model_mm", np.inf), r"entry/tip/model_mm.0, 0.: found inf, expected -1e.12 to 1e.12"),
        (fill("entry/notes", b"caf\xe9"), r"entry/notes: found b'caf.xe9', expected UTF-8 .not so at byte 3"),
    ],
)
def test_an_invalid_value_is_reported_when_it_is_read(
    copy: Path, change: Callable[[h5py.File], object], said: str
) -> None:
    spoil(copy, change)
    run = runs.open(copy)
    with pytest.raises(ArchiveError, match=rf"copy\.h5: {said}"):
        assert [run.header, run.status, run.tip]


@pytest.mark.parametrize("rig", ["../../etc/passwd", "name: [unclosed", "- 1", "calibrations: 5"])
def test_inputs_are_exported_of_an_archive_with_any_rig_text_or_refused(copy: Path, tmp_path: Path, rig: str) -> None:
    spoil(copy, fill("entry/rig/yaml", rig))
    if rig == "calibrations: 5":
        assert export(copy, "yaml", tmp_path)
        return
    with pytest.raises(ArchiveError, match=r"copy\.h5: entry/rig/yaml: found no YAML mapping"):
        export(copy, "yaml", tmp_path)


def test_a_text_for_a_dimension_list_crashes_nothing(copy: Path, readers: Readers) -> None:
    for path in ("entry/tip/measured_mm", "entry/pressure/measured_bar", "entry/protocol/level_bar"):

        def change(file: h5py.File, path: str = path) -> None:
            del file[path].attrs["DIMENSION_LIST"]
            file[path].attrs["DIMENSION_LIST"] = "time"

        spoil(copy, change)
    assert readers.troubles(copy, thorough=False) == []


def test_a_heap_that_never_ends_is_refused(copy: Path, readers: Readers) -> None:
    content = bytearray(copy.read_bytes())
    heap = content.index(b"GCOL")
    # Index 0 is the free rest of a heap; the library goes on by its size.
    content[heap + 16 : heap + 32] = bytes(16)
    copy.write_bytes(content)
    assert readers.troubles(copy, thorough=False) == []
    with pytest.raises(ArchiveError, match=f"the global heap at byte {heap} has an empty object at byte {heap + 16}"):
        runs.open(copy)


def test_datasets_that_no_archive_has_are_ignored(copy: Path) -> None:
    spoil(copy, lambda f: f["entry"].create_dataset("mine", data="a remark"))
    assert runs.open(copy).header.operator == "A. Tester"


def test_an_archive_that_changed_is_checked_again(copy: Path) -> None:
    run = runs.open(copy)
    spoil(copy, put("entry/tip/error_mm", data=np.zeros(80)))
    with pytest.raises(ArchiveError, match="entry/tip/error_mm: found shape"):
        _ = run.tip
