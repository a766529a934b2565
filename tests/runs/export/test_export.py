"""Exports: the same numbers, read back by other programs' readers."""

from __future__ import annotations

import csv
import dataclasses
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from scipy.io import loadmat

import runs
import tests.support.synthetic_runs as made_up
from runs.archive.writer import ArchiveError, finalise
from runs.export.exporters import ExportError, ExportWriteError, export
from runs.journal.journal import JournalWriter
from runs.records import Event, Level, RunFooter, Status
from runs.table import table


@pytest.fixture(scope="module")
def archive(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("export") / "20260102-run.mcap"
    made_up.write_journal(path)
    return finalise(path)


def test_a_table_has_one_column_for_each_actuator_and_axis_with_its_unit(archive: Path) -> None:
    run = runs.open(archive)
    pressure, tip = table(archive, "pressure"), table(archive, "tip")
    assert next(iter(pressure)) == "time_s"
    np.testing.assert_array_equal(pressure["measured_2_bar"], run.pressure.measured_bar[:, 1])
    np.testing.assert_array_equal(pressure["valve_2_V"], run.pressure.valve_v[:, 1])
    np.testing.assert_array_equal(tip["model_z_mm"], run.tip.model_mm[:, 2])
    np.testing.assert_array_equal(tip["covariance_yy_mm2"], run.tip.covariance_mm2[:, 1, 1])
    assert {"protocol_time_s", "error_mm", "reprojection_px", "frame", "seen"} <= set(tip)
    assert "axis" not in tip
    assert table(archive, "nothing") == {}


@pytest.mark.parametrize("rows", [1, 3, 6])
def test_a_run_with_as_many_rows_as_axes_is_not_confused(tmp_path: Path, rows: int) -> None:
    path = tmp_path / "few.mcap"
    writer = JournalWriter(path, made_up.header("few"))
    writer.observations(made_up.observations(1.0)[:rows])
    writer.close(RunFooter(made_up.START_NS, Status.FINISHED, ""))
    columns = table(finalise(path), "tip")
    assert {"axis", "component", "actuator"}.isdisjoint(columns)
    assert {len(column) for column in columns.values()} == {rows}


def test_csv_holds_every_digit(archive: Path, tmp_path: Path) -> None:
    written = {path.name: path for path in export(archive, "csv", tmp_path / "new")}
    groups = ("backbone", "events", "facts", "frames", "pressure", "segments", "simulator", "timing", "tip")
    assert sorted(written) == [f"20260102-run-{group}.csv" for group in groups]
    with written["20260102-run-tip.csv"].open(encoding="utf-8") as file:
        rows = list(csv.DictReader(file))
    run = runs.open(archive)
    np.testing.assert_array_equal([float(row["model_x_mm"]) for row in rows], run.tip.model_mm[:, 0])
    assert rows[10]["measured_x_mm"] == ""
    assert rows[10]["seen"] == "1"


def test_csv_tells_the_segments_that_rows_belong_to_by_protocol_time(archive: Path, tmp_path: Path) -> None:
    written = {path.stem.rpartition("-")[2]: pd.read_csv(path) for path in export(archive, "csv", tmp_path)}
    segments, tip = written["segments"], written["tip"]
    assert segments["label"].tolist() == ["step 1", "step 2", "step 3"]
    assert segments["kind"].tolist() == ["step"] * 3
    assert segments["level_1_bar"].tolist() == pytest.approx([0.05, 0.1, 0.15])
    second = segments.loc[1]
    own = tip[(tip["protocol_time_s"] > second["start_s"]) & (tip["protocol_time_s"] <= second["stop_s"])]
    assert own["protocol_time_s"].min() == pytest.approx(1.0 + 1 / 30)
    assert len(own) == 30


def test_csv_quotes_what_was_written_by_people(tmp_path: Path) -> None:
    path = tmp_path / "odd.mcap"
    writer = JournalWriter(path, made_up.header("odd"))
    said = 'he said "stop",\nand µ'
    writer.event(Event(made_up.START_NS, Level.WARNING, "operator", said))
    writer.close(RunFooter(made_up.START_NS, Status.FINISHED, ""))
    export(finalise(path), "csv")
    with (tmp_path / "odd-events.csv").open(encoding="utf-8", newline="") as file:
        assert next(csv.DictReader(file))["message"] == said


@pytest.mark.parametrize("simulated", [True, False])
def test_every_row_of_a_csv_says_whether_it_was_simulated(tmp_path: Path, simulated: bool) -> None:
    made_up.write_journal(tmp_path / "run.mcap", duration_s=0.1, simulated=simulated)
    for path in export(finalise(tmp_path / "run.mcap"), "csv"):
        read = pd.read_csv(path)
        assert len(read) > 0
        assert read.columns[-1] == "simulated"
        assert (read["simulated"] == int(simulated)).all()


def test_matlab_gets_a_struct_of_the_groups(archive: Path) -> None:
    (path,) = export(archive, "mat")
    assert path == archive.with_suffix(".mat")
    found = loadmat(path, simplify_cells=True)["run"]
    run = runs.open(archive)
    np.testing.assert_array_equal(found["tip"]["measured_mm"], run.tip.measured_mm)
    np.testing.assert_array_equal(found["pressure"]["measured_bar"], run.pressure.measured_bar)
    assert found["title"] == "Staircase of actuator 1"
    assert found["calibration"]["front_lens_fx"] == 900.0
    assert "image" not in found["frames"]


def test_names_that_matlab_cannot_hold_stay_apart(tmp_path: Path) -> None:
    path = tmp_path / "names.mcap"
    plain = made_up.header("names")
    names = ("a.b", "a b", "1st", "µ", "n" * 80, "n" * 81)
    odd = tuple(dataclasses.replace(plain.quantities[0], name=n, value=(float(i),)) for i, n in enumerate(names))
    writer = JournalWriter(path, dataclasses.replace(plain, quantities=odd))
    writer.close(RunFooter(made_up.START_NS, Status.FINISHED, ""))
    (mat,) = export(finalise(path), "mat")
    found = loadmat(mat, simplify_cells=True)["run"]["calibration"]
    assert sorted(found.values()) == [0.0, 1.0, 2.0, 3.0, 4.0, 5.0]
    assert all(name.isidentifier() and len(name) <= 63 for name in found)


@pytest.mark.parametrize("to", ["csv", "mat", "mcap"])
def test_titles_and_names_in_any_language_are_exported(tmp_path: Path, to: str) -> None:
    path = tmp_path / "odd.mcap"
    words = dataclasses.replace(made_up.header("odd"), title="Größe 腕", operator="Ada Ł", cameras=("vorn/µ",))
    writer = JournalWriter(path, words)
    writer.observations(made_up.observations(0.2))
    writer.close(RunFooter(made_up.START_NS, Status.FINISHED, ""))
    written = export(finalise(path), to)
    assert all(made.stat().st_size > 0 for made in written)


@pytest.mark.parametrize("to", ["csv", "mat"])
def test_an_empty_run_can_be_exported(tmp_path: Path, to: str) -> None:
    path = tmp_path / "empty.mcap"
    made_up.write_journal(path, duration_s=0.0, pictures=0)
    assert all(written.exists() for written in export(finalise(path), to))


def test_invalid_requests_are_refused_in_one_sentence(archive: Path, tmp_path: Path) -> None:
    with pytest.raises(ExportError, match="there are csv, mat, mcap"):
        export(archive, "xlsx")
    with pytest.raises(ArchiveError, match="no such archive"):
        export(tmp_path / "none.h5", "csv")
    (tmp_path / "file").touch()
    with pytest.raises(ExportWriteError, match="cannot write to"):
        export(archive, "csv", tmp_path / "file")
