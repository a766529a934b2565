"""Whoever makes a bench safe sets the camera trigger low, after the valves, and its failure leaves the valves safe."""

from __future__ import annotations

import os
from collections.abc import Iterator

import numpy as np
import pytest
from numpy.typing import NDArray

import rig.config.loader
from rig.config.schema import RigConfig
from rig.hardware.bench import Bench, open_bench
from rig.hardware.cards.base import CardError
from rig.hardware.safe_state import RigSafeState, SafeOutputs, SafeState
from rig.hardware.vent import vent
from rig.simulator.mock_card import MockCard
from rig.simulator.registers import Registers
from tests.support.mock_registers import mock_registers
from tests.support.triggered_bench import CHANNEL, triggered, triggered_rig


@pytest.fixture
def registers() -> Iterator[Registers]:
    """Two mock cards without a plant; the second one has no valves."""
    device = f"lowered-{os.getpid()}"
    with mock_registers(device) as first, mock_registers(f"{device}b"):
        yield first


def on_card(registers: Registers, second: bool = False) -> RigConfig:
    device = f"lowered-{os.getpid()}"
    text = triggered(rig.config.loader.text("mock")).replace("device: mock0", f"device: {device}")
    if second:
        other = f"  other: {{driver: mock, device: {device}b, inputs: 8, outputs: 2, digital_outputs: 16}}\n"
        text = text.replace("cards:\n", f"cards:\n{other}").replace(
            "{card: daq, channel: 3}", "{card: other, channel: 3}"
        )
    return rig.config.loader.parse(text, "rig.yaml")


@pytest.mark.parametrize("second", [False, True], ids=["on the card of the valves", "on a card of its own"])
def test_every_way_to_make_a_bench_safe_sets_the_trigger_low(registers: Registers, second: bool) -> None:
    config = on_card(registers, second)
    digital = registers if not second else Registers.attach(f"lowered-{os.getpid()}b")
    watchdog, bench = RigSafeState(config), open_bench(config)
    watchdog.keep_open()
    ways = (
        bench.safe_state.make_safe,
        lambda: watchdog.make_safe(vent=False),
        lambda: RigSafeState(config).make_safe(vent=True),
        lambda: vent(config),
    )
    for number, make_safe in enumerate(ways, 1):
        bench.write_trigger(high=True)
        assert digital.rise(CHANNEL)[0] == number
        assert digital.digital["high"].sum() == 1, "no other output is high"
        make_safe()
        assert not digital.digital["high"].any()
    watchdog.close()
    bench.close()


class BrokenLine:
    """A card with valves that can be written and digital outputs that cannot."""

    def __init__(self) -> None:
        self.order: list[str] = []
        self.volts: NDArray[np.float64] = np.full(2, 7.0)

    def write(self, outputs: NDArray[np.float64]) -> None:
        """Set the valves."""
        self.order.append("valves")
        self.volts = outputs.copy()

    def write_digital(self, *, high: bool) -> None:
        """Fail."""
        self.order.append("trigger")
        raise CardError("gone")


def test_a_trigger_that_cannot_be_set_low_leaves_the_valves_safe_and_is_reported() -> None:
    card = BrokenLine()
    safe_state = SafeState(triggered_rig(), {"daq": card})  # type: ignore[dict-item]
    safe_state.make_safe()
    np.testing.assert_allclose(card.volts, safe_state.outputs.held)
    assert card.order[:2] == ["valves", "trigger"]
    assert safe_state.trigger_failure == "the camera trigger of card daq could not be set low: gone"


def test_rig_vent_reports_a_trigger_that_it_cannot_set_low(
    registers: Registers, monkeypatch: pytest.MonkeyPatch
) -> None:
    def fail(card: MockCard, *, high: bool) -> None:
        raise CardError("gone")

    monkeypatch.setattr(MockCard, "write_digital", fail)
    config = on_card(registers)
    registers.outputs["value"][:2] = 7.0
    with pytest.raises(CardError, match="the camera trigger of card daq could not be set low: gone"):
        vent(config)
    np.testing.assert_allclose(registers.outputs["value"][:2], SafeOutputs.of(config.valves).vented, atol=1e-3)


def test_a_card_without_digital_outputs_cannot_trigger() -> None:
    class NoDigital:
        """A card that only has the six methods of every card."""

    with pytest.raises(CardError, match="card daq triggers cameras, and driver mock writes no digital outputs"):
        Bench(triggered_rig(), {"daq": NoDigital()})  # type: ignore[dict-item]
