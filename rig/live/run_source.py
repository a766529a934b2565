"""What a page can show: a run that goes, or an archive."""

from __future__ import annotations

from typing import Any, Protocol

from rig.live.messages import Message


class Viewer(Protocol):
    """One browser's view of a source. Nothing is kept for one that does not ask."""

    def packet(self) -> bytes | None:
        """What is new since the last call, None when nothing is."""

    def handle(self, message: Message, who: str) -> dict[str, Any] | None:
        """Do what somebody asks for; the answer, `done` and `said`, None for nothing."""

    def close(self) -> None:
        """The browser has gone."""


class RunSource(Protocol):
    """Where the packets come from. `live`: what is asked of it acts on a rig, and is the operator's alone."""

    live: bool

    @property
    def finished(self) -> bool:
        """True when there will be nothing new any more."""

    def about(self) -> dict[str, Any] | None:
        """What does not change: title, actuators, duration, limits; None while there is nothing to show yet."""

    def viewer(self) -> Viewer:
        """The view of one more browser."""

    def update(self) -> None:
        """Called some hundred times a second."""
