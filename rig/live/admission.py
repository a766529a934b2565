"""Admission control: which connections the page keeps when more come than it has places for.

uvicorn's `limit_concurrency` counts all connections alike and has no time limit for a request's head, so whoever opens
enough of them shuts the page for everybody. Here a connection is counted by what its requests have shown: no session,
a guest's, an operator's. Each kind has places of its own, so strangers take none of an operator's. A full kind gives
up the oldest connection of the address that has most of them. A connection without a session is closed after
`STRANGER_S`, whatever it is doing: sending a head or a form byte by byte, or not reading its answer.
"""

from __future__ import annotations

import asyncio
from collections import Counter
from enum import Enum
from typing import cast

from uvicorn.protocols.http.h11_impl import H11Protocol

ACCEPTED_AT_ONCE = 16
"""Connections accepted in one pass of the event loop. A connection is read one pass after it is taken in. At most 34
others have been taken in by then, fewer than strangers have places: its first request is always read."""
STRANGER_S = 10.0
CONNECTION = "softrig.connection"
"""Where the connection is found in a request's `state`."""


class Rank(Enum):
    """What a connection has shown; the value orders them."""

    STRANGER = 0
    GUEST = 1
    OPERATOR = 2


PLACES = {Rank.STRANGER: 64, Rank.GUEST: 96, Rank.OPERATOR: 96}
"""Connections of each rank. A browser uses up to eight while it loads the page, then two."""


class Connection:
    """One connection and its rank."""

    def __init__(self, admission: Admission, transport: asyncio.Transport) -> None:
        self._admission = admission
        self.transport = transport
        peer = transport.get_extra_info("peername")
        self.address = str(peer[0]) if peer else ""
        self.rank = Rank.STRANGER

    def raise_to(self, rank: Rank) -> None:
        """Count it as the higher of its rank and this one."""
        if rank.value > self.rank.value:
            self.rank = rank
            self._admission.make_room(rank)


class Admission:
    """Every open connection, oldest first."""

    def __init__(self, places: dict[Rank, int] = PLACES, stranger_s: float = STRANGER_S) -> None:
        self._places = places
        self._stranger_s = stranger_s
        self._open: list[Connection] = []

    def enter(self, transport: asyncio.Transport) -> Connection:
        """Take in a new connection."""
        connection = Connection(self, transport)
        self._open.append(connection)
        self.make_room(Rank.STRANGER)
        asyncio.get_running_loop().call_later(self._stranger_s, self._expire, connection)
        return connection

    def make_room(self, rank: Rank) -> None:
        """Close connections of a rank until it has no more than its places."""
        # A websocket's protocol replaces the one that was told of the connection: its end shows in the transport.
        self._open = [c for c in self._open if not c.transport.is_closing()]
        members = [c for c in self._open if c.rank is rank]
        while len(members) > self._places[rank]:
            ((address, _),) = Counter(c.address for c in members).most_common(1)
            oldest = next(c for c in members if c.address == address)
            members.remove(oldest)
            self._open.remove(oldest)
            oldest.transport.abort()

    def _expire(self, connection: Connection) -> None:
        if connection.rank is Rank.STRANGER:
            connection.transport.abort()


def http_protocol(admission: Admission) -> type[asyncio.Protocol]:
    """uvicorn's HTTP/1.1 protocol, with each connection known to the admission control and named in `state`."""

    class Admitted(H11Protocol):
        def connection_made(self, transport: asyncio.BaseTransport) -> None:
            super().connection_made(cast(asyncio.Transport, transport))
            self.app_state = {**self.app_state, CONNECTION: admission.enter(self.transport)}

    return Admitted
