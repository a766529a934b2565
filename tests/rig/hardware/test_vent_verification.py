"""The pressures confirm the safe state, or the message says that it is not confirmed."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np
import pytest
from numpy.typing import NDArray

from rig.config import loader
from rig.config.schema import RigConfig
from rig.hardware.cards.base import CardError
from rig.hardware.vent_verification import (
    LONGEST_VENTING_S,
    UNCONFIRMED,
    UNREADABLE_S,
    VENTING_S,
    VentOutcome,
    VentVerification,
)

FULL_SCALE_BAR = 10.0
WRITTEN_S = 1.0
PERIOD_S = 0.01
PA_PER_BAR = 1e5
Pressures = Callable[[float], tuple[float, float, float] | None]


@dataclass(frozen=True)
class Scan:
    t_ns: NDArray[np.int64]
    pressure_pa: NDArray[np.float64]


class Bench:
    """Pressures [bar] by the time since the safe state was written; None where the card gives no scan."""

    def __init__(self, pressures: Pressures) -> None:
        self._pressures, self.t_s = pressures, WRITTEN_S

    def clock(self) -> Iterator[float]:
        while True:
            yield self.t_s
            self.t_s += PERIOD_S

    def read(self) -> Scan:
        bar = self._pressures(self.t_s - WRITTEN_S)
        if bar is None:
            return Scan(np.empty(0, np.int64), np.empty((0, 3)))
        return Scan(np.array([round(self.t_s * 1e9)]), np.array([bar]) * PA_PER_BAR)


def watched(
    pressures: Pressures, *, config: RigConfig | None = None, vent: bool = False, patience_s: float = VENTING_S
) -> tuple[VentOutcome, float]:
    """The outcome, and how long it took [s]."""
    bench = Bench(pressures)
    verification = VentVerification(
        config or loader.load("mock"), bench, vent=vent, patience_s=patience_s, since_ns=round(WRITTEN_S * 1e9)
    )
    return verification.outcome(bench.clock()), bench.t_s - WRITTEN_S


def decay(tau_s: float, start_bar: float = 0.7) -> Pressures:
    return lambda t_s: (start_bar * float(np.exp(-t_s / tau_s)), 0.0, 0.0)


def test_chambers_at_the_pressure_of_the_exhaust_end_the_wait_with_the_next_scan() -> None:
    outcome, took_s = watched(lambda t_s: (0.004, -0.003, 0.0))
    assert outcome.confirmed
    assert took_s == pytest.approx(PERIOD_S)


def test_chambers_that_empty_confirm_the_safe_state() -> None:
    outcome, _ = watched(lambda t_s: (0.5, 0.4, 0.3) if t_s < 0.1 else (0.0, 0.0, 0.004))
    assert outcome == VentOutcome(True, "the pressures confirm it: 0.00, 0.00, 0.00 bar")


def test_pressures_that_were_low_before_do_not_confirm_that_a_valve_vents() -> None:
    outcome, _ = watched(lambda t_s: (0.06, 0.0, 0.004))
    assert outcome == VentOutcome(True, "the pressures are low from the first reading on: 0.06, 0.00, 0.00 bar")


def test_chambers_that_were_low_before_are_named_where_others_empty() -> None:
    outcome, _ = watched(lambda t_s: (0.5 if t_s < 0.1 else 0.0, 0.05, 0.0))
    expected = "the pressures confirm it: 0.00, 0.05, 0.00 bar (low from the first reading on: actuators 2, 3)"
    assert outcome.sentence == expected


@pytest.mark.parametrize("tau_s", [0.05, 0.5, 2.0, 14.0])
@pytest.mark.parametrize("patience_s", [1.0, 10.0])
def test_a_bench_that_vents_slowly_is_awaited_until_it_is_empty(tau_s: float, patience_s: float) -> None:
    outcome, took_s = watched(decay(tau_s), patience_s=patience_s)
    assert outcome.confirmed
    assert took_s == pytest.approx(tau_s * np.log(0.7 / 0.1), abs=2 * PERIOD_S)


@pytest.mark.parametrize(
    "pressures",
    [lambda t_s: (0.5, 0.0, 0.0), lambda t_s: (min(1.5, 0.2 + t_s), 0.0, 0.0), decay(25.0)],
    ids=["closed", "fed", "slower than any bench"],
)
def test_a_chamber_that_does_not_empty_is_named_after_one_wait(pressures: Pressures) -> None:
    outcome, took_s = watched(pressures)
    assert not outcome.confirmed
    assert outcome.sentence.startswith(f"{UNCONFIRMED}: actuator 1 at ")
    assert "a valve is stuck" in outcome.sentence
    assert took_s == pytest.approx(VENTING_S, abs=2 * PERIOD_S)


def test_a_chamber_that_stops_emptying_is_found() -> None:
    """As behind a leaking valve, whose air leaves as fast as it comes."""
    outcome, took_s = watched(lambda t_s: (max(0.33, 0.7 - 0.2 * t_s), 0.0, 0.0))
    assert "actuator 1 at 0.33 bar" in outcome.sentence
    assert took_s < 4 * VENTING_S


def test_the_wait_is_bounded_whatever_the_pressure_does() -> None:
    outcome, took_s = watched(lambda t_s: (10.0**3 * float(np.exp(-t_s / 5.0)) % 9.0 + 0.2, 0.0, 0.0))
    assert not outcome.confirmed
    assert took_s <= LONGEST_VENTING_S + 2 * VENTING_S


def test_a_board_that_answers_all_ones_confirms_nothing() -> None:
    outcome, took_s = watched(lambda t_s: (FULL_SCALE_BAR,) * 3)
    assert outcome.sentence == (
        f"{UNCONFIRMED}: the safe outputs were written, but card daq reads full scale at every pressure sensor: "
        "it is pulled or hangs"
    )
    assert took_s == pytest.approx(VENTING_S, abs=2 * PERIOD_S)


def test_a_card_without_scans_confirms_nothing() -> None:
    outcome, _ = watched(lambda t_s: None)
    assert outcome.sentence == (f"{UNCONFIRMED}: the safe outputs were written, but no pressure has been read since")


def test_scans_from_before_the_safe_state_confirm_nothing() -> None:
    outcome, _ = watched(lambda t_s: (0.0, 0.0, 0.0) if t_s <= 0 else None)
    assert not outcome.confirmed


def fails(t_s: float) -> None:
    raise CardError("no answer")


def test_a_card_that_cannot_be_read_confirms_nothing_and_its_message_is_kept() -> None:
    outcome, took_s = watched(fails, patience_s=10.0)
    assert outcome.sentence == (
        f"{UNCONFIRMED}: the safe outputs were written, but the pressures cannot be read (no answer)"
    )
    assert took_s == pytest.approx(UNREADABLE_S, abs=2 * PERIOD_S)


def test_a_reading_that_fails_once_is_repeated() -> None:
    outcome, _ = watched(lambda t_s: fails(t_s) if t_s < 0.1 else (0.0, 0.0, 0.0))
    assert outcome.confirmed


def held_rig() -> RigConfig:
    text = loader.text("mock").replace("    channel: 1\n", "    channel: 1\n    safe_state: hold\n", 1)
    config = loader.parse(text, "held.yaml")
    assert [valve.safe_state for valve in config.valves] == ["vent", "hold"]
    return config


def test_a_chamber_that_is_held_is_stated_and_vents_for_an_emergency() -> None:
    outcome, _ = watched(lambda t_s: (0.5 if t_s < 0.1 else 0.0, 0.5, 0.5), config=held_rig())
    assert outcome == VentOutcome(
        True, "the pressures confirm it: 0.00 bar, actuator 2 is held at 0.50 bar, actuator 3 is held at 0.50 bar"
    )
    outcome, _ = watched(lambda t_s: (0.0, 0.5, 0.5), config=held_rig(), vent=True)
    assert not outcome.confirmed


def test_chambers_without_a_reading_are_named() -> None:
    nan = float("nan")
    outcome, _ = watched(lambda t_s: (nan, 0.0, nan))
    assert not outcome.confirmed
    assert "actuator 1 without a reading, actuator 3 without a reading 1 s after" in outcome.sentence
