"""A column is declared once: record, journal, archive, checks and exports follow."""

from __future__ import annotations

import csv
from collections.abc import Iterator
from pathlib import Path

import h5py
import numpy as np
import pytest

import runs
import tests.support.synthetic_runs as made_up
from runs.archive import layout, schema
from runs.archive.writer import ArchiveError, finalise
from runs.columns import TABLES, Tip
from runs.columns.declaration import Column
from runs.export.exporters import export
from runs.journal.journal import JournalWriter
from runs.records import RunFooter, Status, adaptation_dtype, blank, observation_dtype, pulse_dtype, sample_dtype
from tests.support.changed_archive import changed


@pytest.fixture
def humidity(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    """A column that is declared, and nothing else."""
    column = Column("humidity_percent", unit="%", about="of the air")
    column.__set_name__(Tip, "humidity_percent")
    monkeypatch.setattr(Tip, "humidity_percent", column, raising=False)
    schema.schema.cache_clear()
    yield
    schema.schema.cache_clear()


@pytest.fixture
def newer_humidity(humidity: None, monkeypatch: pytest.MonkeyPatch) -> int:
    """The column came with a layout after the present one, which softrig now writes."""
    newer = layout.VERSION + 1
    monkeypatch.setattr(Tip.humidity_percent, "since", newer)
    monkeypatch.setattr(layout, "VERSION", newer)
    return newer


def written(folder: Path, humidity_percent: float) -> Path:
    writer = JournalWriter(folder / "run.mcap", made_up.header("run"))
    rows = blank(4, observation_dtype(made_up.ACTUATORS))
    rows["t_ns"] = made_up.START_NS + np.arange(4) * 33_000_000
    rows["humidity_percent"][:3] = humidity_percent
    writer.observations(rows)
    writer.close(RunFooter(made_up.START_NS, Status.FINISHED, ""))
    return finalise(writer.path)


@pytest.mark.usefixtures("humidity")
def test_a_declared_column_reaches_archive_reader_and_exports(tmp_path: Path) -> None:
    archive = written(tmp_path, 43.5)
    with h5py.File(archive) as file:
        stored = file["entry/tip/humidity_percent"]
        assert (stored.attrs["units"], stored.attrs["description"]) == ("%", "of the air")
        assert stored.dims[0][0] == file["entry/tip/time"]
    np.testing.assert_array_equal(runs.open(archive).tip.values["humidity_percent"], [43.5, 43.5, 43.5, np.nan])
    tables = {path.name: path for path in export(archive, "csv", tmp_path)}
    rows = list(csv.DictReader(tables["run-tip.csv"].read_text().splitlines()))
    assert [row["humidity_percent_%"] for row in rows] == ["43.5", "43.5", "43.5", ""]


def test_an_archive_from_before_a_column_reads_it_as_missing(tmp_path: Path, newer_humidity: int) -> None:
    archive = written(tmp_path, 43.5)
    with changed(archive) as file:
        file.attrs["layout_version"] = newer_humidity - 1
        del file["entry/tip/humidity_percent"]
    found = runs.open(archive).tip
    np.testing.assert_array_equal(found.values["humidity_percent"], [np.nan] * 4)
    assert found.model_mm.shape == (4, 3)


def test_an_archive_of_the_columns_layout_must_have_it(tmp_path: Path, newer_humidity: int) -> None:
    archive = written(tmp_path, 43.5)
    with changed(archive) as file:
        assert file.attrs["layout_version"] == newer_humidity
        del file["entry/tip/humidity_percent"]
    with pytest.raises(ArchiveError, match="entry/tip/humidity_percent: found nothing"):
        runs.open(archive)


def test_a_record_that_is_not_filled_is_missing_and_not_zero() -> None:
    zero = {"weight_kg", "force_n", "moment_n_m"}
    for dtype in (sample_dtype(3, 2, 4), observation_dtype(3, 2, triggered=True), adaptation_dtype(4), pulse_dtype()):
        rows = blank(2, dtype)
        for name in dtype.names or ():
            if dtype[name].base.kind == "f":
                assert np.isnan(rows[name]).all() == (name not in zero), name
            assert name not in zero or not rows[name].any()


def test_every_column_says_what_it_is() -> None:
    for table in TABLES:
        for column in table.columns():
            assert column.about, (table, column.name)
            assert bool(column.record) != (column.of is not None), (table, column.name)
