"""Making the valves safe: the voltages of the safe state, writing and repeating, and the check that chambers vent.

Control, the watchdog, the supervisor, the observer, virtual time and `rig vent` all use this module.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable
from contextlib import closing, suppress

import numpy as np
from numpy.typing import NDArray

from rig.config.schema import RigConfig
from rig.config.sections import PA_PER_BAR
from rig.hardware.bench import Bench, cards_with_valves, open_bench, open_outputs
from rig.hardware.cards.base import CardBusyError, CardError

RETRY_S = 0.002
"""Pause between attempts to write the safe state."""
VENTING_S = 1.0
"""Default time limit; a chamber vents in a few tenths of a second."""
VENTED_PA = 0.1 * PA_PER_BAR


def safe_voltages(config: RigConfig, *, vent: bool = False) -> tuple[float, ...]:
    """The safe voltage of each valve: vented, or held where the rig file says so and `vent` is false."""
    return tuple(valve.safe_v(vent=vent) for valve in config.valves)


def failure_of(write: Callable[[], None], patience_s: float = 0.0, pause_s: float = RETRY_S) -> str:
    """Write the safe state by `write`, again while it fails, for `patience_s`; return the failure, empty on success."""
    until = time.monotonic() + patience_s
    while True:
        try:
            write()
        except CardError as error:
            if time.monotonic() >= until:
                return str(error)
            time.sleep(pause_s)
        else:
            return ""


def make_safe(config: RigConfig, *, vent: bool) -> None:
    """Open every card of a rig and write its safe state, also if another card fails.

    Raises:
        CardError: one or more cannot be opened or written.
    """
    failures: list[CardError] = []
    for name in cards_with_valves(config):
        try:
            with closing(open_outputs(config, name)) as bench:
                bench.make_safe(vent=vent)
        except CardError as error:
            failures.append(error)
        except Exception as error:
            failures.append(CardError(f"card {name}: {type(error).__name__}: {error}"))
    if len(failures) == 1:
        raise failures[0]
    if failures:
        raise CardError("; ".join(map(str, failures)))


def unsafe_output(config: RigConfig) -> str:
    """Open every card and return a message about a valve that is neither safe nor vented.

    Empty if there is none, or if a card cannot be opened or has no read-back.
    """
    for name in cards_with_valves(config):
        with suppress(CardError), closing(open_outputs(config, name)) as bench:
            if off := bench.unsafe_output():
                return off
    return ""


class WatchdogOutputs:
    """Cards that are open for writing; if a card allows one process only, they are opened when they are needed.

    Such a card is open in control, so the watchdog can write only once control is dead.
    """

    def __init__(self, config: RigConfig) -> None:
        """Test whether two processes can open the cards at once; control must not have opened them yet.

        Raises:
            CardError: a card cannot be opened at all.
        """
        self._config = config
        bench = open_bench(config, watchdog=True)
        self._bench: Bench | None = bench
        try:
            open_bench(config, watchdog=True).close()
        except CardBusyError:
            bench.close()
            self._bench = None

    @property
    def shared(self) -> bool:
        """True if the cards can be written while control has them open."""
        return self._bench is not None

    def make_safe(self, *, vent: bool) -> None:
        """Write the safe state.

        Raises:
            CardError: a card cannot be opened or written.
        """
        if self._bench is not None:
            self._bench.make_safe(vent=vent)
            return
        make_safe(self._config, vent=vent)

    def close(self) -> None:
        """Release the cards; the outputs keep their voltages."""
        if self._bench is not None:
            self._bench.close()


class VentVerification:
    """Checks the pressures of the chambers whose safe state is vented; with `vent`, of all chambers."""

    def __init__(self, config: RigConfig, bench: Bench, *, vent: bool = False, patience_s: float = VENTING_S) -> None:
        """`patience_s` is how long the caller waits; it is part of the message."""
        self._patience_s = patience_s
        self._bench = bench
        venting = [a - 1 for valve in config.valves if vent or valve.safe_state == "vent" for a in valve.actuators]
        self._venting: NDArray[np.int64] = np.array(sorted(venting), np.int64)
        self._pressure_pa: NDArray[np.float64] | None = None

    def done(self) -> bool:
        """Read the newest scans; True once every chamber is empty.

        Raises:
            CardError: the card cannot be read.
        """
        scans = self._bench.read()
        if len(scans.t_ns):
            self._pressure_pa = scans.pressure_pa[-1, self._venting]
        return self._pressure_pa is not None and bool(np.all(self._pressure_pa < VENTED_PA))

    def verdict(self) -> str:
        """Message about chambers that are not empty; empty if all are empty or there is no scan."""
        if self._pressure_pa is None:
            return ""
        full = [
            f"actuator {a + 1} at {p / PA_PER_BAR:.2f} bar"
            for a, p in zip(self._venting.tolist(), self._pressure_pa.tolist(), strict=True)
            if p >= VENTED_PA
        ]
        if not full:
            return ""
        return (
            f"{', '.join(full)} {self._patience_s:g} s after the valves were commanded to vent: a valve is stuck or "
            "its ports are the wrong way round, or a sensor is broken; shut the air off by hand"
        )

    def outcome(self, checks: Iterable[object]) -> str:
        """Check once per item of `checks`, which lets time pass, until every chamber is empty; return the verdict."""
        with suppress(CardError):
            for _ in checks:
                if self.done():
                    return ""
        return self.verdict()
