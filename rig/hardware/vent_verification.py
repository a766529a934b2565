"""Confirmation of the safe state by the pressure sensors: a written output is no proof that a valve has moved.

Control, the supervisor, the watchdog, the observer, virtual time, calibrations and `rig vent` all use this module once
the safe state has been written: it delays no write.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable, Iterator
from contextlib import suppress
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from model.units import PA_PER_BAR
from rig.config.bench import BenchConfig
from rig.hardware.bench import Bench, BenchScans, open_bench
from rig.hardware.cards.base import CardError
from rig.hardware.safe_state import SafeOutputs

UNCONFIRMED = "the safe state is NOT confirmed, shut the air off by hand"
"""Prefix of the message where the pressures do not show that the chambers vent."""
VENTING_S = 1.0
"""Default of the first wait; a chamber vents in a few tenths of a second."""
LONGEST_VENTING_S = 30.0
"""After the first wait, a chamber that keeps emptying is awaited until then."""
LEAST_DROP_PER_S = 0.05
"""Share of the excess that a slowly venting chamber loses in a second: a time constant of 20 s."""
UNREADABLE_S = 1.0
"""How long a card whose inputs cannot be read is tried again."""
VENTED_TOLERANCE_PA = 0.1 * PA_PER_BAR
"""A chamber is vented when its pressure is within this of that at the exhaust of its valve."""
FULL_SCALE_SHARE = 1e-3
"""A reading within this share of the input's range of its upper end is at full scale."""
LOOK_S = 0.005


@dataclass(frozen=True)
class VentOutcome:
    """Whether every chamber that vents is empty, and the sentence that says what the pressures show of it.

    `answered` is false where no pressure could be read.
    """

    confirmed: bool
    sentence: str
    answered: bool = True


class PressureSource(Protocol):
    """What is read to confirm the safe state: a bench."""

    def read(self) -> BenchScans:
        """Return the scans since the last call."""


