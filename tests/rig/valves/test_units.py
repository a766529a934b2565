"""Valves and sensors without a voltage: set-points and pressures in bar."""

from __future__ import annotations

import re
from types import SimpleNamespace

import numpy as np
import pytest

from protocols import BadInputError
from rig.config import consistency, loader
from rig.config.schema import RigConfig
from rig.hardware.bench import Bench
from rig.hardware.cards.base import card_setup
from rig.hardware.safe_state import SafeOutputs
from rig.simulator.plant import Plant
from tests.support.bus_rig import bus_rig, bus_text
from tests.support.plant_bench import play, staircase


def test_a_rig_on_a_bus_regulates_in_bar() -> None:
    played = play(bus_rig(), staircase([0.0, 0.3, 0.6], 1.0, [0, 1, 2]), 3.0)
    assert played.trip is None
    assert played.measured_pa[-1] == pytest.approx([0.6e5] * 3, abs=600)
    assert played.outputs[-1] == pytest.approx([0.6, 0.6], abs=1e-3)


def test_the_card_is_set_up_in_bar() -> None:
    setup = card_setup(bus_rig(), "daq")
    assert [(c.low, c.high) for c in setup.outputs] == [(-0.8, 1.5)] * 2
    assert all(c.low < -1 and c.high > 2 for c in setup.inputs)


def test_the_vent_level_is_not_the_bottom_of_the_range() -> None:
    assert SafeOutputs.of(bus_rig().valves).held.tolist() == [0.0, 0.0]
    assert SafeOutputs.of(bus_rig(", vent_bar: 0.05").valves).held.tolist() == [0.05, 0.05]


def test_a_broken_sensor_is_reported_in_its_unit() -> None:
    played = play(
        bus_rig(), staircase([0.2], 1.0, [0]), 1.0, disturb=lambda t_s, plant, bar: bar + (3.0 if t_s > 0.5 else 0.0)
    )
    assert played.trip is not None
    assert re.fullmatch(
        r"sensor 1 reads \d\.\d{3} bar, outside its span of -1.03 to 2.03 bar: sensor or wire broken",
        played.trip.message,
    )


def test_an_external_write_is_reported_in_bar() -> None:
    config = bus_rig()
    plant = Plant(config, 1, 0)
    card = plant.card("daq")
    bench = Bench(config, {"daq": card})
    bench.safe_state.arm()
    bench.write(np.array([0.4, 0.0]))
    card.write(np.array([0.0, 0.0]))
    assert "valve 1 reads back 0.000 bar instead of the commanded 0.400 bar" in bench.external_write()


@pytest.mark.parametrize(
    ("text", "says"),
    [
        (bus_text(", range_V: [0, 10]"), "unknown key 'range_V'"),
        (bus_text(", safe_state: hold"), "a valve of type bus has no closed position"),
        (bus_text(", vent_bar: 1.6"), "vent_bar"),
        (bus_text(", vent_bar: -0.9"), "a pressure inside range_bar, -0.8 to 1.5 bar"),
        (bus_text().replace("[-0.8, 1.5]", "[0.1, 1.5]"), "a range from 0 to limits, pressure_bar (0.7 bar) at least"),
        (bus_text().replace("[-0.8, 1.5]", "[0, 0.5]"), "a range from 0 to limits, pressure_bar (0.7 bar) at least"),
        (bus_text(sensor=", unit: bar, span_V: [0, 5]"), "no such key for a sensor with `unit: bar`"),
        (bus_text(sensor=", unit: psi"), "one of V, bar"),
    ],
)
def test_what_makes_no_sense_without_a_voltage_is_refused(text: str, says: str) -> None:
    with pytest.raises(BadInputError) as refused:
        loader.parse(text, "bus.yaml")
    assert says in str(refused.value)


SERIAL = "cards:\n  daq: {driver: serial, device: /dev/ttyACM0, inputs: 4, outputs: 2}\n"


def _on_a_real_card(text: str, card: str) -> str:
    """The rig with another card and without simulation and cameras."""
    text = text[: text.index("simulator:\n")]
    text = text[: text.index("cameras:\n")] + text[text.index("arm:\n") :]
    return re.sub(r"cards:\n.*\n", card, text)


def test_regulators_and_sensors_in_bar_fit_a_serial_card() -> None:
    assert loader.parse(_on_a_real_card(bus_text(), SERIAL), "bus.yaml").cards["daq"].driver == "serial"


def test_a_card_in_volts_refuses_set_points_in_bar() -> None:
    """Its driver would write 0.7 bar as 0.7 V."""
    with pytest.raises(BadInputError) as refused:
        loader.parse(_on_a_real_card(bus_text(), SERIAL.replace("serial", "comedi")), "bus.yaml")
    message = str(refused.value)
    assert (
        message.count("`type: flow` or `type: pressure` (output in V): card 'daq' (comedi) has no signals in bar") == 2
    )
    assert message.count("`unit: V`: card 'daq' (comedi) has no signals in bar") == 3


def test_a_card_in_bar_refuses_voltages() -> None:
    """Its driver would write 10 V as 10 bar."""
    text = _on_a_real_card(loader.text("mock"), SERIAL)
    with pytest.raises(BadInputError) as refused:
        loader.parse(text, "serial.yaml")
    message = str(refused.value)
    assert message.count("`type: bus` (output in bar): card 'daq' (serial) has no signals in V") == 2
    assert message.count("`unit: bar`: card 'daq' (serial) has no signals in V") == 3


def test_an_input_on_a_card_in_bar_needs_another_card() -> None:
    card = SimpleNamespace(signal_units=("bar",), driver="serial")
    recorded = SimpleNamespace(card="daq")
    (fault,) = consistency.check_units({"daq": card}, (), (), {"force": recorded})  # type: ignore[dict-item]
    assert fault.expected == "a card with signals in V: card 'daq' (serial) has no signals in V"


def test_a_rig_on_a_bus_survives_its_dump() -> None:
    """`rig vent` reads the rig of a running experiment from its dump."""
    config = bus_rig()
    assert RigConfig.model_validate_json(config.model_dump_json(exclude_none=True)) == config


def test_a_driver_in_a_unit_that_softrig_does_not_know_is_told_to_convert() -> None:
    card = SimpleNamespace(signal_units=("kPa",), driver="box")
    sensor = SimpleNamespace(card="daq", unit="bar")
    (fault,) = consistency.check_units({"daq": card}, (), (sensor,), {})  # type: ignore[dict-item, arg-type]
    assert fault.expected.endswith("has no signals in bar; its driver converts kPa to V or bar (signal_units)")
