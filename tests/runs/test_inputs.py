"""What a run was made from comes back out of its archive, and makes the same run again."""

from __future__ import annotations

import hashlib
import re
import shutil
from dataclasses import replace
from pathlib import Path

import h5py
import numpy as np
import pytest

import runs
import tests.support.synthetic_runs as made_up
from protocols import BadInputError
from rig.config import loader
from rig.config.calibration_files import write
from rig.experiment.replay import replay
from runs.archive.writer import finalise
from runs.export.exporters import export
from runs.journal import journal
from runs.records import RecordedFile, RunFooter, Status
from runs.report.page import page
from tests.rig.config.test_calibration_files import camera_file
from tests.support.report_text import without_figures
from tests.support.virtual_runs import virtual_run

CSV = "time_s,actuator_1_bar\n0,0\n0.2,0.1\n0.4,0.1\n"


def test_a_run_can_be_repeated_when_its_files_are_gone(tmp_path: Path) -> None:
    source = tmp_path / "away" / "protocols"
    source.mkdir(parents=True)
    protocol, csv = source / "played.yaml", source.parent / "samples.csv"
    protocol.write_text("title: Played\nsteps:\n  - csv: {file: ../samples.csv, actuators: [1]}\n")
    csv.write_text(CSV)
    first = virtual_run(protocol, folder=tmp_path / "first")
    text = protocol.read_text()
    protocol.unlink()
    csv.unlink()

    (stored,) = first.header.protocol_files
    assert (stored.name, stored.text) == ("../samples.csv", CSV)
    assert stored.sha256 == hashlib.sha256(CSV.encode()).hexdigest()
    assert first.header.protocol_yaml == text
    recorded = journal.read(first.path.with_suffix(".mcap")).header
    assert recorded.protocol_files == first.header.protocol_files
    assert runs.open(replay(first, tmp_path)).header.protocol_files == first.header.protocol_files

    written = {path.name: path for path in export(first.path, "yaml", tmp_path)}
    assert set(written) == {"played.yaml", "samples.csv", "mock-rig.yaml"}
    again = virtual_run(written["played.yaml"], written["mock-rig.yaml"], folder=tmp_path / "again")
    np.testing.assert_array_equal(again.pressure.measured_bar, first.pressure.measured_bar)
    np.testing.assert_array_equal(again.tip.measured_mm, first.tip.measured_mm)


