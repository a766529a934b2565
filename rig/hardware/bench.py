"""Several cards as one rig: columns by actuator and valve, signals to pressure."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from rig.config.bench import BenchConfig
from rig.config.input_sections import AuxiliaryInput
from rig.config.sections import Sensor
from rig.hardware.cards.base import Card, CardError, DigitalInputCard, Scans, SelfClockedCard, card_setup, open_cards
from rig.hardware.driver_calls import as_error
from rig.hardware.safe_state import SafeState

LONGEST_MEAN_PERIODS = 2
TIME_TOLERANCE_NS = 5_000_000
"""How far the time of a scan may be ahead of now, or behind the scan before it: a control period at 200 Hz.

At least two periods of the scans, within which the start of a card's own clock is known.
"""
DRIVER_CALLS = ("read", "write", "readback")
"""The calls into the driver of a card in a control cycle."""


class DriverCall(NamedTuple):
    """The number in DRIVER_CALLS of a call, the cards whose drivers were called, and how long it took."""

    number: int
    cards: tuple[str, ...]
    took_ns: int


@dataclass(frozen=True)
class BenchScans:
    """Scans of all sensors, oldest first: `t_ns` (n,), `signals` and gauge `pressure_pa` (n, N) in actuator order.

    `lost` counts the scans that the cards dropped since the last read, `repeated` those that came twice and were left
    out, `damaged` the damaged lines between computer and cards; `late_ns` is the delay of a simulator.
    `auxiliary` (n, I) are the auxiliary inputs, each in its unit; `stops_closed` (E,) says whether the contact of each
    emergency stop is closed now.
    """

    t_ns: NDArray[np.int64]
    signals: NDArray[np.float64]
    pressure_pa: NDArray[np.float64]
    lost: int
    late_ns: int = 0
    auxiliary: NDArray[np.float64] = field(default_factory=lambda: np.empty((0, 0)))
    stops_closed: tuple[bool, ...] = ()
    damaged: int = 0
    repeated: int = 0

    def newest_pressure_pa(self, period_ns: int) -> NDArray[np.float64]:
        """Mean pressure (N,) over the scans of a control period.

        After a gap only over those of the last period: a mean over all would be an old pressure, and the change to the
        next one too fast.
        """
        pressure_pa = self.pressure_pa
        if self.t_ns[0] < self.t_ns[-1] - LONGEST_MEAN_PERIODS * period_ns:
            pressure_pa = pressure_pa[self.t_ns > self.t_ns[-1] - period_ns]
        # The result of NumPy's mean in half the time.
        newest: NDArray[np.float64] = np.add.reduce(pressure_pa) / len(pressure_pa)
        return newest


class Bench:
    """The open cards of a rig: their inputs, their outputs, and the safe state. Methods may raise `CardError`."""

    def __init__(
        self, config: BenchConfig, cards: Mapping[str, Card], clock: Callable[[], int] = time.monotonic_ns
    ) -> None:
        """`cards` are open, by their names in the rig, set up by `card_setup`; `clock` is that of their scans.

        A part of them suffices: signals of the others are NaN.
        """
        self._cards, self._valves = dict(cards), config.valves
        self.safe_state = SafeState(config, self._cards)
        self._columns = self.safe_state.columns
        self._sensors = config.sensors_by_actuator
        # A sensor is linear in its signal: two points define it.
        at_0, at_1 = ([float(s.pressure_pa(np.array(v))) for s in self._sensors] for v in (0.0, 1.0))
        self._pa_at_zero = np.array(at_0)
        self._pa_per_unit = np.array(at_1) - self._pa_at_zero
        self._commanded: NDArray[np.float64] | None = None
        self._auxiliary = tuple(config.inputs.values())
        self._digital = _digital_cards(config, self._cards)
        self._stop_cards = [stop.card for stop in config.emergency_stops.values() if stop.card in self._digital]
        signals: tuple[Sensor | AuxiliaryInput, ...] = (*self._sensors, *self._auxiliary)
        columns = {name: [i for i, s in enumerate(signals) if s.card == name] for name in self._cards}
        self._inputs = {name: column for name, column in columns.items() if column}
        self._one_has_all = len(next(iter(self._inputs.values()), ())) == len(signals)
        self._clock = clock
        self._tolerance_ns = {
            name: max(TIME_TOLERANCE_NS, round(2e9 / config.cards[name].sampling_hz)) for name in self._inputs
        }
        self._newest_ns = dict.fromkeys(self._inputs, -1)
        self._repeated = 0
        self._longest: DriverCall | None = None
        self._pending = {name: Scans.none(len(column)) for name, column in self._inputs.items()}

    @property
    def clocks(self) -> dict[int, tuple[float, float]]:
        """Period [ns] and drift [ppm] of the cards that sample by clocks of their own, by number in the rig file."""
        clocks = ((i, card.clock) for i, card in enumerate(self._cards.values()) if isinstance(card, SelfClockedCard))
        return {number: (clock.period_ns, clock.drift_ppm) for number, clock in clocks if clock is not None}

    @contextmanager
    def armed(
        self, *, vent: Callable[[], bool] = lambda: False, written: Callable[[], None] = lambda: None
    ) -> Iterator[tuple[str, ...]]:
        """Arm and begin to sample; on every exit write the safe state, as `SafeState.armed` does.

        Raises:
            CardError: the bench cannot be armed or sampled; or its safe state has failed, after what ended the block.
        """
        with self.safe_state.armed(vent, written) as unverified:
            self.start()
            yield unverified

    def start(self) -> None:
        """Begin sampling on every card that has sensors or auxiliary inputs."""
        for name in self._inputs:
            self._cards[name].start()

    def read(self) -> BenchScans:
        """Scans since the last read. Cards with clocks of their own are paired at the times of the first one.

        A row is returned once every card has a scan at or after its time: a silent card makes the samples stale.
        """
        if self._one_has_all:
            (name,) = self._inputs
            return self._scans(self._card_scans(name))
        scans = {name: _joined(self._pending[name], self._card_scans(name)) for name in self._inputs}
        lost, damaged = sum(s.lost for s in scans.values()), sum(s.damaged for s in scans.values())
        late_ns = max(s.late_ns for s in scans.values())
        first, *others = scans
        t_ns = scans[first].t_ns
        if others:
            oldest = max((int(scans[o].t_ns[0]) if len(scans[o].t_ns) else _NEVER) for o in others)
            newest = min((int(scans[o].t_ns[-1]) if len(scans[o].t_ns) else -1) for o in others)
            t_ns = t_ns[(t_ns <= newest) & (t_ns >= oldest)]
        signals = np.full((len(t_ns), len(self._sensors) + len(self._auxiliary)), np.nan)
        for name, s in scans.items():
            signals[:, self._inputs[name]] = s.signals[np.searchsorted(s.t_ns, t_ns, side="right") - 1]
            # The first card's rows are consumed; the others keep the row that the next call may need.
            used = int(np.searchsorted(s.t_ns, t_ns[-1], side="right")) if len(t_ns) else 0
            start = used if name == first else max(used - 1, 0)
            self._pending[name] = Scans(s.t_ns[start:], s.signals[start:])
        return self._scans(Scans(t_ns, signals, lost, late_ns, damaged))

    def _card_scans(self, name: str) -> Scans:
        """New scans of one card. Raises CardError, also for an error in the driver's code or wrong scans."""
        with as_error(CardError, f"card {name}: read of its driver failed"), self._timed(0, name):
            scans = self._cards[name].read()
        if not isinstance(scans, Scans):
            raise CardError(f"card {name}: read of its driver returned {type(scans).__name__} instead of Scans")
        for what, array in (("t_ns", scans.t_ns), ("signals", scans.signals)):
            if not isinstance(array, np.ndarray):
                found = f"{what} of type {type(array).__name__} instead of ndarray"
                raise CardError(f"card {name}: read of its driver returned {found}")
        shape, expected = scans.signals.shape, (len(scans.t_ns), len(self._inputs[name]))
        if shape != expected:
            raise CardError(f"card {name}: read of its driver returned signals of shape {shape} instead of {expected}")
        return self._in_order(name, scans) if len(scans.t_ns) else scans

    def _in_order(self, name: str, scans: Scans) -> Scans:
        """Scans without those that the driver has delivered before.

        Raises:
            CardError: a time is later than now, or earlier than the one before, by more than `TIME_TOLERANCE_NS`.
        """
        t_ns, before_ns = scans.t_ns, self._newest_ns[name]
        newest_ns = int(t_ns.max())
        if (ahead_ns := newest_ns - self._clock()) > self._tolerance_ns[name]:
            raise CardError(
                f"card {name}: its newest scan is {_duration(ahead_ns)} ahead of now: the times of its driver are not "
                "of CLOCK_MONOTONIC (time.monotonic_ns)"
            )
        self._newest_ns[name] = max(newest_ns, before_ns)
        if t_ns[0] > before_ns and (t_ns[1:] > t_ns[:-1]).all():
            return scans
        latest_ns = np.maximum.accumulate(np.concatenate([[before_ns], t_ns]))[:-1]
        if (behind_ns := int((latest_ns - t_ns).max())) > self._tolerance_ns[name]:
            raise CardError(f"card {name}: the times of its scans go back by {_duration(behind_ns)}")
        new = t_ns > latest_ns
        self._repeated += int((~new).sum())
        return replace(scans, t_ns=t_ns[new], signals=scans.signals[new])

    @contextmanager
    def _timed(self, number: int, *cards: str) -> Iterator[None]:
        """Time a call of DRIVER_CALLS."""
        began_ns = time.monotonic_ns()
        try:
            yield
        finally:
            took_ns = time.monotonic_ns() - began_ns
            if self._longest is None or took_ns > self._longest.took_ns:
                self._longest = DriverCall(number, cards, took_ns)

    def longest_call(self) -> DriverCall | None:
        """The longest call of read, write and readback of a driver since the last time, in real time."""
        longest, self._longest = self._longest, None
        return longest

    def readback(self) -> NDArray[np.float64]:
        """As `SafeState.readback`, timed."""
        with self._timed(2, *self._columns):
            return self.safe_state.readback()

    def _scans(self, cards: Scans) -> BenchScans:
        """Scans of the signals (n, N + I): sensors, then auxiliary inputs."""
        sensors = len(self._sensors)
        signals, inputs = cards.signals[:, :sensors], cards.signals[:, sensors:]
        pressure_pa: NDArray[np.float64] = signals * self._pa_per_unit + self._pa_at_zero
        auxiliary = np.empty(inputs.shape)
        for i, one in enumerate(self._auxiliary):
            auxiliary[:, i] = one.value(inputs[:, i])
        high = {name: iter(card.read_digital().tolist()) for name, card in self._digital.items()}
        closed = tuple(next(high[name]) for name in self._stop_cards)
        repeated, self._repeated = self._repeated, 0
        counts = cards.damaged, repeated
        return BenchScans(cards.t_ns, signals, pressure_pa, cards.lost, cards.late_ns, auxiliary, closed, *counts)

    def write(self, outputs: NDArray[np.float64]) -> None:
        """Set every valve (V,), each in its unit."""
        self._commanded = None
        for name, column in self._columns.items():
            with as_error(CardError, f"card {name}: write of its driver failed"), self._timed(1, name):
                self._cards[name].write(outputs[column])
        self._commanded = outputs.copy()

    def external_write(self) -> str:
        """Message about a valve that another program has moved since the last `write`; empty if there is none.

        Raises:
            CardError: a card cannot be read back.
        """
        if self._commanded is None:
            return ""
        stands = self.readback()
        off = np.abs(stands - self._commanded) > self.safe_state.outputs.tolerance
        for i in np.flatnonzero(off).tolist():
            unit = self._valves[i].output_unit
            return (
                f"valve {i + 1} reads back {stands[i]:.3f} {unit} instead of the commanded "
                f"{self._commanded[i]:.3f} {unit}: another program has written to the card (`rig vent`?)"
            )
        return ""

    @property
    def vented(self) -> bool:
        """True if every valve that another program has moved since the last `write` is vented.

        Raises:
            CardError: a card cannot be read back.
        """
        if self._commanded is None:
            return False
        stands = self.readback()
        safe = self.safe_state.outputs
        off = np.abs(stands - self._commanded) > safe.tolerance
        return bool(np.all(np.abs(stands - safe.vented)[off] <= safe.tolerance[off]))

    def write_trigger(self, *, high: bool) -> None:
        """Set the digital outputs that trigger the cameras."""
        self.safe_state.write_trigger(high=high)

    def close(self) -> None:
        """Release every card; the outputs keep their values."""
        self.safe_state.close()


