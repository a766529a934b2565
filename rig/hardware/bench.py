"""Several cards as one rig: columns by actuator and valve, volts to pressure, and the safe state."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from rig.config.schema import RigConfig
from rig.hardware.cards.base import Card, CardError, CardSetup, Channel, Scans, SelfClockedCard
from rig.hardware.cards.registry import open_card

READBACK_TOLERANCE = 1 / 2000
"""Of the output's range: two counts of a 12-bit card."""
WRITE_ATTEMPTS = 10
"""Attempts to write a safe state before the card counts as failed."""
UNSAFE = "the safe state could not be written, shut the air off by hand"
"""Begin of the message of a failed safe state."""


@dataclass(frozen=True)
class BenchScans:
    """Scans of all sensors, oldest first: `t_ns` (n,), `volts` and gauge `pressure_pa` (n, N) in actuator order.

    `lost` counts the scans that the cards dropped since the last read; `late_ns` is the delay of a simulator.
    """

    t_ns: NDArray[np.int64]
    volts: NDArray[np.float64]
    pressure_pa: NDArray[np.float64]
    lost: int
    late_ns: int = 0


def card_setup(config: RigConfig, name: str) -> CardSetup:
    """The setup of one card of the rig: sensors in actuator order, valves in the order of the rig file."""
    card = config.cards[name]
    sensors = sorted((s for s in config.sensors if s.card == name), key=lambda s: s.actuator)
    valves = [v for v in config.valves if v.card == name]
    return CardSetup(
        name=name,
        device=card.device,
        inputs=tuple(Channel(s.channel, *s.range_V) for s in sensors),
        outputs=tuple(Channel(v.channel, *v.range_V) for v in valves),
        sampling_hz=card.sampling_hz,
        acquisition=card.acquisition,
        differential=card.reference == "differential",
        one_opener=card.one_opener,
    )


class Bench:
    """The open cards of a rig. Methods may raise `CardError`."""

    def __init__(self, config: RigConfig, cards: Mapping[str, Card]) -> None:
        """`cards` are open, by their names in the rig, set up by `card_setup`; a part of them suffices for writing."""
        self._cards = dict(cards)
        self._sensors = sorted(config.sensors, key=lambda s: s.actuator)
        # A sensor is linear in voltage: two points define it.
        at_0, at_1 = ([float(s.pressure_pa(np.array(v))) for s in self._sensors] for v in (0.0, 1.0))
        self._pa_at_0_v = np.array(at_0)
        self._pa_per_v = np.array(at_1) - self._pa_at_0_v
        self._valves = config.valves
        self.safe_voltages: NDArray[np.float64] = np.array([v.safe_v() for v in config.valves])
        self._vent_voltages: NDArray[np.float64] = np.array([v.safe_v(vent=True) for v in config.valves])
        self._told_v: NDArray[np.float64] | None = None
        self._tolerance_v: NDArray[np.float64] = np.array(
            [(v.range_V[1] - v.range_V[0]) * READBACK_TOLERANCE for v in config.valves]
        )
        columns = {name: [i for i, s in enumerate(self._sensors) if s.card == name] for name in self._cards}
        self._inputs = {name: column for name, column in columns.items() if column}
        self._outputs = {name: [i for i, v in enumerate(self._valves) if v.card == name] for name in self._cards}
        self._pending = {name: _Pending(len(column)) for name, column in self._inputs.items()}

    @property
    def card_names(self) -> tuple[str, ...]:
        """Names of the cards in the order of the rig file."""
        return tuple(self._cards)

    def clock(self, card: str) -> tuple[float, float] | None:
        """Period [ns] of a card's own sampling clock and its drift [ppm]; None where the computer's clock is used."""
        clocked = self._cards[card]
        if not isinstance(clocked, SelfClockedCard) or clocked.period_ns is None:
            return None
        return clocked.period_ns, clocked.drift_ppm or 0.0

    def start(self) -> None:
        """Begin sampling on every card that has sensors."""
        for name in self._inputs:
            self._cards[name].start()

    def read(self) -> BenchScans:
        """Scans since the last read. Cards with clocks of their own are paired at the times of the first one.

        A row is returned once every card has a scan at or after its time: a silent card makes the samples stale.
        """
        if len(self._inputs) == 1:
            (name,) = self._inputs
            only = self._cards[name].read()
            return BenchScans(only.t_ns, only.volts, self._pressure_pa(only.volts), only.lost, only.late_ns)
        scans = {name: self._pending[name].with_new(self._cards[name].read()) for name in self._inputs}
        lost = sum(s.lost for s in scans.values())
        late_ns = max(s.late_ns for s in scans.values())
        first, *others = scans
        t_ns = scans[first].t_ns
        if others:
            oldest = max((int(scans[o].t_ns[0]) if len(scans[o].t_ns) else _NEVER) for o in others)
            newest = min((int(scans[o].t_ns[-1]) if len(scans[o].t_ns) else -1) for o in others)
            t_ns = t_ns[(t_ns <= newest) & (t_ns >= oldest)]
        volts = np.empty((len(t_ns), len(self._sensors)))
        for name, s in scans.items():
            rows = np.searchsorted(s.t_ns, t_ns, side="right") - 1
            volts[:, self._inputs[name]] = s.volts[rows]
            # The first card's rows are consumed; the others keep the row that the next call may need.
            until = int(t_ns[-1]) if len(t_ns) else -1
            self._pending[name].keep(s, until, inclusive=name != first)
        return BenchScans(t_ns, volts, self._pressure_pa(volts), lost, late_ns)

    def _pressure_pa(self, volts: NDArray[np.float64]) -> NDArray[np.float64]:
        pressure: NDArray[np.float64] = volts * self._pa_per_v + self._pa_at_0_v
        return pressure

    def write(self, valve_v: NDArray[np.float64]) -> None:
        """Set every valve (V,) [V]."""
        self._told_v = None
        for name, column in self._outputs.items():
            if column:
                self._cards[name].write(valve_v[column])
        self._told_v = valve_v.copy()

    def external_write(self) -> str:
        """Message about a valve that another program has moved since the last `write`; empty if there is none.

        Raises:
            CardError: a card cannot be read back.
        """
        if self._told_v is None:
            return ""
        stands = self.readback()
        off = np.abs(stands - self._told_v) > self._tolerance_v
        for i in np.flatnonzero(off).tolist():
            return (
                f"valve {i + 1} stands at {stands[i]:.3f} V and not at the {self._told_v[i]:.3f} V that it was "
                "told: another program has written to the card (`rig vent`?)"
            )
        return ""

    @property
    def vented(self) -> bool:
        """True if every valve that another program has moved since the last `write` is vented.

        Raises:
            CardError: a card cannot be read back.
        """
        if self._told_v is None:
            return False
        stands = self.readback()
        off = np.abs(stands - self._told_v) > self._tolerance_v
        return bool(np.all(np.abs(stands - self._vent_voltages)[off] <= self._tolerance_v[off]))

    def unsafe_output(self) -> str:
        """Message about a valve that is neither safe nor vented; empty if there is none or the cards have no read-back.

        Raises:
            CardError: a card cannot be read back.
        """
        stands = self.readback()
        for i in range(len(stands)):
            known = (self.safe_voltages[i], self._vent_voltages[i])
            if all(abs(stands[i] - v) > self._tolerance_v[i] for v in known):
                return f"valve {i + 1} stands at {stands[i]:.3f} V"
        return ""

    def readback(self) -> NDArray[np.float64]:
        """The output voltages (V,), NaN where a card has no read-back."""
        volts = np.full(len(self._valves), np.nan)
        for name, column in self._outputs.items():
            if column:
                volts[column] = self._cards[name].readback()
        return volts

    def make_safe(self, *, vent: bool = False) -> None:
        """Write the safe voltages to every card, also if another card fails; `vent` also vents held valves.

        A failed write is repeated at once, at most WRITE_ATTEMPTS times.

        Raises:
            CardError: one or more cards could not be written; it names each.
        """
        failures = []
        voltages = self._vent_voltages if vent else self.safe_voltages
        for name, column in self._outputs.items():
            if column and (failure := _retry(self._cards[name], voltages[column])):
                failures.append(f"card {name}: {failure}")
        if failures:
            raise CardError(f"{UNSAFE}: {'; '.join(failures)}")

    def arm(self, *, vent: bool = False) -> None:
        """Write the safe voltages as `make_safe` does, read them back and compare.

        Raises:
            CardError: the read-back of an output differs from the written voltage.
        """
        self.make_safe(vent=vent)
        stands = self.readback()
        voltages = self._vent_voltages if vent else self.safe_voltages
        for i in sorted(i for column in self._outputs.values() for i in column):
            valve, safe = self._valves[i], voltages[i]
            if not abs(stands[i] - safe) <= self._tolerance_v[i]:
                raise CardError(
                    f"valve {i + 1} (card {valve.card}, output {valve.channel}) was told {safe:.3f} V but stands at "
                    f"{stands[i]:.3f} V: check that nothing else drives the card"
                )

    def close(self) -> None:
        """Release every card; the outputs keep their voltages."""
        for card in self._cards.values():
            card.close()


