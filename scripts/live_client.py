"""A client of the live page without a browser: its address, a request, and a viewer of its stream."""

from __future__ import annotations

import http.client
import json
import re
import struct
import time
from collections.abc import Callable
from contextlib import ExitStack
from typing import Any
from urllib.parse import urlsplit

from websockets.sync.client import ClientConnection, connect

PATIENCE_S = 150.0


def printed_link(output: Callable[[], str], what: str) -> str:
    """The address on the line of the terminal that begins with `what`; waits until it is there."""
    deadline = time.monotonic() + PATIENCE_S
    while not (found := re.search(rf"^{what}\s+(http://\S+)", output(), re.MULTILINE)):
        assert time.monotonic() < deadline, output()
        time.sleep(0.05)
    return found.group(1)


def request(url: str, **headers: str) -> tuple[int, str]:
    """Status of a GET, and the cookie that it sets (empty when it sets none); waits for the page to come up."""
    place = urlsplit(url)
    deadline = time.monotonic() + PATIENCE_S
    while True:
        connection = http.client.HTTPConnection(place.hostname or "", place.port, timeout=PATIENCE_S)
        try:
            connection.request("GET", f"{place.path or '/'}?{place.query}", headers=headers)
            answer = connection.getresponse()
            answer.read()
            return answer.status, (answer.getheader("set-cookie") or "").split(";")[0]
        except ConnectionError:
            assert time.monotonic() < deadline, "the page does not come up"
            time.sleep(0.1)
        finally:
            connection.close()


class Stream:
    """One viewer of a page, as its browser would be, by a link that the terminal has printed."""

    def __init__(self, link: str, origin: str | None = None) -> None:
        place = urlsplit(link)
        self._left = ExitStack()
        opening = connect(
            f"ws://{place.hostname}:{place.port}/live/stream?{place.query}",
            origin=origin,  # type: ignore[arg-type]
            max_size=None,
            open_timeout=PATIENCE_S,
        )
        self.socket: ClientConnection = self._left.enter_context(opening)
        self.about: dict[str, Any] = json.loads(self.socket.recv(PATIENCE_S))["about"]

    def __enter__(self) -> Stream:
        return self

    def __exit__(self, *error: object) -> None:
        self._left.close()

    def packet(self) -> tuple[dict[str, Any], bytes]:
        """The next packet: its numbers and its picture."""
        self.socket.send('{"more": 1}')
        while isinstance(data := self.socket.recv(PATIENCE_S), str):
            pass
        (length,) = struct.unpack_from("<I", data)
        return json.loads(data[4 : 4 + length]), data[4 + length :]

    def until(self, state: str) -> dict[str, Any]:
        """Packets until the run is in a state; the numbers then."""
        deadline = time.monotonic() + PATIENCE_S
        while (body := self.packet()[0])["now"]["state"] != state:
            assert time.monotonic() < deadline, body["now"]
        now: dict[str, Any] = body["now"]
        return now

    def act(self, do: str) -> dict[str, Any]:
        """Ask for an action; the answer."""
        self.socket.send(json.dumps({"do": do}))
        while not isinstance(data := self.socket.recv(PATIENCE_S), str):
            pass
        answer: dict[str, Any] = json.loads(data)["answer"]
        return answer
