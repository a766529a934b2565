"""Access to the page: nothing without a token, no request of another site, no token shown."""

from __future__ import annotations

import asyncio
import logging
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from rig.live.authentication import COOKIE, VISITOR, AccessTokens, AuthenticationMiddleware, Visitor
from tests.support.budget import examples

HOST = "192.168.1.20:8090"
PORT = 8090
SECRET = b"the page and its data"
HERE, ELSEWHERE = "127.0.0.1", "192.168.1.7"


async def _inside(scope: Any, receive: Any, send: Any) -> None:
    """An application that answers each request that the middleware passes on."""
    if scope["type"] == "websocket":
        await receive()
        await send({"type": "websocket.accept"})
        return
    await send({"type": "http.response.start", "status": 200, "headers": []})
    await send({"type": "http.response.body", "body": SECRET + scope[VISITOR].who.encode()})


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
    token: str | None = None,
    client: str = HERE,
    **more: str,
) -> Reply:
    """One request, with a token in its address if one is given. Header names are given with underscores."""
    headers = {"host": HOST, "accept": "text/html", **{k.replace("_", "-"): v for k, v in more.items()}}
    scope = {
        "type": kind,
        "method": "GET",
        "path": path,
        "query_string": b"" if token is None else b"token=" + token.encode(),
        "client": (client, 5000),
        "headers": [(k.encode(), v.encode("utf-8", "surrogateescape")) for k, v in headers.items()],
    }
    messages: list[dict[str, Any]] = []

    async def receive() -> dict[str, Any]:
        return {"type": "websocket.connect"} if kind == "websocket" else {"type": "http.request", "body": b""}

    async def send(message: Any) -> None:
        messages.append(dict(message))

    asyncio.run(gate(scope, receive, send))
    return Reply(messages)


@pytest.fixture
def tokens() -> AccessTokens:
    """New tokens of a page of ada."""
    return AccessTokens("ada")


@pytest.fixture
def gate(tokens: AccessTokens) -> AuthenticationMiddleware:
    """The gate of a page."""
    return AuthenticationMiddleware(_inside, tokens, PORT)


@pytest.mark.parametrize("path", ["/", "/live/live.js", "/live/stream", "/_nicegui/3/static/nicegui.js", "/live/.."])
@pytest.mark.parametrize("token", [None, "", "wrong"])
def test_without_a_valid_token_nothing_is_given(gate: AuthenticationMiddleware, path: str, token: str | None) -> None:
    reply = ask(gate, path, token=token)
    assert reply.status == 401
    assert SECRET not in reply.body
    assert not ask(gate, path, kind="websocket", token=token).accepted
    assert SECRET not in ask(gate, path, cookie=f"{COOKIE}-{PORT}={token}").body


def test_a_link_opens_the_page_again_and_again_and_leaves_no_token_in_the_address(
    gate: AuthenticationMiddleware, tokens: AccessTokens
) -> None:
    for token in (tokens.operate, tokens.read) * 2:
        reply = ask(gate, token=token)
        assert reply.status == 303
        assert reply.headers["location"] == "/"
        assert reply.headers["cache-control"] == "no-store"
        assert ask(gate, cookie=reply.cookie).body == SECRET + b"ada"


def test_a_link_to_another_path_redirects_to_no_other_host(
    gate: AuthenticationMiddleware, tokens: AccessTokens
) -> None:
    assert ask(gate, "//evil.example", token=tokens.read).headers["location"] == "/"


def test_a_program_may_send_the_token_with_its_stream(gate: AuthenticationMiddleware, tokens: AccessTokens) -> None:
    assert ask(gate, "/live/stream", kind="websocket", token=tokens.read).accepted


def test_one_token_operates_and_the_other_only_reads(tokens: AccessTokens) -> None:
    assert tokens.visitor(tokens.operate, HERE) == Visitor("ada", operator=True)
    assert tokens.visitor(tokens.read, HERE) == Visitor("ada", operator=False)


def test_who_acts_from_another_machine_is_recorded_by_its_address(tokens: AccessTokens) -> None:
    assert tokens.visitor(tokens.operate, ELSEWHERE) == Visitor(ELSEWHERE, operator=True)
    assert tokens.visitor(tokens.operate, "::1") == Visitor("ada", operator=True)


def test_the_cookie_is_kept_from_scripts_and_other_sites(gate: AuthenticationMiddleware, tokens: AccessTokens) -> None:
    cookie = ask(gate, token=tokens.operate).headers["set-cookie"]
    assert "HttpOnly" in cookie
    assert "samesite=lax" in cookie.lower()


@examples(30)
@given(st.text(max_size=60))
def test_no_other_token_opens_anything(guess: str) -> None:
    assert AccessTokens("ada").visitor(guess, HERE) is None


@pytest.mark.parametrize("origin", ["http://evil.example", "null", "http://192.168.1.20:80", "http://192.168.1.20"])
def test_a_foreign_origin_is_refused_even_with_a_token(
    gate: AuthenticationMiddleware, tokens: AccessTokens, origin: str
) -> None:
    cookie = ask(gate, token=tokens.operate).cookie
    assert ask(gate, cookie=cookie, origin=origin).status == 403
    assert not ask(gate, "/live/stream", kind="websocket", cookie=cookie, origin=origin).accepted
    assert ask(gate, "/live/stream", kind="websocket", cookie=cookie, origin=f"http://{HOST}").accepted


def test_cross_site_requests_are_refused_but_a_link_may_be_followed(
    gate: AuthenticationMiddleware, tokens: AccessTokens
) -> None:
    cookie = ask(gate, token=tokens.operate).cookie
    assert ask(gate, cookie=cookie, sec_fetch_site="cross-site", sec_fetch_mode="no-cors").status == 403
    assert ask(gate, cookie=cookie, sec_fetch_site="cross-site", sec_fetch_mode="navigate").status == 200


def test_the_pages_of_two_ports_keep_their_cookies_apart(tokens: AccessTokens) -> None:
    cookies = [ask(AuthenticationMiddleware(_inside, tokens, n), token=tokens.read).cookie for n in (8090, 8091)]
    assert [cookie.partition("=")[0] for cookie in cookies] == [f"{COOKIE}-8090", f"{COOKIE}-8091"]


def test_every_answer_forbids_frames_and_foreign_scripts(gate: AuthenticationMiddleware, tokens: AccessTokens) -> None:
    link = ask(gate, token=tokens.operate)
    for reply in (ask(gate), link, ask(gate, cookie=link.cookie)):
        policy = reply.headers["content-security-policy"]
        assert "frame-ancestors 'none'" in policy
        assert "default-src 'self'" in policy
        assert "http" not in policy


def test_no_token_is_logged_or_shown(
    gate: AuthenticationMiddleware, tokens: AccessTokens, caplog: pytest.LogCaptureFixture
) -> None:
    with caplog.at_level(logging.DEBUG):
        ask(gate, token="wrong")
        ask(gate, cookie=ask(gate, token=tokens.operate).cookie)
    for secret in (tokens.operate, tokens.read):
        assert secret not in caplog.text
        assert secret not in repr(tokens)