def open_bench(config: RigConfig, *, watchdog: bool = False) -> Bench:
    """Open every card of the rig; for a `watchdog` without inputs, which control may use exclusively.

    Raises:
        CardError: a card cannot be opened.
    """
    cards: dict[str, Card] = {}
    try:
        for name, card in config.cards.items():
            cards[name] = _output_voltages(config, name) if watchdog else open_card(card, card_setup(config, name))
    except BaseException:
        for opened in cards.values():
            opened.close()
        raise
    return Bench(config, cards)


def open_outputs(config: RigConfig, card: str) -> Bench:
    """Open one card of the rig for its outputs only.

    Raises:
        CardError: it cannot be opened.
    """
    return Bench(config, {card: _output_voltages(config, card)})


def cards_with_valves(config: RigConfig) -> tuple[str, ...]:
    """Names of the cards that drive valves."""
    return tuple(name for name in config.cards if any(valve.card == name for valve in config.valves))


def _output_voltages(config: RigConfig, name: str) -> Card:
    return open_card(config.cards[name], replace(card_setup(config, name), inputs=()))


def _retry(card: Card, volts: NDArray[np.float64]) -> str:
    """Write with retries; return the reason of the failure, empty on success."""
    failure = ""
    for _ in range(WRITE_ATTEMPTS):
        try:
            card.write(volts)
        except Exception as error:  # one card must not prevent the safe state of the others
            failure = str(error)
        else:
            return ""
    return failure


_NEVER = np.iinfo(np.int64).max


class _Pending:
    """Scans of one card that wait for scans of the other cards."""

    def __init__(self, inputs: int) -> None:
        self._scans = Scans(np.empty(0, np.int64), np.empty((0, inputs)))

    def with_new(self, new: Scans) -> Scans:
        old = self._scans
        if len(old.t_ns) == 0:
            return new
        return Scans(
            np.concatenate([old.t_ns, new.t_ns]), np.concatenate([old.volts, new.volts]), new.lost, new.late_ns
        )

    def keep(self, scans: Scans, until_ns: int, *, inclusive: bool) -> None:
        used = int(np.searchsorted(scans.t_ns, until_ns, side="right"))
        start = max(used - 1, 0) if inclusive else used
        self._scans = Scans(scans.t_ns[start:], scans.volts[start:])
