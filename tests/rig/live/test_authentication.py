"""Authentication of the page: only the login without a session, no request of another site, no token shown."""

from __future__ import annotations

import asyncio
import logging
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from rig.live.authentication import COOKIE, SESSION, AccessTokens, AuthenticationMiddleware, LoginSession
from tests.support.budget import examples

HOST = "192.168.1.20:8090"
PORT = 8090
SECRET = b"the page and its data"


async def _inside(scope: Any, receive: Any, send: Any) -> None:
    """An application that answers each request that the middleware passes on."""
    if scope["type"] == "websocket":
        await receive()
        await send({"type": "websocket.accept"})
        return
    await send({"type": "http.response.start", "status": 200, "headers": []})
    await send({"type": "http.response.body", "body": SECRET + scope[SESSION].who.encode()})


class Reply:
    """What a request got back."""

    def __init__(self, messages: list[dict[str, Any]]) -> None:
        self.messages = messages
        first = messages[0]
        self.status = first.get("status", 0)
        self.headers = {k.decode(): v.decode() for k, v in first.get("headers", [])}
        self.body = b"".join(m.get("body", b"") for m in messages)
        self.accepted = first["type"] == "websocket.accept"

    @property
    def cookie(self) -> str:
        """What the browser sends back."""
        return self.headers["set-cookie"].split(";")[0]


def ask(
    gate: AuthenticationMiddleware,
    path: str = "/",
    kind: str = "http",
    method: str = "GET",
    body: bytes = b"",
    **more: str,
) -> Reply:
    """One request. Header names are given with underscores."""
    headers = {"host": HOST, "accept": "text/html", **{k.replace("_", "-"): v for k, v in more.items()}}
    scope = {
        "type": kind,
        "method": method,
        "path": path,
        "query_string": b"",
        "headers": [(k.encode(), v.encode("utf-8", "surrogateescape")) for k, v in headers.items()],
    }
    messages: list[dict[str, Any]] = []

    async def receive() -> dict[str, Any]:
        return {"type": "websocket.connect"} if kind == "websocket" else {"type": "http.request", "body": body}

    async def send(message: Any) -> None:
        messages.append(dict(message))

    asyncio.run(gate(scope, receive, send))
    return Reply(messages)


def login(gate: AuthenticationMiddleware, token: str, name: str = "ada") -> Reply:
    return ask(gate, "/login", method="POST", body=f"token={token}&name={name}".encode())


@pytest.fixture
def keys() -> AccessTokens:
    """New tokens."""
    return AccessTokens()


@pytest.fixture
def gate(keys: AccessTokens) -> AuthenticationMiddleware:
    """The gate of a page that listens beyond this machine."""
    return AuthenticationMiddleware(_inside, keys, PORT)


@pytest.mark.parametrize("path", ["/", "/live/live.js", "/live/stream", "/_nicegui/3/static/nicegui.js", "/login/.."])
@pytest.mark.parametrize("accept", ["text/html", "*/*"])
def test_without_a_session_only_the_login_page_is_given(gate: AuthenticationMiddleware, path: str, accept: str) -> None:
    reply = ask(gate, path, accept=accept)
    assert reply.status == 401
    assert SECRET not in reply.body
    assert not ask(gate, path, kind="websocket").accepted


def test_the_operators_token_opens_one_session_and_no_second(
    gate: AuthenticationMiddleware, keys: AccessTokens
) -> None:
    token = keys.operator
    reply = login(gate, token)
    assert reply.status == 303
    assert ask(gate, cookie=reply.cookie).body == SECRET + b"ada"
    assert login(gate, token).status == 403
    assert login(gate, "").status == 403


def test_a_guest_token_opens_view_only_sessions_again_and_again(keys: AccessTokens) -> None:
    for _ in range(3):
        cookie = keys.open(keys.guest, "")
        assert cookie is not None
        assert keys.session(cookie) == LoginSession("guest", operator=False)


def test_the_cookie_is_kept_from_scripts_and_other_sites_and_holds_no_token(
    gate: AuthenticationMiddleware, keys: AccessTokens
) -> None:
    token = keys.operator
    cookie = login(gate, token).headers["set-cookie"]
    assert "HttpOnly" in cookie
    assert "samesite=strict" in cookie.lower()
    assert token not in cookie


@examples(30)
@given(st.text(max_size=60))
def test_no_other_token_or_cookie_opens_anything(guess: str) -> None:
    keys = AccessTokens()
    assert keys.open(guess, "eve") is None
    assert keys.session(guess) is None
    assert keys.operator


def test_a_wrong_token_is_answered_with_the_login_page(gate: AuthenticationMiddleware) -> None:
    reply = login(gate, "wrong")
    assert reply.status == 403
    assert "set-cookie" not in reply.headers
    assert b'data-mark="wrong"' in reply.body


