"""The websocket stream to one browser. The browser requests each packet, so a slow or stalled one causes no backlog.

A browser sends a `Message`, a JSON object with exactly one field; any other is refused. Packets are binary messages
(see `rig.live.packets`), answers are text.
"""

from __future__ import annotations

import asyncio
import json
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import asdict
from pathlib import Path
from typing import Any, Literal, Protocol

from pydantic import BaseModel, ConfigDict, ValidationError, model_validator
from starlette.websockets import WebSocket, WebSocketDisconnect

from rig.live.authentication import VISITOR, Visitor
from rig.live.packets import RunDescription, plain
from rig.realtime.operator_commands import CommandKind

MOST_CHARACTERS = 1024
MOST_REASON = 200


class MessageError(ValueError):
    """An invalid message; the text is the answer to its sender."""


class Message(BaseModel):
    """One message. Exactly one field is set: `more` requests the next packet, `do` an action on the run."""

    model_config = ConfigDict(strict=True, extra="forbid", frozen=True)

    more: Literal[1] | None = None
    do: CommandKind | None = None

    @model_validator(mode="after")
    def _one_field(self) -> Message:
        if (self.more is None) == (self.do is None):
            raise ValueError("expected exactly one of more, do")
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

    def act(self, do: CommandKind, who: str) -> dict[str, Any]:
        """Ask the run for an action; return the answer, `done` and `message`."""

    def close(self) -> None:
        """Unregister the browser."""


class RunSource(Protocol):
    """Source of packets for so many `viewers`."""

    viewers: int

    @property
    def finished(self) -> bool:
        """True once no more data will come."""

    @property
    def awaits_results(self) -> bool:
        """True after the end while somebody waits for what the run leaves."""

    @property
    def results(self) -> Mapping[str, Path]:
        """The files that the run has left so far, by what they are: `report`, `archive`."""

    def about(self) -> RunDescription | None:
        """Return the constant properties; None before the run starts."""

    def viewer(self) -> Viewer:
        """Return a view for one more browser."""

    def update(self) -> None:
        """Read new data; called about a hundred times a second."""


POLL_S = 0.008
WAIT_S = 0.1
PACKETS_PER_S = 10.0
"""Of all browsers together: what they draw costs the computer of the bench more than the page itself."""
LONGEST_PERIOD_S = 1.0
"""Between two packets to one of many browsers."""


async def stream(socket: WebSocket, source: RunSource) -> None:
    """Serve one browser until it disconnects."""
    visitor: Visitor = socket.scope[VISITOR]
    with suppress(WebSocketDisconnect, RuntimeError):
        await socket.accept()
        while (about := source.about()) is None:
            await asyncio.sleep(WAIT_S)
        await _serve(socket, source, visitor, about)


async def _serve(socket: WebSocket, source: RunSource, visitor: Visitor, about: RunDescription) -> None:
    viewer = source.viewer()
    ready = asyncio.Event()
    lock = asyncio.Lock()
    sending = asyncio.create_task(_send(socket, viewer, ready, lock, source))
    try:
        greeting = {**plain(asdict(about)), "who": visitor.who, "operator": visitor.operator}
        async with lock:
            await socket.send_text(json.dumps({"about": greeting}))
        await _listen(socket, viewer, visitor, ready, lock)
    finally:
        viewer.close()
        sending.cancel()
        with suppress(asyncio.CancelledError, WebSocketDisconnect, RuntimeError):
            await sending


async def _listen(
    socket: WebSocket, viewer: Viewer, visitor: Visitor, ready: asyncio.Event, lock: asyncio.Lock
) -> None:
    while True:
        try:
            message = await _message(socket)
        except MessageError as error:
            answer = {"done": False, "message": str(error)}
        else:
            if message.do is None:
                ready.set()
                continue
            if visitor.operator:
                # A busy supervisor may answer late; other browsers must not wait.
                answer = await asyncio.to_thread(viewer.act, message.do, visitor.who)
            else:
                answer = {"done": False, "message": "refused: this link only reads"}
        async with lock:
            await socket.send_text(json.dumps({"answer": answer}))


async def _send(socket: WebSocket, viewer: Viewer, ready: asyncio.Event, lock: asyncio.Lock, source: RunSource) -> None:
    while True:
        await ready.wait()
        packet = viewer.packet()
        while packet is None:
            await asyncio.sleep(POLL_S)
            packet = viewer.packet()
        ready.clear()
        async with lock:
            await socket.send_bytes(packet)
        await asyncio.sleep(min(LONGEST_PERIOD_S, source.viewers / PACKETS_PER_S))


async def _message(socket: WebSocket) -> Message:
    received = await socket.receive()
    if received["type"] == "websocket.disconnect":
        raise WebSocketDisconnect(received.get("code", 1000))
    if (text := received.get("text")) is None:
        raise MessageError("refused: messages are text, not binary")
    return parse(text)
