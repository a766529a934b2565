"""Access to the page by two tokens: one operates the run, the other only reads.

The terminal prints a link for each token. The page answers a link with a cookie and the address without the token, so
that the token does not stay in the browser's address bar or history. Programs send `?token=..` or the cookie.
Without a token there is no answer on the loopback interface either: every account of the machine can connect there.
"""

from __future__ import annotations

import hmac
import ipaddress
import secrets
from dataclasses import dataclass, field

from starlette.datastructures import MutableHeaders
from starlette.requests import HTTPConnection
from starlette.responses import PlainTextResponse, RedirectResponse
from starlette.types import ASGIApp, Message, Receive, Scope, Send
from starlette.websockets import WebSocketClose

COOKIE = "softrig"
VISITOR = "softrig.visitor"
"""Key of the visitor in a request's scope."""

_POLICY = (
    "default-src 'self'; script-src 'self' 'unsafe-inline' 'unsafe-eval'; style-src 'self' 'unsafe-inline'; "
    "img-src 'self' data: blob:; font-src 'self' data:; connect-src 'self'; object-src 'none'; base-uri 'none'; "
    "form-action 'self'; frame-ancestors 'none'"
)
_HEADERS = {
    "content-security-policy": _POLICY,
    "x-content-type-options": "nosniff",
    "referrer-policy": "same-origin",
    "cross-origin-resource-policy": "same-origin",
    "cross-origin-opener-policy": "same-origin",
}


@dataclass(frozen=True)
class Visitor:
    """Who sends a request, as the record of the run names them, and whether they may send commands."""

    who: str
    operator: bool


def _token() -> str:
    return secrets.token_urlsafe(24)


@dataclass(frozen=True)
class AccessTokens:
    """The two tokens of a page that the account `owner` has started."""

    owner: str
    operate: str = field(default_factory=_token, repr=False)
    read: str = field(default_factory=_token, repr=False)

    def visitor(self, token: str, address: str) -> Visitor | None:
        """Return who sends a token from a network address; None for an invalid token.

        Only the account has seen the token, so on this machine it is its owner; another machine is named by address.
        """
        given = token.encode()
        operates = hmac.compare_digest(given, self.operate.encode())
        if not operates and not hmac.compare_digest(given, self.read.encode()):
            return None
        return Visitor(self.owner if _is_loopback(address) else address, operates)


class AuthenticationMiddleware:
    """Passes requests with a token on to the application. `port` distinguishes cookies of pages on one machine."""

    def __init__(self, app: ASGIApp, tokens: AccessTokens, port: int) -> None:
        self._app = app
        self._tokens = tokens
        self._cookie = f"{COOKIE}-{port}"

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Forward an authenticated request; refuse any other."""
        if scope["type"] == "lifespan":
            await self._app(scope, receive, send)
            return
        connection = HTTPConnection(scope)
        in_link = connection.query_params.get("token")
        token = connection.cookies.get(self._cookie, "") if in_link is None else in_link
        address = connection.client.host if connection.client else ""
        foreign = _comes_from_another_site(connection)
        visitor = None if foreign else self._tokens.visitor(token, address)
        if visitor is None and scope["type"] == "websocket":
            await WebSocketClose(1008)(scope, receive, send)
        elif visitor is None:
            reason = (
                "This request comes from another site." if foreign else "Open a link that the terminal has printed."
            )
            refusal = PlainTextResponse(reason, 403 if foreign else 401)
            refusal.headers.update({"cache-control": "no-store", "connection": "close"})
            await refusal(scope, receive, _with_headers(send))
        elif in_link is not None and scope["type"] == "http":
            answer = RedirectResponse("/", 303)
            # Not "strict": a browser would not send the cookie after a link in a mail.
            answer.set_cookie(self._cookie, token, httponly=True, samesite="lax")
            answer.headers["cache-control"] = "no-store"
            await answer(scope, receive, _with_headers(send))
        else:
            await self._app({**scope, VISITOR: visitor}, receive, _with_headers(send))


def _comes_from_another_site(connection: HTTPConnection) -> bool:
    """Return whether a browser sends the request for a page of another site, other than by following a link."""
    headers = connection.headers
    host = headers.get("host", "")
    if headers.get("origin", f"http://{host}") not in (f"http://{host}", f"https://{host}"):
        return True
    navigates = connection.scope.get("method") == "GET" and headers.get("sec-fetch-mode") == "navigate"
    return headers.get("sec-fetch-site", "none") not in ("same-origin", "none") and not navigates


def _is_loopback(address: str) -> bool:
    try:
        return ipaddress.ip_address(address).is_loopback
    except ValueError:
        return False


def _with_headers(send: Send) -> Send:
    async def sending(message: Message) -> None:
        if message["type"] == "http.response.start":
            MutableHeaders(scope=message).update(_HEADERS)
        await send(message)

    return sending
