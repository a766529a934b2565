"""A run that is about to begin: the page is up before it, and shows it as soon as its door opens."""

from __future__ import annotations

import time
from pathlib import Path
from typing import Any

from rig.execution.plan import StartError
from rig.live.client_session import ClientSession, connect
from rig.live.live_run import LiveRun
from rig.live.run_source import Viewer

CONNECT_EVERY_S = 0.1


class PendingRun:
    """The source for a run whose door may still be shut: simulators and compilers can take their time."""

    live = True

    def __init__(self, path: Path) -> None:
        self._path = path
        self._live_run: LiveRun | None = None
        self._last_attempt_s = 0.0

    @property
    def finished(self) -> bool:
        """True once the run has ended."""
        return self._live_run is not None and self._live_run.finished

    def about(self) -> dict[str, Any] | None:
        """What does not change; None while the run has not begun."""
        return None if self._live_run is None else self._live_run.about()

    def viewer(self) -> Viewer:
        """The view of one more browser.

        Raises:
            StartError: the run has not begun.
        """
        if self._live_run is None:
            raise StartError("the run has not begun")
        return self._live_run.viewer()

    def update(self) -> None:
        """Knock, or pass on what the run has written."""
        if self._live_run is not None:
            self._live_run.update()
            return
        now = time.monotonic()
        if now - self._last_attempt_s < CONNECT_EVERY_S:
            return
        self._last_attempt_s = now
        if path := connect(self._path):
            path.close()
            self._live_run = LiveRun(ClientSession(self._path))
