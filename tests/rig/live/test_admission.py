"""Clients without a session can neither block the page nor stay on it: the operator is answered while they try."""

from __future__ import annotations

import json
import socket
import subprocess
import sys
import threading
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from typing import Any
from urllib.parse import urlsplit

import pytest
import uvicorn
from hypothesis import given
from hypothesis import strategies as st
from websockets.exceptions import ConnectionClosed, InvalidStatus

import tests.support.synthetic_runs as made_up
from rig.live.admission import ACCEPTED_AT_ONCE, CONNECTION, PLACES, Admission, ClientClass, http_protocol
from runs.archive.writer import finalise
from scripts.live_client import Stream, enter, printed_link, request

PATIENCE_S = 60.0
ONE_BYTE = b"G"
HALF_A_HEAD = b"GET / HTTP/1.1\r\nHost: 127.0.0.1\r\nX: "
SLOW_LOGIN = (
    b"POST /login HTTP/1.1\r\nHost: 127.0.0.1\r\nContent-Type: application/x-www-form-urlencoded\r\n"
    b"Content-Length: 200\r\n\r\nt"
)


class Links:
    """The two links that a page prints, and everything that it has printed so far."""

    def __init__(self, operator: str, guest: str, printed: Callable[[], str]) -> None:
        self.operator, self.guest, self.printed = operator, guest, printed


@pytest.fixture(scope="module")
def page(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Links]:
    """A `rig live` of its own that plays a made-up archive on the loopback interface."""
    folder = tmp_path_factory.mktemp("page")
    archive = finalise(made_up.write_journal(folder / "run.mcap").path)
    log = folder / "log"
    with log.open("w") as file:
        process = subprocess.Popen(
            [sys.executable, "-m", "rig", "live", str(archive), "--port", "0"],
            stdin=subprocess.DEVNULL,
            stdout=file,
            stderr=subprocess.STDOUT,
            start_new_session=True,
        )
    try:
        links = Links(
            printed_link(log.read_text, "live page"), printed_link(log.read_text, "guest link"), log.read_text
        )
        request(links.operator)
        yield links
        assert "Traceback" not in log.read_text()
    finally:
        process.terminate()
        process.wait(PATIENCE_S)


@contextmanager
def held_open(url: str, number: int, data: bytes) -> Iterator[list[socket.socket]]:
    """So many connections, each of which has sent this much and waits."""
    place = urlsplit(url)
    with ExitStack() as stack:
        opened = []
        for _ in range(number):
            connection = stack.enter_context(
                socket.create_connection((place.hostname or "", place.port or 0), PATIENCE_S)
            )
            connection.sendall(data)
            opened.append(connection)
        yield opened


@pytest.mark.parametrize(
    ("number", "data"), [(270, ONE_BYTE), (300, HALF_A_HEAD), (120, SLOW_LOGIN), (300, b"")], ids=str
)
def test_held_connections_without_a_session_do_not_lock_operators_out(page: Links, number: int, data: bytes) -> None:
    cookie = enter(page.operator)
    with Stream(page.operator, cookie) as before, held_open(page.operator, number, data):
        assert request(page.operator, Cookie=cookie)[0] == 200
        assert before.packet()[0]["now"]
        with Stream(page.operator) as after:  # one more login while they wait
            assert after.packet()[0]["now"]


def test_streams_without_a_token_are_refused_and_guests_take_no_operators_place(page: Links) -> None:
    with pytest.raises(InvalidStatus):
        Stream(page.operator.partition("#")[0])
    guest = enter(page.guest)
    refused = 0
    with ExitStack() as stack:
        for _ in range(30):
            try:
                stack.enter_context(Stream(page.guest, guest))
            except (InvalidStatus, ConnectionClosed):
                refused += 1
        assert refused == 6
        with Stream(page.operator) as operator:
            assert operator.packet()[0]["now"]


@pytest.mark.parametrize(
    "said", ['{"do": ["vent"]}', '{"do": "pause"}', "{", "[]", "1" * 2000, '{"seek": "x"}', b"\x00\xff", ""], ids=str
)
def test_a_malformed_message_is_refused_and_the_stream_continues(page: Links, said: str | bytes) -> None:
    with Stream(page.operator) as stream:
        stream.socket.send(said)
        answer = json.loads(stream.socket.recv(PATIENCE_S))["answer"]
        assert answer["done"] is False
        assert answer["message"].startswith("refused: ")
        assert stream.packet()[0]["now"]


def test_text_that_is_not_utf8_closes_the_stream_with_one_line_on_the_terminal(page: Links) -> None:
    for _ in range(2):
        with Stream(page.guest) as stream:
            stream.socket.send(b"\xff\xfe", text=True)
            with pytest.raises(ConnectionClosed):
                stream.until("never")
    assert page.printed().count("UTF-8") == 1
    assert "Traceback" not in page.printed()


def test_a_guest_that_vanishes_after_many_messages_does_not_fill_the_terminal(page: Links) -> None:
    guest = enter(page.guest)
    place = urlsplit(page.guest)
    opening = (
        f"GET /live/stream HTTP/1.1\r\nHost: {place.netloc}\r\nCookie: {guest}\r\nUpgrade: websocket\r\n"
        "Connection: Upgrade\r\nSec-WebSocket-Version: 13\r\nSec-WebSocket-Key: AAAAAAAAAAAAAAAAAAAAAA==\r\n\r\n"
    ).encode()
    message = b"[]"  # refused at once
    frame = bytes([0x81, 0x80 | len(message), 0, 0, 0, 0]) + message  # masked with zeros
    before = page.printed().count("\n")
    for _ in range(40):
        with socket.create_connection((place.hostname or "", place.port or 0), PATIENCE_S) as guest_socket:
            guest_socket.sendall(opening)
            guest_socket.recv(1)
            guest_socket.sendall(frame * 2000)
            # Unread answers make the kernel reset the connection when it is closed.
    with Stream(page.operator) as operator:
        assert operator.packet()[0]["now"]
    assert page.printed().count("\n") <= before + 1


