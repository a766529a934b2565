"""Who may enter the page: tokens, sessions, and no request that another site has made the browser send.

On this machine alone everybody is the operator, and only the names of this machine are answered to (a foreign name
that points here is somebody else's site). Beyond it nothing but the login page is given to one without a session:
a one-time token opens the operator's, a guest token a view-only one. Tokens travel in the body of a POST and, in a
link, behind the #, which browsers keep to themselves; they are in no URL and in no log.
"""

from __future__ import annotations

import asyncio
import hmac
import ipaddress
import secrets
from dataclasses import dataclass, field
from http.cookies import CookieError, SimpleCookie
from importlib.resources import files
from urllib.parse import parse_qs

from starlette.types import ASGIApp, Message, Receive, Scope, Send

COOKIE = "softrig"
LOGIN_BYTES = 2048
LOGIN_S = 5.0
WRONG_TOKEN_S = 0.5
WAITING_LOGINS = 16
MOST_SESSIONS = 64
SESSION = "softrig.session"
"""Where the session is found in a request's scope."""

_POLICY = (
    "default-src 'self'; script-src 'self' 'unsafe-inline' 'unsafe-eval'; style-src 'self' 'unsafe-inline'; "
    "img-src 'self' data: blob:; font-src 'self' data:; connect-src 'self'; object-src 'none'; base-uri 'none'; "
    "form-action 'self'; frame-ancestors 'none'"
)
_HEADERS = [
    (b"content-security-policy", _POLICY.encode()),
    (b"x-content-type-options", b"nosniff"),
    (b"referrer-policy", b"same-origin"),  # with none at all, browsers post with an origin of null
    (b"cross-origin-resource-policy", b"same-origin"),
    (b"cross-origin-opener-policy", b"same-origin"),
]


@dataclass(frozen=True)
class Session:
    """Who looks, and whether he may act."""

    who: str
    operator: bool


@dataclass
class AccessTokens:
    """The tokens of one page and the sessions that they have opened."""

    operator: str = field(default_factory=lambda: secrets.token_urlsafe(24), repr=False)
    guest: str = field(default_factory=lambda: secrets.token_urlsafe(24), repr=False)
    _sessions: dict[str, Session] = field(default_factory=dict, repr=False)

    def open(self, token: str, who: str) -> str | None:
        """The cookie of a new session; None for a token that opens nothing. The operator's token opens once."""
        given = token.strip().encode()
        is_operator = hmac.compare_digest(given, self.operator.encode()) and bool(self.operator)
        is_guest = hmac.compare_digest(given, self.guest.encode())
        if not (is_operator or is_guest):
            return None
        if is_operator:
            self.operator = ""
        cookie = secrets.token_urlsafe(32)
        if len(self._sessions) >= MOST_SESSIONS:
            guest = next((key for key, session in self._sessions.items() if not session.operator), None)
            self._sessions.pop(guest or next(iter(self._sessions)))
        name = " ".join(who.split())[:40]
        self._sessions[cookie] = Session(name or ("operator" if is_operator else "guest"), is_operator)
        return cookie

    def session(self, cookie: str) -> Session | None:
        """The session that a cookie stands for."""
        return self._sessions.get(cookie)


