"""Auxiliary inputs from the simulated card to archive, export, page and report; an emergency stop ends a run vented."""

from __future__ import annotations

import csv
import dataclasses
import re
from pathlib import Path

import numpy as np
import pytest

import rig.config.loader
import runs
from rig.config.schema import RigConfig
from rig.hardware.bench import Bench
from rig.hardware.cards.base import CardError
from rig.live import packets
from rig.simulator.plant import Plant
from runs.export.exporters import export
from runs.report.figure_specifications import figure_specifications
from scripts.faults import virtual
from scripts.faults.catalogue import CATALOGUE
from scripts.faults.injections import StopPressed
from tests.support.plant_bench import mock_rig
from tests.support.virtual_runs import virtual_run

INPUTS = """
inputs:
  load: {card: daq, channel: 4, unit: N, span: [-5, 45]}
  ambient: {card: daq, channel: 5, unit: degC, span: [0, 50], rate_hz: 10}
  spare: {card: daq, channel: 6, unit: l/min, span: [0, 10]}
"""
TRUTH = """
  inputs:
    load: {rest: 0, per_g: 0.00981, noise: 0.01}
    ambient: {rest: 21.5, per_bar: 2}
"""
PROTOCOL = """
title: A weight and a pressure
steps:
  - hold: {duration_s: 0.4}
  - prompt: {message: Hang it., weight_g: 500}
  - ramp: {actuators: [1], to_bar: 0.3, duration_s: 0.5}
  - hold: {duration_s: 0.6}
"""


@pytest.fixture(scope="module")
def archive(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A run in virtual time on a rig with three inputs."""
    folder = tmp_path_factory.mktemp("inputs")
    text = rig.config.loader.text("mock-no-camera")
    text = text.replace("\nlimits:", f"{INPUTS}\nlimits:").replace("\nsimulator:", f"\nsimulator:{TRUTH}")
    (folder / "rig.yaml").write_text(re.sub(r"\n{2,}(?=    load:)", "\n", text))
    (folder / "protocol.yaml").write_text(PROTOCOL)
    return virtual_run(folder / "protocol.yaml", folder / "rig.yaml", folder=folder, seed=0).path


def test_inputs_are_archived_in_their_units_and_follow_their_simulated_truth(archive: Path) -> None:
    run = runs.open(archive)
    found = run.auxiliary
    assert found is not None
    assert (found.inputs, found.units) == (("load", "ambient", "spare"), ("N", "degC", "l/min"))
    np.testing.assert_array_equal(found.time_s, run.pressure.time_s)
    load, ambient, spare = found.value.T
    assert np.abs(load[20:70]).mean() < 0.01
    assert load[-50:].mean() == pytest.approx(0.5 * 9.81, abs=0.01)
    assert load[-50:].std() == pytest.approx(0.01 / np.sqrt(5), rel=0.4), "five samples in the mean of a cycle"
    mean_bar = run.pressure.measured_bar[-50:].mean()
    assert ambient[-50:].mean() == pytest.approx(21.5 + 2 * mean_bar, abs=0.03)
    np.testing.assert_allclose(spare[20:], 5.0)


def test_an_input_with_a_rate_of_its_own_has_so_many_new_values_a_second(archive: Path) -> None:
    run = runs.open(archive)
    assert run.auxiliary is not None
    _, ambient, _ = run.auxiliary.value.T
    moving = (run.pressure.protocol_s > 0.45) & (run.pressure.protocol_s < 0.85)
    changes = np.flatnonzero(np.diff(ambient[moving]))
    np.testing.assert_array_equal(np.diff(changes), 20)


def test_export_page_and_report_show_the_inputs(archive: Path, tmp_path: Path) -> None:
    files = export(archive, "csv", tmp_path)
    (table,) = (file for file in files if file.name.endswith("-aux.csv"))
    with table.open() as file:
        first = next(csv.reader(file))
    assert first == ["time_s", "value_load_N", "value_ambient_degC", "value_spare_l/min", "simulated"]
    run = runs.open(archive)
    assert run.auxiliary is not None
    shown = packets.inputs(run.header.auxiliary, run.auxiliary.value[-1])
    assert [row.name for row in shown] == ["load", "ambient", "spare"]
    assert shown[0].unit == "N"
    assert float(shown[0].value) == pytest.approx(run.auxiliary.value[-1, 0], rel=1e-3)
    assert "Auxiliary inputs" in [figure.title for figure in figure_specifications(run, run.summary)]


def test_a_voltage_outside_the_span_is_no_value() -> None:
    config = mock_rig(inputs={"load": {"card": "daq", "channel": 4, "unit": "N", "span": [0, 10], "span_V": [2, 8]}})
    np.testing.assert_allclose(
        config.inputs["load"].value(np.array([1.0, 2.0, 5.0, 8.05, 8.2])), [np.nan, 0, 5, 10.083, np.nan], rtol=1e-3
    )


def test_the_scans_do_not_depend_on_how_time_is_cut() -> None:
    truth = {"load": {"rest": 1.0, "noise": 0.2, "per_bar": 1.0}}
    config = mock_rig(
        inputs={"load": {"card": "daq", "channel": 4, "unit": "N", "span": [-5, 5]}}, simulator__inputs=truth
    )
    found = []
    for step_ns in (700_000, 10_000_000):
        plant = Plant(config, 1, 0, moving_arm=False)
        card = plant.card("daq")
        card.start()
        for t_ns in range(0, 40_000_001, step_ns):
            plant.advance(t_ns)
        plant.advance(40_000_000)
        found.append(card.read().signals)
    np.testing.assert_array_equal(*found)


def with_stop(**changes: object) -> RigConfig:
    return mock_rig(cards__daq__digital_inputs=4, emergency_stops={"button": {"card": "daq", "channel": 2}}, **changes)


def test_a_pressed_stop_is_read_with_every_scan() -> None:
    config = with_stop()
    plant = Plant(config, 1, 0, moving_arm=False)
    bench = Bench(config, {"daq": plant.card("daq")})
    assert bench.read().stops_closed == (True,)
    plant.faults.inject(contact_3=1)
    assert bench.read().stops_closed == (False,)


def test_a_card_without_digital_inputs_cannot_have_a_stop() -> None:
    config = with_stop()

    class NoDigital:
        """A card that only has the six methods of every card."""

    with pytest.raises(CardError, match="emergency stop button: driver mock reads no digital inputs"):
        Bench(config, {"daq": NoDigital()})  # type: ignore[dict-item]


class HeldValves(StopPressed):
    """The stop of a rig whose valves hold their air when a run ends."""

    def edit_rig(self, text: str) -> str:
        """Hold."""
        return super().edit_rig(text).replace("    dead_zone_V", "    safe_state: hold\n    dead_zone_V")


def test_a_pressed_stop_ends_the_run_with_held_valves_vented(tmp_path: Path) -> None:
    pressed = CATALOGUE["emergency stop pressed"]
    virtual.trial(dataclasses.replace(pressed, injection=HeldValves({"contact_1": 1})), tmp_path, 0.9, seed=1)
    (archive,) = (tmp_path / "out").glob("*.h5")
    run = runs.open(archive)
    assert run.status == "aborted"
    assert "emergency stop 'button': its contact is open" in run.message
    # The valves of this rig hold when a run ends; the stop vents them.
    np.testing.assert_allclose(run.pressure.valve_v[-1], 0.0, atol=1e-3)