@pytest.mark.slow
def test_the_parameters_of_a_protocol_stay_with_the_run(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    without_figures(monkeypatch)
    protocol = tmp_path / "wave.yaml"
    protocol.write_text(
        "title: Wave\nparameters:\n  peak_bar: {default: 0.1}\n  period_s: {default: 0.5}\nsteps:\n"
        "  - sine: {actuators: [1], mean_bar: peak_bar / 2, amplitude_bar: peak_bar / 2, phase_deg: -90, periods: 1, "
        "period_s: period_s}\n"
    )
    low, high = (virtual_run(protocol, folder=tmp_path / "data", settings=s) for s in ({}, {"peak_bar": 0.125}))
    texts = ["peak_bar = 0.125 bar", "period_s = 0.5 s"]
    assert [str(quantity) for quantity in high.header.protocol_parameters] == texts
    assert [q.source for q in high.header.protocol_parameters] == ["set for this run", "default of the protocol"]
    assert high.header.protocol_yaml == protocol.read_text()
    assert high.pressure.setpoint_bar.max() > 0.12 > 0.1 >= low.pressure.setpoint_bar.max()
    recorded = journal.read(high.path.with_suffix(".mcap")).header
    again = runs.open(replay(high, tmp_path)).header
    for header in (recorded, again):
        assert list(map(str, header.protocol_parameters)) == texts

    together = page([low, high])
    assert "<th>parameters</th>" in together
    assert "<td>peak_bar = 0.1 bar, period_s = 0.5 s</td>" in together
    assert "<td>peak_bar = 0.125 bar, period_s = 0.5 s</td>" in together
    assert "<th>parameters</th><td>" in page([high])
    assert "<th>parameters</th><th" not in page([high, high])

    written = {path.name: path for path in export(high.path, "yaml", tmp_path)}
    options = written["wave.yaml"].read_text().splitlines()[0]
    assert options == "# This run: --set peak_bar=0.125 --set period_s=0.5"
    settings = {name: float(value) for name, value in re.findall(r"--set (\w+)=(\S+)", options)}
    repeated = virtual_run(written["wave.yaml"], written["mock-rig.yaml"], folder=tmp_path / "again", settings=settings)
    np.testing.assert_array_equal(repeated.pressure.measured_bar, high.pressure.measured_bar)


def test_files_with_the_same_name_from_several_folders_are_exported_side_by_side(tmp_path: Path) -> None:
    names = ("wave.csv", "a/wave.csv", "b/wave.csv", "played.yaml")
    steps = "".join(f"  - csv: {{file: {name}, actuators: [1]}}\n" for name in names)
    about = replace(
        made_up.header(),
        protocol_name="played",
        protocol_yaml=f"title: Played\nsteps:\n{steps}",
        protocol_files=tuple(RecordedFile(name, "csv", "", f"of {name}") for name in names),
    )
    writer = journal.JournalWriter(tmp_path / "run.mcap", about)
    writer.close(RunFooter(made_up.START_NS, Status.FINISHED, ""))
    written = {path.name: path for path in export(finalise(writer.path), "yaml", tmp_path)}
    played = re.findall(r"file: ([^,]+),", written["played.yaml"].read_text())
    assert [written[inside].read_text() for inside in played] == [f"of {name}" for name in names]
    assert len(written) == len(names) + 2


def test_overlays_of_the_rig_come_out_beside_it_and_give_the_same_rig(tmp_path: Path) -> None:
    (tmp_path / "cal").mkdir()
    write(camera_file(), tmp_path / "cal" / "c.yaml")
    rig = tmp_path / "my.yaml"
    rig.write_text(loader.text("mock").replace("name: mock\n", "name: mock\ncalibrations: [cal/c.yaml]\n"))
    found = loader.read(rig)
    about = replace(
        made_up.header(), rig_yaml=found.text, calibrations=found.calibrations, parameters_yaml="identified: here\n"
    )
    writer = journal.JournalWriter(tmp_path / "run.mcap", about)
    writer.close(RunFooter(made_up.START_NS, Status.FINISHED, ""))
    archive = finalise(writer.path)
    header = runs.open(archive).header
    assert (header.rig_yaml, header.calibrations) == (rig.read_text(), found.calibrations)
    assert loader.recorded(replace(header, parameters_yaml=""), archive).config == found.config

    written = {path.name: path for path in export(archive, "yaml", tmp_path)}
    assert written["c.yaml"].read_text() == (tmp_path / "cal" / "c.yaml").read_text()
    assert written["mock-parameters.yaml"].read_text() == "identified: here\n"
    shutil.rmtree(tmp_path / "cal")
    assert loader.load(written["mock-rig.yaml"]) == found.config


def test_metadata_of_rig_and_command_reach_the_archive_and_stay_with_its_replay(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    without_figures(monkeypatch)
    rig = tmp_path / "bench.yaml"
    rig.write_text(
        loader.text("mock") + "metadata:\n  required: [specimen]\n"
        "  values: {batch: 2026-10, fibre_angle_deg: 30, orcid: 0000-0001}\n"
    )
    protocol = tmp_path / "rest.yaml"
    protocol.write_text("title: Rest\nsteps:\n  - hold: {duration_s: 0.2}\n")
    with pytest.raises(BadInputError) as refused:
        virtual_run(protocol, rig, folder=tmp_path, meta={"a b": "1", "name": "x"})
    lines = loader.text("mock").count("\n")
    assert [(p.file, p.line, p.column, p.value) for p in refused.value.problems] == [
        ("--meta", 0, 0, "a b=1"),
        ("--meta", 0, 0, "name=x"),
        (str(rig), lines + 2, 14, "specimen"),
    ]
    assert "--meta specimen=VALUE" in str(refused.value)

    given = {"specimen": "A7", "batch": "11"}
    run = virtual_run(protocol, rig, folder=tmp_path, meta=given, operator="ada")
    expected = {"specimen": "A7", "batch": "11", "fibre_angle_deg": "30", "orcid": "0000-0001"}
    assert run.header.metadata == expected
    assert run.header.operator == "ada"
    with h5py.File(run.path) as file:
        assert file["entry/sample"].attrs["NX_class"] == "NXsample"
        assert file["entry/sample/name"].asstr()[()] == "A7"
        assert {name: file["entry/user"][name].asstr()[()] for name in file["entry/user"]} == {
            "name": "ada",
            "orcid": "0000-0001",
        }
    assert runs.open(replay(run, tmp_path)).header.metadata == expected
    assert "specimen = A7" in page([run])


def test_a_name_of_metadata_that_the_archive_uses_itself_is_refused(tmp_path: Path) -> None:
    rig = tmp_path / "bench.yaml"
    rig.write_text(loader.text("mock") + "metadata:\n  required: [a-b]\n  values: {operator: ada}\n")
    with pytest.raises(BadInputError) as refused:
        loader.read(str(rig))
    lines = loader.text("mock").count("\n")
    assert [(p.line, p.column, p.value) for p in refused.value.problems] == [
        (lines + 2, 14, "a-b"),
        (lines + 3, 22, "ada"),
    ]
