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
from dataclasses import dataclass, field
from http.cookies import CookieError, SimpleCookie
from importlib.resources import files
from urllib.parse import parse_qs

from starlette.types import ASGIApp, Message, Receive, Scope, Send

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
_HEADERS = [
    (b"content-security-policy", _POLICY.encode()),
    (b"x-content-type-options", b"nosniff"),
    (b"referrer-policy", b"same-origin"),  # with no-referrer, browsers post with a null origin
    (b"cross-origin-resource-policy", b"same-origin"),
    (b"cross-origin-opener-policy", b"same-origin"),
]


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
        headers = {name.decode("latin-1"): value.decode("latin-1") for name, value in scope["headers"]}
        if refusal := self._foreign(scope, headers):
            await _refuse(scope, receive, send, 403, refusal)
        elif (session := self._session(headers)) is not None:
            if connection := scope.get("state", {}).get(CONNECTION):
                connection.raise_to(ClientClass.OPERATOR if session.operator else ClientClass.GUEST)
            await self._app({**scope, SESSION: session}, receive, _with_headers(send))
        elif scope["type"] == "http" and scope["path"] == "/login":
            await self._login(scope, receive, send)
        elif scope["type"] == "http" and scope["method"] == "GET" and scope["path"] == "/login.js":
            await _page(send, 200, "text/javascript", "login.js")
        elif scope["type"] == "http" and scope["method"] == "GET" and "text/html" in headers.get("accept", ""):
            await self._form(send, 401)
        else:
            await _refuse(scope, receive, send, 401, "log in first")

    def _foreign(self, scope: Scope, headers: dict[str, str]) -> str | None:
        """Return the reason why a request is cross-site; None where it is not."""
        host = headers.get("host", "")
        if self._tokens.owner is not None and not _is_local(host):
            return "this page answers to the names of its own machine only"
        origin = headers.get("origin")
        if origin is not None and origin not in (f"http://{host}", f"https://{host}"):
            return "this request comes from another site"
        site = headers.get("sec-fetch-site", "none")
        arriving = scope["type"] == "http" and scope["method"] == "GET" and headers.get("sec-fetch-mode") == "navigate"
        if site not in ("same-origin", "none") and not arriving:
            return "this request comes from another site"
        return None

    def _session(self, headers: dict[str, str]) -> LoginSession | None:
        try:
            morsel = SimpleCookie(headers.get("cookie", "")).get(self._cookie)
        except CookieError:
            return None
        return self._tokens.session(morsel.value) if morsel is not None else None

    async def _login(self, scope: Scope, receive: Receive, send: Send) -> None:
        if scope["method"] != "POST":
            await self._form(send, 200)
            return
        form = parse_qs((await _body(receive)).decode("utf-8", "replace"))
        cookie = self._tokens.open(form.get("token", [""])[0], form.get("name", [""])[0])
        if cookie is None:
            await self._form(send, 403, b"wrong")
            return
        where = [
            (b"location", b"/"),
            (b"set-cookie", f"{self._cookie}={cookie}; Path=/; HttpOnly; SameSite=Strict".encode()),
        ]
        await _answer(send, 303, where, b"")

    async def _form(self, send: Send, status: int, mark: bytes = b"") -> None:
        """Send the login page. On the loopback interface it asks for no name, because the account is known."""
        named = b"" if self._tokens.owner is None else b"hidden"
        await _page(send, status, "text/html; charset=utf-8", "login.html", mark=mark, named=named)


def _is_local(host: str) -> bool:
    """Return whether a Host header is localhost or a loopback address; other names may be rebound by DNS."""
    name = host.lower() if host.endswith("]") else host.lower().rpartition(":")[0] or host.lower()
    try:
        return name == "localhost" or ipaddress.ip_address(name.removeprefix("[").removesuffix("]")).is_loopback
    except ValueError:
        return False


async def _body(receive: Receive) -> bytes:
    data = b""
    # The admission control limits the waiting time.
    while len(data) <= LOGIN_BYTES:
        message = await receive()
        data += bytes(message.get("body", b""))
        if not message.get("more_body", False):
            return data if len(data) <= LOGIN_BYTES else b""
    return b""


async def _refuse(scope: Scope, receive: Receive, send: Send, status: int, reason: str) -> None:
    if scope["type"] == "websocket":
        await receive()
        await send({"type": "websocket.close", "code": 1008})
    else:
        await _answer(send, status, [(b"content-type", b"text/plain; charset=utf-8")], reason.encode())


async def _page(send: Send, status: int, kind: str, name: str, **marks: bytes) -> None:
    body = files("rig.live").joinpath("static", name).read_bytes()
    for mark, value in marks.items():
        body = body.replace(b"{{%s}}" % mark.encode(), value)
    await _answer(send, status, [(b"content-type", kind.encode())], body)


async def _answer(send: Send, status: int, headers: list[tuple[bytes, bytes]], body: bytes) -> None:
    length = (b"content-length", str(len(body)).encode())
    # Connections without a session close after each answer.
    fixed = [*_HEADERS, (b"cache-control", b"no-store"), (b"connection", b"close"), length]
    await send({"type": "http.response.start", "status": status, "headers": [*headers, *fixed]})
    await send({"type": "http.response.body", "body": body})


def _with_headers(send: Send) -> Send:
    async def sending(message: Message) -> None:
        if message["type"] == "http.response.start":
            message = {**message, "headers": [*message.get("headers", []), *_HEADERS]}
        await send(message)

    return sending
