"""The source for a run that is starting: the page connects as soon as the control socket exists."""

from __future__ import annotations

import time
from pathlib import Path

from rig.execution.plan import StartError
from rig.live.client_session import ClientSession, connect
from rig.live.live_run import LiveRun
from rig.live.run_source import Viewer
from rig.live.view_state import RunDescription

CONNECT_EVERY_S = 0.1


class PendingRun:
    """Waits for a run's control socket, then delegates to `LiveRun`; simulation and compilation may delay the start."""

    live = True

    def __init__(self, path: Path) -> None:
        self._path = path
        self._live_run: LiveRun | None = None
        self._last_attempt_s = 0.0

    @property
    def finished(self) -> bool:
        """True once the run has ended."""
        return self._live_run is not None and self._live_run.finished

    def about(self) -> RunDescription | None:
        """Return the constant properties; None before the run starts."""
        return None if self._live_run is None else self._live_run.about()

    def viewer(self) -> Viewer:
        """Return a view for one more browser.

        Raises:
            StartError: the run has not started.
        """
        if self._live_run is None:
            raise StartError("the run has not started")
        return self._live_run.viewer()

    def update(self) -> None:
        """Try to connect, or read new data."""
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
