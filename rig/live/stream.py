"""The stream to one browser: it says when it is ready for more, so a slow or stalled one costs nothing.

The browser sends JSON objects: `{"more": 1}` asks for the next packet, `{"do": ...}` for an action or, with an
archive, for a place and speed. Packets go out as binary messages (see `rig.live.packets`), answers as text.
"""

from __future__ import annotations

import asyncio
import json
from contextlib import suppress
from typing import Any

from starlette.websockets import WebSocket, WebSocketDisconnect

from rig.live.authentication import SESSION, Session
from rig.live.run_source import RunSource, Viewer

POLL_S = 0.008
WAIT_S = 0.1
LEAST_PERIOD_S = 0.02
MESSAGE_BYTES = 1024
MOST_STREAMS = 24

_open = 0


async def stream(socket: WebSocket, source: RunSource) -> None:
    """Serve one browser until it goes."""
    global _open
    if _open >= MOST_STREAMS:
        await socket.close(1013)
        return
    _open += 1
    try:
        await socket.accept()
        while (about := source.about()) is None:
            await asyncio.sleep(WAIT_S)
        await _serve(socket, source, about)
    except (WebSocketDisconnect, RuntimeError):
        pass
    finally:
        _open -= 1


async def _serve(socket: WebSocket, source: RunSource, about: dict[str, Any]) -> None:
    session: Session = socket.scope[SESSION]
    viewer = source.viewer()
    ready = asyncio.Event()
    lock = asyncio.Lock()
    sending = asyncio.create_task(_send(socket, viewer, ready, lock))
    try:
        greeting = {**about, "who": session.who, "operator": session.operator}
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
    session: Session,
    ready: asyncio.Event,
    lock: asyncio.Lock,
    acting: bool,
) -> None:
    while True:
        text = await socket.receive_text()
        message = _parsed(text)
        if message is None:
            await socket.close(1007)
            return
        if "more" in message:
            ready.set()
            continue
        if acting and not session.operator:
            answer: dict[str, Any] | None = {"done": False, "said": "guests may look, not touch"}
        else:
            # The answer may take a moment when the conductor is busy; other browsers do not wait for it.
            answer = await asyncio.to_thread(viewer.asked, message, session.who)
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


def _parsed(text: str) -> dict[str, Any] | None:
    if len(text) > MESSAGE_BYTES:
        return None
    try:
        message = json.loads(text)
    except ValueError:
        return None
    return message if isinstance(message, dict) else None
