"""Admission control: which connections the page keeps when more arrive than it accepts.

uvicorn's `limit_concurrency` counts all connections alike and has no time limit for a request's head, so one
client can exhaust it. Here each connection has a rank: no session, guest, operator. Each rank has its own limit, so
unauthenticated connections never displace an operator's. A full rank closes the oldest connection of the address with
most connections. A connection without a session is closed after `STRANGER_S`, even in the middle of a request.
"""

from __future__ import annotations

import asyncio
from collections import Counter
from enum import Enum
from typing import cast

from uvicorn.protocols.http.h11_impl import H11Protocol

ACCEPTED_AT_ONCE = 16
"""Connections accepted in one pass of the event loop. A connection is read one pass after it is accepted. At most 34
others are accepted by then, fewer than the limit of strangers: its first request is always read."""
STRANGER_S = 10.0
CONNECTION = "softrig.connection"
"""Key of the connection in a request's `state`."""


class ClientClass(Enum):
    """Authentication rank of a connection, in ascending order."""

    STRANGER = 0
    GUEST = 1
    OPERATOR = 2


PLACES = {ClientClass.STRANGER: 64, ClientClass.GUEST: 96, ClientClass.OPERATOR: 96}
"""Connections of each rank. A browser uses up to eight while it loads the page, then two."""


class Connection:
    """One connection and its rank."""

    def __init__(self, admission: Admission, transport: asyncio.Transport) -> None:
        self._admission = admission
        self.transport = transport
        peer = transport.get_extra_info("peername")
        self.address = str(peer[0]) if peer else ""
        self.rank = ClientClass.STRANGER

    def raise_to(self, rank: ClientClass) -> None:
        """Raise the rank to `rank` if that is higher."""
        if rank.value > self.rank.value:
            self.rank = rank
            self._admission.make_room(rank)


class Admission:
    """Every open connection, oldest first."""

    def __init__(self, places: dict[ClientClass, int] = PLACES, stranger_s: float = STRANGER_S) -> None:
        self._places = places
        self._stranger_s = stranger_s
        self._open: list[Connection] = []

    def enter(self, transport: asyncio.Transport) -> Connection:
        """Register a new connection."""
        connection = Connection(self, transport)
        self._open.append(connection)
        self.make_room(ClientClass.STRANGER)
        asyncio.get_running_loop().call_later(self._stranger_s, self._expire, connection)
        return connection

    def make_room(self, rank: ClientClass) -> None:
        """Close connections of a rank until it is within its limit."""
        # The websocket protocol replaces the HTTP protocol, so only the transport reports the end of the connection.
        self._open = [c for c in self._open if not c.transport.is_closing()]
        members = [c for c in self._open if c.rank is rank]
        while len(members) > self._places[rank]:
            ((address, _),) = Counter(c.address for c in members).most_common(1)
            oldest = next(c for c in members if c.address == address)
            members.remove(oldest)
            self._open.remove(oldest)
            oldest.transport.abort()

    def _expire(self, connection: Connection) -> None:
        if connection.rank is ClientClass.STRANGER:
            connection.transport.abort()


def http_protocol(admission: Admission) -> type[asyncio.Protocol]:
    """Return uvicorn's HTTP/1.1 protocol with each connection registered and stored in `state`."""

    class Admitted(H11Protocol):
        def connection_made(self, transport: asyncio.BaseTransport) -> None:
            super().connection_made(cast(asyncio.Transport, transport))
            self.app_state = {**self.app_state, CONNECTION: admission.enter(self.transport)}

    return Admitted
