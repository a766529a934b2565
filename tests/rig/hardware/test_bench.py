"""Several cards as one rig: columns, pairing of clocks, and the safe state."""

from __future__ import annotations

import os
import time
from contextlib import nullcontext

import numpy as np
import pytest
from numpy.typing import NDArray

import rig.hardware.cards.base
from rig.config.card_sections import CardConfig
from rig.config.schema import RigConfig
from rig.hardware.bench import DRIVER_CALLS, Bench
from rig.hardware.cards.base import CardBusyError, CardError, CardSetup, Scans, card_setup
from rig.hardware.safe_state import UNSAFE, RigSafeState, armed_sentence
from rig.hardware.vent import vent
from tests.support.plant_bench import mock_rig


class FakeCard:
    """A card with given scans, whose outputs can fail or read back differently."""

    def __init__(self, setup: CardSetup) -> None:
        self.setup = setup
        self.next = Scans(np.empty(0, np.int64), np.empty((0, len(setup.inputs))))
        self.outputs = np.full(len(setup.outputs), np.nan)
        self.broken = self.deaf = self.started = self.closed = False

    def start(self) -> None:
        self.started = True

    def feed(self, t_ns: list[int], volts: list[list[float]], lost: int = 0) -> None:
        self.next = Scans(np.array(t_ns, np.int64), np.array(volts).reshape(len(t_ns), -1), lost)

    def read(self) -> Scans:
        scans, self.next = self.next, Scans(np.empty(0, np.int64), np.empty((0, len(self.setup.inputs))))
        return scans

    def write(self, outputs: NDArray[np.float64]) -> None:
        if self.broken:
            raise CardError("no answer")
        if not self.deaf:
            self.outputs = outputs.copy()

    def readback(self) -> NDArray[np.float64]:
        return self.outputs

    def close(self) -> None:
        self.closed = True


def two_card_rig() -> RigConfig:
    """Actuator 2's sensor and the second valve hang on a card of their own; sensors are listed out of order."""
    config = mock_rig(
        cards__other={"driver": "mock", "device": "mock1", "outputs": 2, "inputs": 8},
        valves__1__card="other",
        valves__1__safe_state="hold",
    )
    first, second, third = config.sensors
    moved = second.model_copy(update={"card": "other", "channel": 5})
    return config.model_copy(update={"sensors": (third, moved, first)})


@pytest.fixture
def cards() -> dict[str, FakeCard]:
    config = two_card_rig()
    return {name: FakeCard(card_setup(config, name)) for name in config.cards}


@pytest.fixture
def bench(cards: dict[str, FakeCard]) -> Bench:
    return Bench(two_card_rig(), cards)


def test_channels_are_requested_in_the_order_of_actuators_and_valves(cards: dict[str, FakeCard]) -> None:
    assert [c.number for c in cards["daq"].setup.inputs] == [0, 2]
    assert [c.number for c in cards["other"].setup.inputs] == [5]
    assert [c.number for c in cards["daq"].setup.outputs] == [0]
    assert [c.number for c in cards["other"].setup.outputs] == [1]


def test_columns_come_in_the_order_of_the_actuators_and_in_pascal(bench: Bench, cards: dict[str, FakeCard]) -> None:
    cards["other"].feed([0, 10], [[0.2], [0.2]])
    cards["daq"].feed([5], [[0.1, 0.3]])
    scans = bench.read()
    np.testing.assert_allclose(scans.signals, [[0.1, 0.2, 0.3]])
    np.testing.assert_allclose(scans.pressure_pa, [[0.1e5, 0.2e5, 0.3e5]])


def test_cards_with_clocks_of_their_own_are_paired_without_losing_a_scan(
    bench: Bench, cards: dict[str, FakeCard]
) -> None:
    cards["daq"].feed([10, 20, 30, 40], [[1, 1], [2, 2], [3, 3], [4, 4]])
    cards["other"].feed([8, 18, 29], [[8], [18], [29]])
    first = bench.read()
    assert first.t_ns.tolist() == [10, 20]
    assert first.signals[:, 1].tolist() == [8, 18]
    cards["other"].feed([41], [[41]], lost=3)
    second = bench.read()
    assert second.t_ns.tolist() == [30, 40]
    assert second.signals.tolist() == [[3, 29, 3], [4, 29, 4]]
    assert second.lost == 3