class VentVerification:
    """Watches the chambers whose safe state is vented empty; with `vent`, all chambers.

    Only scans after `since_ns`, when the safe state was written, count. The first wait lasts `patience_s`. It is
    repeated, for LONGEST_VENTING_S at most, while each chamber that is not empty loses at least LEAST_DROP_PER_S of
    its excess: a bench that vents slowly is no fault, and a chamber that is fed or closed is found after one wait.
    """

    def __init__(
        self,
        config: BenchConfig,
        bench: PressureSource,
        *,
        vent: bool = False,
        patience_s: float = VENTING_S,
        since_ns: int = 0,
    ) -> None:
        self._bench, self._patience_s, self._since_ns = bench, patience_s, since_ns
        holds = SafeOutputs.of(config.valves).holds.tolist()
        venting = {
            a - 1: valve.vented_pa
            for valve, held in zip(config.valves, holds, strict=True)
            if vent or not held
            for a in valve.actuators
        }
        self._venting: NDArray[np.int64] = np.array(sorted(venting), np.int64)
        self._vented_pa: NDArray[np.float64] = np.array([venting[a] for a in sorted(venting)])
        self._held = [a for a in range(config.actuators) if a not in venting]
        sensors = config.sensors_by_actuator
        ends = [sorted(float(s.pressure_pa(np.array(v))) for v in s.signal_range) for s in sensors]
        self._full_scale_pa: NDArray[np.float64] = np.array(
            [high - FULL_SCALE_SHARE * (high - low) for low, high in ends]
        )
        self._sensor_cards = [s.card for s in sensors]
        self._pressure_pa: NDArray[np.float64] | None = None
        self._fell = np.zeros(len(self._venting), bool)
        """Chambers that were not empty at one reading at least."""
        self._failure = ""

    def outcome(self, clock: Iterable[float]) -> VentOutcome:
        """Read at each time [s] of `clock`, which lets time pass, until it is known whether they vent, or it ends."""
        began = window_s = now = np.nan
        excess_pa: NDArray[np.float64] | None = None
        for now in clock:
            if np.isnan(began):
                began = window_s = now
            try:
                self._read()
            except CardError as error:
                self._failure = str(error)
            if self._answers() and (self._excess_pa() < VENTED_TOLERANCE_PA).all():
                return VentOutcome(True, self._confirmation())
            if excess_pa is None and self._pressure_pa is not None:
                excess_pa = self._excess_pa()
            if self._failure and now - began >= UNREADABLE_S:
                break
            if now - window_s >= self._patience_s:
                if now - began >= max(LONGEST_VENTING_S, self._patience_s) or not self._falls(excess_pa):
                    break
                window_s, excess_pa = now, self._excess_pa()
        return VentOutcome(False, f"{UNCONFIRMED}: {self._reason(now - began)}", self._answers())

    def _read(self) -> None:
        scans = self._bench.read()
        after = scans.t_ns > self._since_ns
        if after.any():
            self._pressure_pa = scans.pressure_pa[after].mean(axis=0)
            self._fell |= self._excess_pa() >= VENTED_TOLERANCE_PA
            self._failure = ""

    def _excess_pa(self) -> NDArray[np.float64]:
        """Distance of each venting chamber from the pressure at its exhaust."""
        assert self._pressure_pa is not None
        return np.abs(self._pressure_pa[self._venting] - self._vented_pa)

    def _answers(self) -> bool:
        return self._pressure_pa is not None and not self._failure and not self._silent_cards()

    def _falls(self, before_pa: NDArray[np.float64] | None) -> bool:
        """True where each chamber that is not empty has lost its share since `before_pa`."""
        if before_pa is None or not self._answers():
            return False
        now_pa = self._excess_pa()
        kept = (1.0 - LEAST_DROP_PER_S) ** self._patience_s
        return bool(((now_pa < VENTED_TOLERANCE_PA) | (now_pa <= kept * before_pa)).all())

    def _silent_cards(self) -> list[str]:
        """Cards that give full scale at each pressure sensor: what a board answers that is pulled or hangs."""
        assert self._pressure_pa is not None
        full = self._pressure_pa >= self._full_scale_pa
        names = dict.fromkeys(self._sensor_cards)
        return [
            name for name in names if all(f for f, card in zip(full, self._sensor_cards, strict=True) if card == name)
        ]

    def _confirmation(self) -> str:
        held = "".join(f", actuator {a + 1} is held at {_bar(self._pressure(a))} bar" for a in self._held)
        if not len(self._venting):
            return f"no pressure can confirm it{held}"
        levels = ", ".join(_bar(self._pressure(a)) for a in self._venting.tolist())
        if not self._fell.any():
            # An empty chamber stays empty behind a valve that does not move.
            return f"the pressures are low from the first reading on: {levels} bar{held}"
        low = [str(a + 1) for a, fell in zip(self._venting.tolist(), self._fell.tolist(), strict=True) if not fell]
        before = f" (low from the first reading on: actuator{'s' * (len(low) > 1)} {', '.join(low)})" if low else ""
        return f"the pressures confirm it: {levels} bar{before}{held}"

    def _pressure(self, actuator: int) -> float:
        assert self._pressure_pa is not None
        return float(self._pressure_pa[actuator])

    def _reason(self, waited_s: float) -> str:
        written = "the safe outputs were written, but"
        if self._failure:
            return f"{written} the pressures cannot be read ({self._failure})"
        if self._pressure_pa is None:
            return f"{written} no pressure has been read since"
        if silent := self._silent_cards():
            return (
                f"{written} card {', '.join(silent)} reads full scale at every pressure sensor: it is pulled or hangs"
            )
        full = ", ".join(
            f"actuator {a + 1} "
            + ("without a reading" if np.isnan(excess) else f"at {self._pressure(a) / PA_PER_BAR:.2f} bar")
            for a, excess in zip(self._venting.tolist(), self._excess_pa().tolist(), strict=True)
            if not excess < VENTED_TOLERANCE_PA
        )
        return (
            f"{full} {waited_s:.0f} s after the valves were commanded to vent: a valve is stuck or its ports are the "
            "wrong way round, or a sensor is broken"
        )


def verify_venting(config: BenchConfig, *, vent: bool, patience_s: float = VENTING_S) -> VentOutcome:
    """Open a rig whose safe state has been written and watch its chambers vent.

    For a process that does not sample itself. A card that cannot be opened, because another process still has it, is
    tried again for UNREADABLE_S.
    """
    source = _OpenedBench(config)
    try:
        verification = VentVerification(config, source, vent=vent, patience_s=patience_s, since_ns=time.monotonic_ns())
        return verification.outcome(real_time(lambda: None))
    finally:
        source.close()


def real_time(alive: Callable[[], None]) -> Iterator[float]:
    """Times [s] of CLOCK_MONOTONIC, LOOK_S apart; `alive` is called before each."""
    while True:
        alive()
        yield time.monotonic()
        time.sleep(LOOK_S)


class _OpenedBench:
    """The pressures of a rig that is opened at the first reading that succeeds."""

    def __init__(self, config: BenchConfig) -> None:
        self._config = config
        self._bench: Bench | None = None

    def read(self) -> BenchScans:
        if self._bench is None:
            # A card whose interrupts are lost still answers.
            bench = open_bench(self._config, by_instruction=True)
            try:
                bench.start()
            except BaseException:
                bench.close()
                raise
            self._bench = bench
        return self._bench.read()

    def close(self) -> None:
        if self._bench is not None:
            with suppress(CardError):
                self._bench.close()


def _bar(pressure_pa: float) -> str:
    return f"{round(pressure_pa / PA_PER_BAR, 2) + 0.0:.2f}"
