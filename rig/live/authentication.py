"""Authentication middleware: tokens, sessions, and protection against cross-site requests.

A request without a session gets only the login page, on the loopback interface too, because every account of the
machine can connect there. The operator token opens an operator session, the guest token a view-only one. Tokens travel
in the body of a POST and in the fragment of a link (after #), which browsers do not send; they appear in no request
line, log or process argument.

A page on the loopback interface accepts only host names of this machine (against DNS rebinding). Its operator is the
account that started it, and its operator token is reusable. The operator token of any other page opens one session;
its user states a name.
"""

from __future__ import annotations

import hmac
import ipaddress
import secrets
from contextlib import suppress
from dataclasses import dataclass, field
from importlib.resources import files
from urllib.parse import parse_qs

from starlette.datastructures import MutableHeaders
from starlette.requests import ClientDisconnect, HTTPConnection, Request
from starlette.responses import HTMLResponse, PlainTextResponse, RedirectResponse, Response
from starlette.types import ASGIApp, Message, Receive, Scope, Send
from starlette.websockets import WebSocketClose

from rig.live.admission import CONNECTION, ClientClass
from rig.realtime.control_socket import display_name

COOKIE = "softrig"
LOGIN_BYTES = 2048
MOST_SESSIONS = 64
SESSION = "softrig.session"
"""Key of the session in a request's scope."""

_POLICY = (
    "default-src 'self'; script-src 'self' 'unsafe-inline' 'unsafe-eval'; style-src 'self' 'unsafe-inline'; "
    "img-src 'self' data: blob:; font-src 'self' data:; connect-src 'self'; object-src 'none'; base-uri 'none'; "
    "form-action 'self'; frame-ancestors 'none'"
)
_HEADERS = {
    "content-security-policy": _POLICY,
    "x-content-type-options": "nosniff",
    "referrer-policy": "same-origin",  # with no-referrer, browsers post with a null origin
    "cross-origin-resource-policy": "same-origin",
    "cross-origin-opener-policy": "same-origin",
}


@dataclass(frozen=True)
class LoginSession:
    """Name of the user, and whether the session may send commands."""

    who: str
    operator: bool


@dataclass
class AccessTokens:
    """The tokens of one page and the sessions that they have opened.

    `owner` is the account that started a page on the loopback interface; None for a page beyond this machine.
    """

    owner: str | None = None

    operator: str = field(default_factory=lambda: secrets.token_urlsafe(24), repr=False)
    guest: str = field(default_factory=lambda: secrets.token_urlsafe(24), repr=False)
    _sessions: dict[str, LoginSession] = field(default_factory=dict, repr=False)

    def open(self, token: str, who: str) -> str | None:
        """Open a session and return its cookie; None for an invalid token."""
        given = token.strip().encode()
        is_operator = hmac.compare_digest(given, self.operator.encode()) and bool(self.operator)
        is_guest = hmac.compare_digest(given, self.guest.encode())
        if not (is_operator or is_guest):
            return None
        if is_operator and self.owner is None:
            self.operator = ""
        cookie = secrets.token_urlsafe(32)
        if len(self._sessions) >= MOST_SESSIONS:
            guest = next((key for key, session in self._sessions.items() if not session.operator), None)
            self._sessions.pop(guest or next(iter(self._sessions)))
        name = self.owner if is_operator and self.owner else display_name(who)
        self._sessions[cookie] = LoginSession(name or ("operator" if is_operator else "guest"), is_operator)
        return cookie

    def session(self, cookie: str) -> LoginSession | None:
        """Return the session of a cookie; None for an unknown one."""
        return self._sessions.get(cookie)