class AuthenticationMiddleware:
    """Stands before the whole application. `local` is the session of everybody on this machine, None with tokens."""

    def __init__(self, app: ASGIApp, keys: AccessTokens, local: Session | None) -> None:
        self._app = app
        self._keys = keys
        self._local = local
        self._logins = asyncio.Semaphore(WAITING_LOGINS)

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Let a request pass, or answer it here."""
        if scope["type"] == "lifespan":
            await self._app(scope, receive, send)
            return
        headers = {name.decode("latin-1"): value.decode("latin-1") for name, value in scope["headers"]}
        if refusal := self._foreign(scope, headers):
            await _refuse(scope, receive, send, 403, refusal)
        elif (session := self._session(headers)) is not None:
            await self._app({**scope, SESSION: session}, receive, _with_headers(send))
        elif scope["type"] == "http" and scope["path"] == "/login" and self._local is None:
            await self._login(scope, receive, send)
        elif scope["type"] == "http" and scope["method"] == "GET" and scope["path"] == "/login.js":
            await _page(send, 200, "text/javascript", "login.js")
        elif scope["type"] == "http" and scope["method"] == "GET" and "text/html" in headers.get("accept", ""):
            await _page(send, 401, "text/html; charset=utf-8", "login.html")
        else:
            await _refuse(scope, receive, send, 401, "log in first")

    def _foreign(self, scope: Scope, headers: dict[str, str]) -> str | None:
        """Why a request does not come from this page."""
        host = headers.get("host", "")
        if self._local is not None and not _is_local(host):
            return "this page answers to the names of its own machine only"
        origin = headers.get("origin")
        if origin is not None and origin not in (f"http://{host}", f"https://{host}"):
            return "this request comes from another site"
        site = headers.get("sec-fetch-site", "none")
        arriving = scope["type"] == "http" and scope["method"] == "GET" and headers.get("sec-fetch-mode") == "navigate"
        if site not in ("same-origin", "none") and not arriving:
            return "this request comes from another site"
        return None

    def _session(self, headers: dict[str, str]) -> Session | None:
        if self._local is not None:
            return self._local
        try:
            morsel = SimpleCookie(headers.get("cookie", "")).get(COOKIE)
        except CookieError:
            return None
        return self._keys.session(morsel.value) if morsel is not None else None

    async def _login(self, scope: Scope, receive: Receive, send: Send) -> None:
        if scope["method"] != "POST":
            await _page(send, 200, "text/html; charset=utf-8", "login.html")
            return
        if self._logins.locked():
            await _refuse(scope, receive, send, 429, "too many logins at a time")
            return
        async with self._logins:
            form = parse_qs((await _body(receive)).decode("utf-8", "replace"))
            cookie = self._keys.open(form.get("token", [""])[0], form.get("name", [""])[0])
            if cookie is None:
                await asyncio.sleep(WRONG_TOKEN_S)
                await _page(send, 403, "text/html; charset=utf-8", "login.html", b"wrong")
                return
        where = [
            (b"location", b"/"),
            (b"set-cookie", f"{COOKIE}={cookie}; Path=/; HttpOnly; SameSite=Strict".encode()),
        ]
        await _answer(send, 303, where, b"")


def _is_local(host: str) -> bool:
    """Whether a Host header names this machine: an address cannot be made to point elsewhere, a name can."""
    name = host.lower() if host.endswith("]") else host.lower().rpartition(":")[0] or host.lower()
    try:
        return name == "localhost" or ipaddress.ip_address(name.removeprefix("[").removesuffix("]")).is_loopback
    except ValueError:
        return False


async def _body(receive: Receive) -> bytes:
    data = b""
    try:
        async with asyncio.timeout(LOGIN_S):
            while len(data) <= LOGIN_BYTES:
                message = await receive()
                data += bytes(message.get("body", b""))
                if not message.get("more_body", False):
                    break
    except TimeoutError:
        return b""
    return data if len(data) <= LOGIN_BYTES else b""


async def _refuse(scope: Scope, receive: Receive, send: Send, status: int, reason: str) -> None:
    if scope["type"] == "websocket":
        await receive()
        await send({"type": "websocket.close", "code": 1008})
    else:
        await _answer(send, status, [(b"content-type", b"text/plain; charset=utf-8")], reason.encode())


async def _page(send: Send, status: int, kind: str, name: str, mark: bytes = b"") -> None:
    body = files("rig.live").joinpath("static", name).read_bytes().replace(b"{{mark}}", mark)
    await _answer(send, status, [(b"content-type", kind.encode())], body)


async def _answer(send: Send, status: int, headers: list[tuple[bytes, bytes]], body: bytes) -> None:
    length = (b"content-length", str(len(body)).encode())
    fixed = [*_HEADERS, (b"cache-control", b"no-store"), length]
    await send({"type": "http.response.start", "status": status, "headers": [*headers, *fixed]})
    await send({"type": "http.response.body", "body": body})


def _with_headers(send: Send) -> Send:
    async def sending(message: Message) -> None:
        if message["type"] == "http.response.start":
            message = {**message, "headers": [*message.get("headers", []), *_HEADERS]}
        await send(message)

    return sending