def test_a_silent_card_stops_the_samples(bench: Bench, cards: dict[str, FakeCard]) -> None:
    cards["daq"].feed([10, 20], [[1, 1], [2, 2]])
    assert len(bench.read().t_ns) == 0


def test_a_scan_later_than_now_is_a_fault_of_its_card(cards: dict[str, FakeCard]) -> None:
    bench = Bench(two_card_rig(), cards, lambda: 1_000_000_000)
    cards["daq"].feed([1_000_000_000], [[1, 1]])
    cards["other"].feed([1_004_000_000], [[1]])
    bench.read()  # less than a control period
    cards["other"].feed([1_767_323_045_123_456_789], [[1]])
    with pytest.raises(CardError, match=r"card other: its newest scan is .* s ahead of now.*CLOCK_MONOTONIC"):
        bench.read()


def test_scans_whose_times_go_back_are_a_fault_of_their_card(bench: Bench, cards: dict[str, FakeCard]) -> None:
    cards["daq"].feed([50_000_000], [[1, 1]])
    bench.read()
    cards["daq"].feed([30_000_000], [[1, 1]])
    with pytest.raises(CardError, match=r"card daq: the times of its scans go back by 20.0 ms"):
        bench.read()


def test_scans_that_come_twice_are_left_out_and_counted(bench: Bench, cards: dict[str, FakeCard]) -> None:
    cards["other"].feed([5], [[0]])
    cards["daq"].feed([10, 20, 20], [[1, 1], [2, 2], [2, 2]])
    first = bench.read()
    cards["other"].feed([40], [[0]])
    cards["daq"].feed([20, 30], [[2, 2], [3, 3]])
    second = bench.read()
    assert (first.repeated, second.repeated) == (1, 1)
    assert [*first.t_ns, *second.t_ns] == [10, 20, 30]


def test_the_longest_call_into_a_driver_is_known_with_its_card(
    bench: Bench, cards: dict[str, FakeCard], monkeypatch: pytest.MonkeyPatch
) -> None:
    bench.write(np.array([1.0, 1.0]))
    bench.longest_call()
    reads = cards["other"].read

    def slow_read() -> Scans:
        time.sleep(0.02)
        return reads()

    monkeypatch.setattr(cards["other"], "read", slow_read)
    bench.read()
    call = bench.longest_call()
    assert call is not None
    assert (DRIVER_CALLS[call.number], call.cards) == ("read", ("other",))
    assert call.took_ns > 15_000_000
    assert bench.longest_call() is None


def test_every_card_is_made_safe_even_if_another_fails(bench: Bench, cards: dict[str, FakeCard]) -> None:
    cards["daq"].broken = True
    with pytest.raises(CardError, match="card daq: no answer"):
        bench.safe_state.make_safe()
    assert cards["other"].outputs.tolist() == [5.0]


def test_arming_writes_the_safe_state_and_checks_the_readback(bench: Bench, cards: dict[str, FakeCard]) -> None:
    bench.safe_state.arm()
    assert bench.readback().tolist() == [0.0, 5.0]
    cards["other"].outputs = np.array([4.0])
    cards["other"].deaf = True
    with pytest.raises(
        CardError, match=r"valve 2 \(card other, output 1\) reads back 4.000 V instead of the commanded 5.000 V"
    ):
        bench.safe_state.arm()


@pytest.mark.parametrize("vents", [False, True])
@pytest.mark.parametrize("ending", [None, CardError("a cable was pulled"), ZeroDivisionError(), KeyboardInterrupt()])
def test_every_exit_of_an_armed_bench_writes_the_safe_state(
    bench: Bench, cards: dict[str, FakeCard], ending: BaseException | None, vents: bool
) -> None:
    told: list[list[float]] = []
    with (
        nullcontext() if ending is None else pytest.raises(type(ending)),
        bench.armed(vent=lambda: vents, written=lambda: told.append(bench.readback().tolist())) as unverified,
    ):
        assert (unverified, bench.readback().tolist()) == ((), [0.0, 5.0])
        assert all(card.started for card in cards.values())
        bench.write(np.array([6.0, 7.0]))
        if ending is not None:
            raise ending
    assert told == [[0.0, 0.0 if vents else 5.0]]