def test_connections_of_a_guest_take_no_operators_place(page: Links) -> None:
    guest = enter(page.guest)
    asking = f"GET /live/live.css HTTP/1.1\r\nHost: 127.0.0.1\r\nCookie: {guest}\r\n\r\n".encode()
    cookie = enter(page.operator)
    with held_open(page.guest, 200, asking + HALF_A_HEAD):
        assert request(page.operator, Cookie=cookie)[0] == 200
        with Stream(page.operator) as operator:
            assert operator.packet()[0]["now"]


async def _answer(scope: Any, receive: Any, send: Any) -> None:
    """An application whose `/operator` has a session and whose other pages have none; it waits for the whole body."""
    if scope["path"] == "/operator":
        scope["state"][CONNECTION].raise_to(ClientClass.OPERATOR)
    while (await receive()).get("more_body"):
        pass
    await send({"type": "http.response.start", "status": 200, "headers": [(b"content-length", b"2")]})
    await send({"type": "http.response.body", "body": b"ok"})


@contextmanager
def serving(stranger_s: float) -> Iterator[str]:
    """A server with admission control and its own time limit; its address."""
    listening = socket.create_server(("127.0.0.1", 0))
    http = http_protocol(Admission(stranger_s=stranger_s))
    server = uvicorn.Server(
        uvicorn.Config(_answer, http=http, lifespan="off", log_level="error", timeout_keep_alive=60)
    )
    thread = threading.Thread(target=server.run, kwargs={"sockets": [listening]})
    thread.start()
    try:
        yield f"http://127.0.0.1:{listening.getsockname()[1]}/"
    finally:
        server.should_exit = True
        server.force_exit = True
        thread.join()
        listening.close()


@pytest.mark.parametrize("data", [b"", ONE_BYTE, HALF_A_HEAD, SLOW_LOGIN], ids=str)
def test_a_connection_without_a_session_is_closed_at_any_stage_of_a_request(data: bytes) -> None:
    with serving(stranger_s=0.2) as url, held_open(url, 1, data) as (connection,):
        assert connection.recv(1) == b""


def test_an_operators_connection_stays_and_may_send_the_next_request_late() -> None:
    with serving(stranger_s=0.2) as url, held_open(url, 1, b"GET /operator HTTP/1.1\r\nHost: x\r\n\r\n") as (kept,):
        answer = b""
        while not answer.endswith(b"ok"):
            answer += kept.recv(1000)
        with held_open(url, 1, ONE_BYTE) as (stranger,):
            assert stranger.recv(1) == b""  # the limit has passed
        kept.sendall(b"GET /operator HTTP/1.1\r\nHost: x\r\n\r\n")
        assert kept.recv(1000).startswith(b"HTTP/1.1 200")


class Line:
    """A transport from an address."""

    def __init__(self, address: str) -> None:
        self.address = address
        self.closed = False

    def get_extra_info(self, name: str) -> tuple[str, int]:
        """Where it comes from."""
        assert name == "peername"
        return self.address, 1

    def is_closing(self) -> bool:
        """True once it has been closed."""
        return self.closed

    def abort(self) -> None:
        """Close it."""
        self.closed = True


@pytest.fixture
def no_clock(monkeypatch: pytest.MonkeyPatch) -> None:
    """Connections that are not closed by time."""

    class Loop:
        def call_later(self, *_: object) -> None:
            """Never."""

    monkeypatch.setattr("asyncio.get_running_loop", Loop)


@pytest.mark.usefixtures("no_clock")
def test_the_address_with_most_connections_gives_up_its_oldest() -> None:
    admission = Admission({ClientClass.STRANGER: 4, ClientClass.GUEST: 2, ClientClass.OPERATOR: 2})
    lines = [Line(address) for address in ("b", "a", "a", "a", "a", "c")]
    for line in lines:
        admission.enter(line)  # type: ignore[arg-type]
    assert [line.closed for line in lines] == [False, True, True, False, False, False]


ARRIVALS = st.lists(st.tuples(st.sampled_from("abc"), st.sampled_from(list(ClientClass)), st.booleans()), max_size=80)


@pytest.mark.usefixtures("no_clock")
@given(ARRIVALS)
def test_no_rank_has_more_than_its_places_and_none_loses_one_to_another(
    arrivals: list[tuple[str, ClientClass, bool]],
) -> None:
    places = {ClientClass.STRANGER: 3, ClientClass.GUEST: 4, ClientClass.OPERATOR: 5}
    admission = Admission(places)
    lines: list[tuple[Line, ClientClass]] = []
    for address, rank, leaves in arrivals:
        line = Line(address)
        before = {r: [other for other, known in lines if known is r and not other.closed] for r in ClientClass}
        admission.enter(line).raise_to(rank)  # type: ignore[arg-type]
        assert not line.closed
        lines.append((line, rank))
        for other in ClientClass:
            if other not in (rank, ClientClass.STRANGER):
                assert not any(kept.closed for kept in before[other])
            assert sum(known is other and not kept.closed for kept, known in lines) <= places[other]
        if leaves:
            line.abort()


def test_connections_before_their_first_request_count_as_without_a_session() -> None:
    assert PLACES[ClientClass.STRANGER] > 2 * (ACCEPTED_AT_ONCE + 1)