def test_a_login_that_is_too_long_or_no_form_opens_nothing(gate: AuthenticationMiddleware, keys: AccessTokens) -> None:
    assert ask(gate, "/login", method="POST", body=b"x" * 5000 + b"&token=" + keys.operator.encode()).status == 403
    assert ask(gate, "/login", method="POST", body=b"\xff\xfe\x00").status == 403


@pytest.mark.parametrize("origin", ["http://evil.example", "null", "http://192.168.1.20:80", "http://192.168.1.20"])
def test_a_foreign_origin_is_refused_even_with_a_session(
    gate: AuthenticationMiddleware, keys: AccessTokens, origin: str
) -> None:
    cookie = login(gate, keys.operator).cookie
    assert ask(gate, cookie=cookie, origin=origin).status == 403
    assert ask(gate, "/login", method="POST", body=b"token=x", origin=origin).status == 403
    assert not ask(gate, "/live/stream", kind="websocket", cookie=cookie, origin=origin).accepted
    assert ask(gate, "/live/stream", kind="websocket", cookie=cookie, origin=f"http://{HOST}").accepted


def test_cross_site_requests_are_refused(gate: AuthenticationMiddleware, keys: AccessTokens) -> None:
    cookie = login(gate, keys.operator).cookie
    assert ask(gate, cookie=cookie, sec_fetch_site="cross-site", sec_fetch_mode="no-cors").status == 403
    assert ask(gate, cookie=cookie, sec_fetch_site="none", sec_fetch_mode="navigate").status == 200


@pytest.mark.parametrize("host", ["evil.example:8090", "127.0.0.1.evil.example", "", "[::2]:8090", "192.168.1.20"])
def test_on_this_machine_a_foreign_name_is_refused(host: str) -> None:
    local = AuthenticationMiddleware(_inside, AccessTokens("ada"), PORT)
    assert ask(local, host=host).status == 403
    assert not ask(local, kind="websocket", host=host).accepted


@pytest.mark.parametrize(
    "host", ["127.0.0.1:8090", "127.0.0.2:8090", "localhost:8090", "LOCALHOST", "[::1]:8090", "[::1]"]
)
def test_on_this_machine_too_nothing_is_given_without_a_session(host: str) -> None:
    local = AuthenticationMiddleware(_inside, AccessTokens("ada"), PORT)
    assert ask(local, host=host).status == 401
    assert SECRET not in ask(local, host=host, cookie=f"{COOKIE}-{PORT}=guessed").body
    assert not ask(local, "/live/stream", kind="websocket", host=host).accepted


def test_on_this_machine_the_token_opens_repeatedly_and_its_owner_is_recorded() -> None:
    keys = AccessTokens("ada")
    local = AuthenticationMiddleware(_inside, keys, PORT)
    for claimed in ("ada", "eve"):
        body = f"token={keys.operator}&name={claimed}".encode()
        cookie = ask(local, "/login", method="POST", body=body, host="127.0.0.1:8090").cookie
        assert ask(local, host="127.0.0.1:8090", cookie=cookie).body == SECRET + b"ada"


def test_the_pages_of_two_ports_keep_their_sessions_apart() -> None:
    names = set()
    for port in (8090, 8091):
        keys = AccessTokens("ada")
        names.add(login(AuthenticationMiddleware(_inside, keys, port), keys.operator).status)
        cookie = ask(
            AuthenticationMiddleware(_inside, keys, port),
            "/login",
            method="POST",
            body=b"token=" + keys.operator.encode(),
            host="localhost",
        ).cookie
        names.add(cookie.partition("=")[0])
    assert names == {403, f"{COOKIE}-8090", f"{COOKIE}-8091"}


def test_control_characters_and_bidirectional_marks_of_a_name_are_not_recorded() -> None:
    keys = AccessTokens()
    cookie = keys.open(keys.operator, "\x1b[2Jada\u202e eve\n ")
    assert cookie is not None
    assert keys.session(cookie) == LoginSession("[2Jada eve", operator=True)


def test_every_answer_forbids_frames_and_foreign_scripts(gate: AuthenticationMiddleware, keys: AccessTokens) -> None:
    cookie = login(gate, keys.operator).cookie
    for reply in (ask(gate), ask(gate, cookie=cookie)):
        policy = reply.headers["content-security-policy"]
        assert "frame-ancestors 'none'" in policy
        assert "default-src 'self'" in policy
        assert "http" not in policy


def test_no_token_is_logged_or_shown_by_the_keys(
    gate: AuthenticationMiddleware, keys: AccessTokens, caplog: pytest.LogCaptureFixture
) -> None:
    operator, guest = keys.operator, keys.guest
    with caplog.at_level(logging.DEBUG):
        login(gate, "wrong")
        cookie = login(gate, operator).cookie
        ask(gate, cookie=cookie)
    for secret in (operator, guest, cookie.removeprefix(f"{COOKIE}=")):
        assert secret not in caplog.text
        assert secret not in repr(keys)
