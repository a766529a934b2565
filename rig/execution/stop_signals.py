"""Stop signals and that of `rig vent` as a request that the run polls, instead of an asynchronous exception."""

from __future__ import annotations

import signal
from types import FrameType

VENT_SIGNAL = signal.SIGUSR1
"""Tells a process that listens to it to vent; the default action of this signal would end any other process."""
VENTED = "vented by `rig vent`"
_MEANING = {
    signal.SIGINT: "by the operator (Ctrl-C)",
    signal.SIGTERM: "by SIGTERM",
    VENT_SIGNAL: VENTED,
}
if hasattr(signal, "SIGHUP"):  # not on Windows, where archives are read
    _MEANING[signal.SIGHUP] = "the terminal was closed (SIGHUP)"


class StopSignals:
    """While entered, stop signals only set `reason`. A second signal is ignored, so that the run ends in order.

    After a stop request later signals stay ignored, so that the result is printed and the exit status is the run's. A
    program that continues after the run, such as a notebook, sets `restore`.
    """

    def __init__(self, *, restore: bool = False) -> None:
        self.reason: str | None = None
        self._restore = restore
        self._previous: dict[signal.Signals, object] = {}

    def __enter__(self) -> StopSignals:
        for number in _MEANING:
            self._previous[number] = signal.signal(number, self._note)
        return self

    def __exit__(self, *error: object) -> None:
        for number, handler in self._previous.items():
            signal.signal(number, handler if self.reason is None or self._restore else signal.SIG_IGN)  # type: ignore[arg-type]

    def _note(self, number: int, frame: FrameType | None) -> None:
        if self.reason is None:
            self.reason = _MEANING[signal.Signals(number)]
