"""The records of a run follow from its archive again, as a replay copies them."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

import runs
from runs.archive.writer import finalise
from runs.columns import Learning, Pressure, Reference
from runs.columns.declaration import Column
from runs.journal.journal import JournalWriter
from runs.journal.row_kinds import ROW_KINDS
from runs.records import RunFooter, RunHeader, Status
from runs.run import Run
from tests.support import synthetic_runs
from tests.support.full_run import write_full_journal

ROWS = 5
KINDS = tuple(kind for kind in ROW_KINDS if kind.name != "adaptations")
"""A replay adapts nothing."""


def filled(dtype: np.dtype[np.void]) -> NDArray[np.void]:
    """Rows with another value in every field; all of them are allowed."""
    random = np.random.default_rng(0)
    rows = np.zeros(ROWS, dtype)
    for name in dtype.names or ():
        base, shape = dtype[name].base, rows[name].shape
        most = 1_000_000 if base == np.int64 else 2
        rows[name] = random.random(shape) if base.kind == "f" else random.integers(0, most, shape)
    rows["t_ns"] = synthetic_runs.START_NS + np.arange(ROWS) * 33_333_333
    return rows


def archived(folder: Path, header: RunHeader) -> tuple[Run, dict[str, NDArray[np.void]]]:
    """An archive of rows of every kind, and the rows."""
    rows = {kind.name: filled(kind.dtype(header)) for kind in KINDS}
    writer = JournalWriter(folder / "filled.mcap", header)
    for name, some in rows.items():
        getattr(writer, name)(some)
    writer.close(RunFooter(synthetic_runs.START_NS, Status.FINISHED, ""))
    return runs.open(finalise(writer.path)), rows


@pytest.fixture(scope="module")
def header(tmp_path_factory: pytest.TempPathFactory) -> RunHeader:
    """The header of a run that records rows of every kind."""
    return runs.open(finalise(write_full_journal(tmp_path_factory.mktemp("full") / "full.mcap"))).header


def test_every_recorded_column_that_a_replay_copies_is_restored(tmp_path: Path, header: RunHeader) -> None:
    run, rows = archived(tmp_path, header)
    for kind in KINDS:
        if kind.name != "observations":
            restored = run.rows(kind)
            for name in restored.dtype.names or ():
                np.testing.assert_allclose(restored[name], rows[kind.name][name], rtol=1e-12, err_msg=name)
                assert restored[name].dtype.kind == "f" or np.array_equal(restored[name], rows[kind.name][name]), name


@pytest.mark.parametrize("kind", [Reference, Learning])
def test_what_a_frame_was_given_is_restored(
    tmp_path: Path, header: RunHeader, kind: type[Reference | Learning]
) -> None:
    run, rows = archived(tmp_path, header)
    table = {Reference: run.reference, Learning: run.learning}[kind]
    assert table is not None
    restored = np.zeros_like(rows["observations"])
    table.set_fields(restored)
    table.set_fields(restored[1:2], 3)
    for name in {column.record for column in kind.columns()} - {"", "t_ns"}:
        expected = rows["observations"][name][[0, 3, 2, 3, 4]]
        np.testing.assert_allclose(restored[name], expected, rtol=1e-12, err_msg=name)


def test_a_converted_column_without_an_inverse_is_named() -> None:
    column = Column("humidity", about="of the air", convert=lambda share: share * 100)
    column.__set_name__(Pressure, "humidity_percent")
    with pytest.raises(TypeError, match="column humidity_percent: expected `inverse`, which gives humidity"):
        column.recorded(np.zeros(3))
