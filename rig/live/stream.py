"""The websocket stream to one browser. The browser requests each packet, so a slow or stalled one causes no backlog.

A browser sends a `Message`, a JSON object with exactly one field; any other is refused. Packets are binary messages
(see `rig.live.packets`), answers are text. Guests share a limited number of streams; an operator's streams are limited
by their connections only.
"""

from __future__ import annotations

import asyncio
import json
from contextlib import suppress
from dataclasses import asdict
from typing import Annotated, Any, Literal, Protocol

from pydantic import BaseModel, ConfigDict, Field, FiniteFloat, ValidationError, model_validator
from starlette.websockets import WebSocket, WebSocketDisconnect

from rig.live.authentication import SESSION, LoginSession
from rig.live.packets import RunDescription, plain
from rig.realtime.operator_commands import CommandKind

FASTEST = 100.0
MOST_CHARACTERS = 1024
MOST_REASON = 200
FIELDS = ("more", "do", "seek", "speed", "play")


class MessageError(ValueError):
    """An invalid message; the text is the answer to its sender."""


class Message(BaseModel):
    """One message. Exactly one field is set: `more` requests the next packet, `do` an action on a running experiment;
    `seek` [s], `speed` (times real time) and `play` control the playback of an archive."""

    model_config = ConfigDict(strict=True, extra="forbid", frozen=True)

    more: Literal[1] | None = None
    do: CommandKind | None = None
    seek: FiniteFloat | None = None
    speed: Annotated[FiniteFloat, Field(gt=0, le=FASTEST)] | None = None
    play: bool | None = None

    @model_validator(mode="after")
    def _one_field(self) -> Message:
        if sum(getattr(self, name) is not None for name in FIELDS) != 1:
            raise ValueError(f"expected exactly one of {', '.join(FIELDS)}")
        return self


def parse(text: str) -> Message:
    """Read a message.

    Raises:
        MessageError: the message is too long, not a JSON object, or has an invalid field.
    """
    if len(text) > MOST_CHARACTERS:
        raise MessageError(f"refused: a message has at most {MOST_CHARACTERS} characters")
    try:
        return Message.model_validate_json(text)
    except ValidationError as error:
        first = error.errors(include_url=False, include_context=False)[0]
        reason = first["msg"].removeprefix("Value error, ")
        if first["loc"]:
            reason = f"{first['loc'][0]!a}: {reason}, not {first['input']!a}"
        raise MessageError(f"refused: {reason[:MOST_REASON]}") from None


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