def test_a_bench_that_cannot_be_armed_is_made_safe(bench: Bench, cards: dict[str, FakeCard]) -> None:
    cards["other"].outputs, cards["other"].deaf = np.array([7.0]), True
    cards["daq"].outputs = np.array([7.0])
    with pytest.raises(CardError, match=r"reads back 7\.000 V"), bench.armed():
        pytest.fail("it was not armed")
    assert cards["daq"].outputs.tolist() == [0.0]


def test_a_safe_state_that_fails_at_the_exit_is_reported_after_what_ended_the_block(
    bench: Bench, cards: dict[str, FakeCard]
) -> None:
    told: list[str] = []

    def drive() -> None:
        with bench.armed(written=lambda: told.append("safe")):
            cards["daq"].broken = True
            raise CardError("a cable was pulled")

    with pytest.raises(CardError, match=f"^a cable was pulled; then {UNSAFE}: card daq: no answer$"):
        drive()
    assert told == []
    assert cards["other"].outputs.tolist() == [5.0]


def test_valves_are_written_to_their_own_cards(bench: Bench, cards: dict[str, FakeCard]) -> None:
    bench.write(np.array([6.0, 7.0]))
    assert cards["daq"].outputs.tolist() == [6.0]
    assert cards["other"].outputs.tolist() == [7.0]


def test_starting_and_closing_reach_every_card(bench: Bench, cards: dict[str, FakeCard]) -> None:
    bench.start()
    bench.close()
    assert all(card.started and card.closed for card in cards.values())


def test_valves_of_one_card_are_made_safe_by_it_alone(cards: dict[str, FakeCard]) -> None:
    bench = Bench(two_card_rig(), {"other": cards["other"]})
    bench.safe_state.arm()
    assert cards["other"].outputs.tolist() == [5.0]
    bench.safe_state.arm(vent=True)
    assert cards["other"].outputs.tolist() == [0.0]
    assert np.isnan(cards["daq"].outputs).all()


