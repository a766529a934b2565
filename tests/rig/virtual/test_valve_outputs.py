"""The outputs of valves that take no voltage are archived in their unit; other archives stay as they are."""

from __future__ import annotations

from pathlib import Path

import h5py
import numpy as np

from runs.export.exporters import export
from tests.support.bus_rig import bus_text
from tests.support.virtual_runs import protocol_file, virtual_run

STEPS = "  - hold: {actuators: [1], level_bar: 0.3, duration_s: 0.5}\n"


def test_a_bus_valve_has_its_set_points_in_the_archive(tmp_path: Path) -> None:
    rig = tmp_path / "bus.yaml"
    rig.write_text(bus_text())
    run = virtual_run(protocol_file(tmp_path, STEPS), rig, folder=tmp_path)
    assert run.header.valve_units == ("bar", "bar")
    assert np.isnan(run.pressure.valve_v).all()
    found = run.valve_outputs
    assert found is not None
    assert found.units == ("bar", "bar")
    np.testing.assert_allclose(found.output[-1], [0.3, 0.0], atol=1e-3)
    (table,) = (path for path in export(run.path, "csv", tmp_path) if path.name.endswith("-valve_output.csv"))
    assert table.read_text().splitlines()[0] == "time_s,output_1_bar,output_2_bar,simulated"


def test_a_rig_of_voltages_has_no_group_of_other_outputs(tmp_path: Path) -> None:
    run = virtual_run(protocol_file(tmp_path, STEPS), "mock-no-camera", folder=tmp_path)
    assert (run.header.valve_units, run.valve_outputs) == ((), None)
    with h5py.File(run.path) as file:
        assert "valve_output" not in file["entry"]
