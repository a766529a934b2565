"""The outputs of the cards for the watchdog, also of cards that allow one process only."""

from __future__ import annotations

from rig.config.schema import RigConfig
from rig.hardware.bench import Bench, make_safe, open_bench
from rig.hardware.cards.base import CardBusyError


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