def open_bench(config: BenchConfig, *, by_instruction: bool = False) -> Bench:
    """Open every card of the rig; with `by_instruction` a card that could sample by its own clock does not.

    Raises:
        CardError: a card cannot be opened.
    """
    setups = (card_setup(config, name, by_instruction=by_instruction) for name in config.cards)
    return Bench(config, open_cards(config, setups))


def _digital_cards(config: BenchConfig, cards: Mapping[str, Card]) -> dict[str, DigitalInputCard]:
    """The open cards that have emergency stops. Raises CardError for a driver that reads no digital inputs."""
    found: dict[str, DigitalInputCard] = {}
    for stop, section in config.emergency_stops.items():
        card = cards.get(section.card)
        if card is None:
            continue
        if not isinstance(card, DigitalInputCard):
            driver = config.cards[section.card].driver
            raise CardError(f"card {section.card} of emergency stop {stop}: driver {driver} reads no digital inputs")
        found[section.card] = card
    return found


_NEVER = np.iinfo(np.int64).max


def _duration(ns: int) -> str:
    """A duration in ms, or in s where it is long."""
    return f"{ns * 1e-6:.1f} ms" if ns < 10**9 else f"{ns * 1e-9:.1f} s"


def _joined(old: Scans, new: Scans) -> Scans:
    """New scans behind old ones, with the counts of the new ones."""
    if len(old.t_ns) == 0:
        return new
    t_ns, signals = np.concatenate([old.t_ns, new.t_ns]), np.concatenate([old.signals, new.signals])
    return replace(new, t_ns=t_ns, signals=signals)
