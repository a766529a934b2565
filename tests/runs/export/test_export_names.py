"""Exports hold every field of an archive: their names are compared with the schema of archives."""

from __future__ import annotations

import csv
import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from mcap.reader import make_reader
from scipy.io import loadmat

from runs.archive import column_groups, schema
from runs.archive.checked import opened
from runs.archive.column_groups import TableGroup
from runs.archive.layout import split_unit
from runs.archive.writer import finalise
from runs.columns.conversions import time_column
from runs.columns.declaration import Column, Table
from runs.export.exporters import export
from tests.support.full_run import write_full_journal
from tests.support.synthetic_runs import ACTUATORS, VALVES


@pytest.fixture(scope="module")
def archive(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return finalise(write_full_journal(tmp_path_factory.mktemp("full") / "run.mcap"))


def declared(archive: Path) -> dict[str, set[str]]:
    """{group: names} of all fields that the schema declares and this archive has, but labels of others and pictures."""
    found: dict[str, set[str]] = {}
    with opened(archive) as content:
        for group in schema.schema(ACTUATORS, VALVES):
            fields = content.fields(group.path)
            assert fields, f"{group.path} is not in the archive of the test: add it to tests/support/full_run.py"
            assert set(group.datasets) <= set(fields)
            labels = {scale for field in fields.values() for scale in field.scales} - {"time"}
            labels |= {name for name in fields if name.startswith("component_")}
            found[group.path.removeprefix("entry").strip("/")] = set(fields) - labels - {"image"}
    return found


def holds(names: set[str], field: str) -> bool:
    """Whether a table has a column of a field, whatever its label and unit."""
    plain = split_unit(field)[0]
    return any(name in (field, plain) or name.startswith(f"{plain}_") for name in names)


def missing(archive: Path, tables: dict[str, set[str]], facts: set[str]) -> list[str]:
    """The declared fields that are neither a column of their group's table nor among the facts."""
    return [
        f"{group}/{field}"
        for group, fields in declared(archive).items()
        for field in fields
        if f"{group}/{field}".strip("/") not in facts and not holds(tables.get(group.replace("/", "-"), set()), field)
    ]


def csv_names(archive: Path, folder: Path) -> tuple[dict[str, set[str]], set[str]]:
    tables, facts = {}, set[str]()
    for path in export(archive, "csv", folder):
        with path.open(encoding="utf-8", newline="") as file:
            rows = csv.DictReader(file)
            name = path.stem.removeprefix("run-")
            tables["protocol" if name == "segments" else name] = set(rows.fieldnames or ())
            facts |= {row["field"] for row in rows} if name == "facts" else set()
    return tables, facts


def mcap_names(archive: Path, folder: Path) -> tuple[dict[str, set[str]], set[str]]:
    (path,) = export(archive, "mcap", folder)
    tables: dict[str, set[str]] = {}
    facts = set[str]()
    with path.open("rb") as file:
        reader = make_reader(file)
        for schema_, channel, _ in reader.iter_messages():
            assert schema_ is not None
            properties = json.loads(schema_.data)["properties"]
            tables[channel.topic.strip("/")] = {"time_s", *properties}
        for record in reader.iter_metadata():
            facts |= {name.split(" ")[0] for name in record.metadata} if record.name == "facts" else set()
    return tables, facts


def test_csv_holds_every_declared_field(archive: Path, tmp_path: Path) -> None:
    assert missing(archive, *csv_names(archive, tmp_path)) == []


def test_mcap_holds_every_declared_field_but_events_pictures_and_segments_which_it_has_as_foxgloves(
    archive: Path, tmp_path: Path
) -> None:
    tables, facts = mcap_names(archive, tmp_path)
    assert {"events", "front/image", "front/marks", "arm"} <= set(tables)
    own = ("events/", "frames/", "protocol/")
    assert [name for name in missing(archive, tables, facts) if not name.startswith(own)] == []


def test_matlab_holds_every_declared_field(archive: Path, tmp_path: Path) -> None:
    (path,) = export(archive, "mat", tmp_path)
    found: dict[str, Any] = loadmat(path, simplify_cells=True)["run"]
    for group, fields in declared(archive).items():
        content = found
        for name in filter(None, group.split("/")):
            content = content[name]
        assert {name.replace(".", "_") for name in fields} <= set(content)


def test_a_column_has_its_labels_and_its_unit_once(archive: Path, tmp_path: Path) -> None:
    tables, _ = csv_names(archive, tmp_path)
    assert {"setpoint_2_bar", "late_ms", "sequence"} <= tables["stream"]
    assert {"clock_offset_s", "clock_drift_ppm", "messages_lost"} <= tables["tracker"]
    assert {"disturbance_x_mm"} <= tables["learning"]
    assert {"plan_0.1_2_bar", "start_s"} <= tables["tip_control"]
    assert {"value_shear_ratio", "value_mass_g", "covariance_shear_ratio_mass_g"} <= tables["adaptation"]
    assert {"model_0.5_z_mm"} <= tables["backbone"]
    assert {"cross_covariance_x_ry_mm_deg", "camera_seen_side"} <= tables["tip"]
    assert {"value_load_N", "value_room_degC"} <= tables["aux"]
    assert {"corners_1_u_px", "camera"} <= tables["frames"]


def test_facts_have_label_unit_uncertainty_and_source(archive: Path, tmp_path: Path) -> None:
    export(archive, "csv", tmp_path)
    with (tmp_path / "run-facts.csv").open(encoding="utf-8", newline="") as file:
        rows = {(row["field"], row["of"]): row for row in csv.DictReader(file)}
    fx = rows["calibration/front.lens.fx", ""]
    assert (fx["value"], fx["unit"], fx["uncertainty"], fx["source"]) == ("900.0", "px", "1.5", "rig.yaml")
    assert rows["adaptation/start", "mass"]["value"] == "50.0"
    assert rows["model/angles", "2"]["value"] == "120.0"
    assert not any(field.startswith("model/component") for field, _ in rows)
    assert rows["calibration_files/yaml", "c.yaml"]["value"] == "a: 1"
    assert rows["learning/run", "2"]["value"] == "earliest"
    assert rows["protocol/yaml", ""]["value"] == "name: stairs\n# µ and ° survive\n"
    assert {row["simulated"] for row in rows.values()} == {"1"}


class Weather(Table):
    """A group that is declared, and nothing else."""

    group, rows, signal = "weather", "M", "wind"
    about = "of the laboratory"

    time_s = time_column("of the frame")
    wind = Column(of=lambda rows: np.ones(len(rows)), unit="m/s", about="its speed")


@pytest.fixture
def weather(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    groups = (*column_groups.TABLE_GROUPS, TableGroup(Weather, "observations"))
    monkeypatch.setattr(column_groups, "TABLE_GROUPS", groups)
    schema.schema.cache_clear()
    yield
    schema.schema.cache_clear()


@pytest.mark.usefixtures("weather")
def test_a_declared_group_reaches_every_export(tmp_path: Path) -> None:
    archive = finalise(write_full_journal(tmp_path / "run.mcap"))
    assert csv_names(archive, tmp_path)[0]["weather"] == {"time_s", "wind_m/s", "simulated"}
    assert mcap_names(archive, tmp_path)[0]["weather"] == {"time_s", "wind_m/s"}
    (path,) = export(archive, "mat", tmp_path)
    assert loadmat(path, simplify_cells=True)["run"]["weather"]["wind"].tolist() == [1.0] * 4