def test_a_card_without_read_back_is_armed(
    bench: Bench, cards: dict[str, FakeCard], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(cards["other"], "readback", lambda: np.array([np.nan]))
    assert bench.safe_state.arm() == ("other",)
    assert cards["other"].outputs.tolist() == [5.0]


def test_arming_without_read_back_does_not_claim_that_it_was_read_back() -> None:
    assert armed_sentence(0) == "armed: the safe state was written and read back"
    assert "not read back: 1 card(s)" in armed_sentence(1)


@pytest.mark.parametrize("bug", [ValueError, OSError])
def test_an_unexpected_error_of_one_card_does_not_stop_the_safe_state_of_others(
    bug: type[Exception], cards: dict[str, FakeCard], monkeypatch: pytest.MonkeyPatch
) -> None:
    def opened(setup: CardSetup) -> FakeCard:
        if setup.name == "daq":
            raise bug("oddly broken")
        return cards[setup.name]

    monkeypatch.setattr(rig.hardware.cards.base, "card_type", lambda card: opened)
    with pytest.raises(CardError, match=f"card daq: {bug.__name__}: oddly broken"):
        RigSafeState(two_card_rig()).make_safe(vent=False)
    assert cards["other"].outputs.tolist() == [5.0]
    with pytest.raises(CardError, match=f"card daq: {bug.__name__}: oddly broken"):
        vent(two_card_rig())
    assert cards["other"].outputs.tolist() == [0.0]


def test_a_driver_that_fails_to_close_leaves_no_card_open_and_ends_no_vent(
    cards: dict[str, FakeCard], monkeypatch: pytest.MonkeyPatch
) -> None:
    def unplugged() -> None:
        raise OSError("cable pulled")

    monkeypatch.setattr(cards["daq"], "close", unplugged)
    monkeypatch.setattr(rig.hardware.cards.base, "open_card", lambda card, setup: cards[setup.name])
    vent(two_card_rig())
    assert cards["other"].closed
    cards["other"].closed = False
    Bench(two_card_rig(), cards).close()
    assert cards["other"].closed


def test_an_unexpected_error_of_a_read_back_is_an_error_of_the_card(
    bench: Bench, cards: dict[str, FakeCard], monkeypatch: pytest.MonkeyPatch
) -> None:
    def unplugged() -> NDArray[np.float64]:
        raise OSError("cable pulled")

    monkeypatch.setattr(cards["other"], "readback", unplugged)
    with pytest.raises(CardError, match="card other cannot be read back: OSError: cable pulled"):
        bench.safe_state.arm()


def test_an_unexpected_error_of_a_driver_names_card_and_method(
    bench: Bench, cards: dict[str, FakeCard], monkeypatch: pytest.MonkeyPatch
) -> None:
    def failing(*_: object) -> None:
        raise KeyError("no such line")

    monkeypatch.setattr(cards["other"], "write", failing)
    with pytest.raises(CardError, match="card other: write of its driver failed: KeyError: 'no such line'"):
        bench.write(np.zeros(2))
    monkeypatch.setattr(cards["other"], "read", failing)
    with pytest.raises(CardError, match="card other: read of its driver failed: KeyError: 'no such line'"):
        bench.read()


def test_scans_of_a_wrong_shape_are_an_error_of_the_card(bench: Bench, cards: dict[str, FakeCard]) -> None:
    cards["other"].next = Scans(np.array([1], np.int64), np.zeros((1, 2)))
    with pytest.raises(CardError, match=r"card other: .* signals of shape \(1, 2\) instead of \(1, 1\)"):
        bench.read()


def test_a_valve_may_stand_safe_or_vented_and_nowhere_else(bench: Bench, cards: dict[str, FakeCard]) -> None:
    bench.safe_state.arm()
    assert bench.safe_state.departure() == ""
    bench.safe_state.arm(vent=True)
    assert bench.safe_state.departure() == ""
    cards["other"].outputs = np.array([7.0])
    assert bench.safe_state.departure() == "valve 2 stands at 7.000 V"
    cards["other"].outputs = np.array([np.nan])
    assert bench.safe_state.departure() == ""


def test_a_card_that_cannot_be_opened_does_not_stop_the_safe_state_of_others(
    cards: dict[str, FakeCard], monkeypatch: pytest.MonkeyPatch
) -> None:
    def opened(card: CardConfig, setup: CardSetup) -> FakeCard:
        if setup.name == "daq":
            raise CardError("card daq is not there")
        return cards[setup.name]

    monkeypatch.setattr(rig.hardware.cards.base, "open_card", opened)
    with pytest.raises(CardError, match="card daq is not there"):
        RigSafeState(two_card_rig()).make_safe(vent=True)
    assert cards["other"].outputs.tolist() == [0.0]
    with pytest.raises(CardError, match="card daq is not there"):
        vent(two_card_rig())
    assert cards["other"].closed


def test_a_card_of_another_process_does_not_stop_the_venting_of_others(
    cards: dict[str, FakeCard], monkeypatch: pytest.MonkeyPatch
) -> None:
    def opened(card: CardConfig, setup: CardSetup) -> FakeCard:
        if setup.name == "daq" and cards["other"].outputs.tolist() != [0.0]:
            raise CardBusyError("card daq", (os.getpid(),))
        return cards[setup.name]

    monkeypatch.setattr(rig.hardware.cards.base, "open_card", opened)
    monkeypatch.setattr(os, "kill", lambda pid, number: None)
    vent(two_card_rig())
    assert cards["daq"].outputs.tolist() == [0.0]


@pytest.mark.parametrize(
    ("scans", "says"),
    [
        (None, "read of its driver returned NoneType instead of Scans"),
        (Scans(np.array([1]), [[0.0]]), "read of its driver returned signals of type list instead of ndarray"),  # type: ignore[arg-type]
        (Scans([1], np.zeros((1, 1))), "read of its driver returned t_ns of type list instead of ndarray"),  # type: ignore[arg-type]
    ],
)
def test_scans_of_a_wrong_type_are_an_error_of_the_card(
    bench: Bench, cards: dict[str, FakeCard], scans: Scans, says: str
) -> None:
    cards["other"].next = scans
    with pytest.raises(CardError, match=f"card other: {says}"):
        bench.read()
