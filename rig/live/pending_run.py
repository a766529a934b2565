"""A run that is about to begin: the page is up before it, and shows it as soon as its door opens."""

from __future__ import annotations

import time
from pathlib import Path
from typing import Any

from rig.execution.plan import StartError
from rig.live.client_session import ClientSession, connect
from rig.live.live_run import LiveRun
from rig.live.run_source import Viewer

KNOCK_EVERY_S = 0.1


class PendingRun:
    """The source for a run whose door may still be shut: simulators and compilers can take their time."""

    live = True

    def __init__(self, door: Path) -> None:
        self._door = door
        self._watching: LiveRun | None = None
        self._knocked = 0.0

    @property
    def over(self) -> bool:
        """True once the run has ended."""
        return self._watching is not None and self._watching.over

    def about(self) -> dict[str, Any] | None:
        """What does not change; None while the run has not begun."""
        return None if self._watching is None else self._watching.about()

    def viewer(self) -> Viewer:
        """The view of one more browser.

        Raises:
            StartError: the run has not begun.
        """
        if self._watching is None:
            raise StartError("the run has not begun")
        return self._watching.viewer()

    def update(self) -> None:
        """Knock, or pass on what the run has written."""
        if self._watching is not None:
            self._watching.update()
            return
        now = time.monotonic()
        if now - self._knocked < KNOCK_EVERY_S:
            return
        self._knocked = now
        if door := connect(self._door):
            door.close()
            self._watching = LiveRun(ClientSession(self._door))
