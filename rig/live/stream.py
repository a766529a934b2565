"""The websocket stream to one browser. The browser requests each packet, so a slow or stalled one causes no backlog.

`rig.live.messages` defines the browser's messages; any other message is refused. Packets are binary messages (see
`rig.live.packets`), answers are text. Guests share a limited number of streams; an operator's streams are limited by
their connections only.
"""

from __future__ import annotations

import asyncio
import json
from contextlib import suppress
from dataclasses import asdict
from typing import Any, Protocol

from starlette.websockets import WebSocket, WebSocketDisconnect

from rig.live.authentication import SESSION, LoginSession
from rig.live.messages import Message, MessageError, parse
from rig.live.packets import RunDescription, plain


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


POLL_S = 0.008
WAIT_S = 0.1
LEAST_PERIOD_S = 0.02
MOST_GUESTS = 24

_guests = 0


async def stream(socket: WebSocket, source: RunSource) -> None:
    """Serve one browser until it disconnects."""
    global _guests
    session: LoginSession = socket.scope[SESSION]
    guest = not session.operator
    if guest and _guests >= MOST_GUESTS:
        await socket.close(1013)
        return
    _guests += guest
    try:
        await socket.accept()
        while (about := source.about()) is None:
            await asyncio.sleep(WAIT_S)
        await _serve(socket, source, session, about)
    except (WebSocketDisconnect, RuntimeError):
        pass
    finally:
        _guests -= guest


async def _serve(socket: WebSocket, source: RunSource, session: LoginSession, about: RunDescription) -> None:
    viewer = source.viewer()
    ready = asyncio.Event()
    lock = asyncio.Lock()
    sending = asyncio.create_task(_send(socket, viewer, ready, lock))
    try:
        greeting = {**plain(asdict(about)), "who": session.who, "operator": session.operator}
        async with lock:
            await socket.send_text(json.dumps({"about": greeting}))
        await _listen(socket, viewer, session, ready, lock, source.live)
    finally:
        viewer.close()
        sending.cancel()
        with suppress(asyncio.CancelledError, WebSocketDisconnect, RuntimeError):
            await sending


async def _listen(
    socket: WebSocket,
    viewer: Viewer,
    session: LoginSession,
    ready: asyncio.Event,
    lock: asyncio.Lock,
    acting: bool,
) -> None:
    while True:
        answer: dict[str, Any] | None
        try:
            message = await _message(socket)
        except MessageError as error:
            answer = {"done": False, "message": str(error)}
        else:
            if message.more is not None:
                ready.set()
                continue
            if acting and not session.operator:
                answer = {"done": False, "message": "refused: this is a view-only session"}
            else:
                # A busy supervisor may answer late; other browsers must not wait.
                answer = await asyncio.to_thread(viewer.handle, message, session.who)
        if answer is not None:
            async with lock:
                await socket.send_text(json.dumps({"answer": answer}))


async def _send(socket: WebSocket, viewer: Viewer, ready: asyncio.Event, lock: asyncio.Lock) -> None:
    while True:
        await ready.wait()
        packet = viewer.packet()
        while packet is None:
            await asyncio.sleep(POLL_S)
            packet = viewer.packet()
        ready.clear()
        async with lock:
            await socket.send_bytes(packet)
        await asyncio.sleep(LEAST_PERIOD_S)


async def _message(socket: WebSocket) -> Message:
    received = await socket.receive()
    if received["type"] == "websocket.disconnect":
        raise WebSocketDisconnect(received.get("code", 1000))
    if (text := received.get("text")) is None:
        raise MessageError("refused: messages are text, not binary")
    return parse(text)