class AuthenticationMiddleware:
    """Authenticates every request to the application. `port` distinguishes cookies of pages on one machine."""

    def __init__(self, app: ASGIApp, tokens: AccessTokens, port: int) -> None:
        self._app = app
        self._tokens = tokens
        self._cookie = f"{COOKIE}-{port}"

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Forward an authenticated request; answer any other."""
        if scope["type"] == "lifespan":
            await self._app(scope, receive, send)
            return
        connection = HTTPConnection(scope)
        refusal = self._foreign(connection)
        session = self._tokens.session(connection.cookies.get(self._cookie, ""))
        if session is not None and refusal is None:
            if connection := scope.get("state", {}).get(CONNECTION):
                connection.raise_to(ClientClass.OPERATOR if session.operator else ClientClass.GUEST)
            await self._app({**scope, SESSION: session}, receive, _with_headers(send))
        elif scope["type"] == "websocket":
            await WebSocketClose(1008)(scope, receive, send)
        else:
            answer = await self._answer(Request(scope, receive), refusal)
            # Connections without a session close after each answer.
            answer.headers.update({"cache-control": "no-store", "connection": "close"})
            await answer(scope, receive, _with_headers(send))

    def _foreign(self, connection: HTTPConnection) -> str | None:
        """Return the reason why a request is cross-site; None where it is not."""
        headers = connection.headers
        host = headers.get("host", "")
        if self._tokens.owner is not None and not _is_local(host):
            return "this page answers to the names of its own machine only"
        origin = headers.get("origin")
        if origin is not None and origin not in (f"http://{host}", f"https://{host}"):
            return "this request comes from another site"
        site = headers.get("sec-fetch-site", "none")
        navigates = connection.scope.get("method") == "GET" and headers.get("sec-fetch-mode") == "navigate"
        if site not in ("same-origin", "none") and not navigates:
            return "this request comes from another site"
        return None

    async def _answer(self, request: Request, refusal: str | None) -> Response:
        """Return the answer to a request without a session, or with a reason to refuse it."""
        if refusal is not None:
            return PlainTextResponse(refusal, 403)
        path = request.scope["path"]  # not that of `request.url`, which holds the Host header
        if path == "/login":
            return await self._login(request) if request.method == "POST" else self._form(200)
        if path == "/login.js" and request.method == "GET":
            return Response(_static("login.js"), media_type="text/javascript")
        if request.method == "GET" and "text/html" in request.headers.get("accept", ""):
            return self._form(401)
        return PlainTextResponse("log in first", 401)

    async def _login(self, request: Request) -> Response:
        form = parse_qs((await _body(request)).decode("utf-8", "replace"))
        cookie = self._tokens.open(form.get("token", [""])[0], form.get("name", [""])[0])
        if cookie is None:
            return self._form(403, "wrong")
        answer = RedirectResponse("/", 303)
        answer.set_cookie(self._cookie, cookie, httponly=True, samesite="strict")
        return answer

    def _form(self, status: int, mark: str = "") -> Response:
        """Return the login page. On the loopback interface it asks for no name, because the account is known."""
        named = "" if self._tokens.owner is None else "hidden"
        return HTMLResponse(_static("login.html").replace("{{mark}}", mark).replace("{{named}}", named), status)


def _is_local(host: str) -> bool:
    """Return whether a Host header is localhost or a loopback address; other names may be rebound by DNS."""
    name = host.lower() if host.endswith("]") else host.lower().rpartition(":")[0] or host.lower()
    try:
        return name == "localhost" or ipaddress.ip_address(name.removeprefix("[").removesuffix("]")).is_loopback
    except ValueError:
        return False


async def _body(request: Request) -> bytes:
    data = b""
    # The admission control limits the waiting time.
    with suppress(ClientDisconnect):
        async for part in request.stream():
            data += part
            if len(data) > LOGIN_BYTES:
                return b""
    return data


def _static(name: str) -> str:
    return files("rig.live").joinpath("static", name).read_text(encoding="utf-8")


def _with_headers(send: Send) -> Send:
    async def sending(message: Message) -> None:
        if message["type"] == "http.response.start":
            MutableHeaders(scope=message).update(_HEADERS)
        await send(message)

    return sending
