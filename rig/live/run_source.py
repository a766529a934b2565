"""Interface of the page's data sources: a running experiment or an archive."""

from __future__ import annotations

from typing import Any, Protocol

from rig.live.messages import Message
from rig.live.view_state import RunDescription


class Viewer(Protocol):
    """One browser's view of a source; it buffers no packets."""

    def packet(self) -> bytes | None:
        """Return the data since the last call; None where there is none."""

    def handle(self, message: Message, who: str) -> dict[str, Any] | None:
        """Execute a message; return the answer, `done` and `message`, or None."""

    def close(self) -> None:
        """Unregister the browser."""


class RunSource(Protocol):
    """Source of packets. `live`: messages act on a rig, so only the operator may send them."""

    live: bool

    @property
    def finished(self) -> bool:
        """True once no more data will come."""

    def about(self) -> RunDescription | None:
        """Return the constant properties; None before the run starts."""

    def viewer(self) -> Viewer:
        """Return a view for one more browser."""

    def update(self) -> None:
        """Read new data; called about a hundred times a second."""
