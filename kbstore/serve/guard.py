"""Access control: checks the host that a request names, its origin, its token, and whether it may write."""

import hashlib
import hmac
import ipaddress
from collections.abc import Sequence
from http.cookies import CookieError, SimpleCookie
from urllib.parse import parse_qsl, urlencode

from starlette.datastructures import Headers, MutableHeaders
from starlette.responses import RedirectResponse, Response
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from kbstore.errors import InvalidKnowledge
from kbstore.serve.problems import problem

COOKIE = "kbstore_token"
READING = ("GET", "HEAD", "OPTIONS")
SHORTEST = 16
"""The fewest characters of a token: nothing else is between the network and the store."""

HEADERS = {
    "X-Content-Type-Options": "nosniff",
    "Referrer-Policy": "no-referrer",
    "X-Frame-Options": "DENY",
    "Cache-Control": "no-store",
}


def is_loopback(host: str) -> bool:
    """Return whether an address can be reached from this machine only."""
    if host == "localhost":
        return True
    try:
        return ipaddress.ip_address(host).is_loopback
    except ValueError:
        return False


def refuse_unsafe(host: str, token: str | None) -> None:
    """Raise `InvalidKnowledge` if other machines could ask without a token, or with one that is easily guessed."""
    if token is None and not is_loopback(host):
        raise InvalidKnowledge(
            f"{host} can be reached from other machines, and needs a token: set KBSTORE_TOKEN, or give --token; "
            "without one, serve on 127.0.0.1"
        )
    if token is not None and (len(token) < SHORTEST or not token.isascii() or not token.isprintable()):
        raise InvalidKnowledge(
            f"a token has {SHORTEST} printable ASCII characters at least; make one with: openssl rand -hex 24"
        )


class Guard:
    """ASGI middleware that refuses requests without access, and sets headers that restrict browsers.

    Without a token, the host has to be this machine: otherwise the page of another site could read the store by a name
    that it points here (DNS rebinding). Requests of other sites' pages are refused unless their origin is allowed. A
    browser gives the token once, in the address (``?token=...``), and gets a cookie for it, which can only read.
    """

    def __init__(
        self, app: ASGIApp, *, host: str, token: str | None, allow_writes: bool, allow_origins: Sequence[str]
    ) -> None:
        self._app = app
        self._hosts = None if token is not None else {"localhost", "127.0.0.1", "::1", host}
        self._token = None if token is None else token.encode()
        # the cookie is not the token, so that a stolen one cannot write
        self._cookie = None if token is None else hashlib.sha256(b"cookie " + token.encode()).hexdigest().encode()
        self._allow_writes = allow_writes
        self._origins = set(allow_origins)

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Handle one request."""
        if scope["type"] != "http":
            await self._app(scope, receive, send)
            return

        async def sending(message: Message) -> None:
            if message["type"] == "http.response.start":
                headers = MutableHeaders(scope=message)
                for name, value in HEADERS.items():
                    headers.setdefault(name, value)
            await send(message)

        refusal = self._refusal(scope)
        await (refusal or self._app)(scope, receive, sending)

    def _refusal(self, scope: Scope) -> Response | None:
        headers = Headers(scope=scope)
        host = headers.get("host", "")
        if self._hosts is not None and _without_port(host) not in self._hosts:
            return problem(421, f"this server does not answer for {host!r}; ask it as localhost")
        origin, is_reading = headers.get("origin"), scope["method"] in READING
        if origin is not None and origin not in self._origins and origin != f"{scope['scheme']}://{host}":
            return problem(403, f"pages of {origin} may not ask here; allow them with --allow-origin {origin}")
        if scope["method"] == "OPTIONS" and origin in self._origins:
            # a preflight request, which has no token yet
            return None
        if self._token is not None and not self._has_token(headers, is_reading=is_reading):
            return self._welcome(scope) or problem(
                401, "give the token: Authorization: Bearer ...", {"WWW-Authenticate": "Bearer"}
            )
        if not is_reading and not self._allow_writes:
            return problem(403, "this server only reads; start it with --allow-writes to write")
        return None

    def _has_token(self, headers: Headers, *, is_reading: bool) -> bool:
        scheme, _, given = headers.get("authorization", "").partition(" ")
        assert self._token is not None and self._cookie is not None  # noqa: PT018
        if scheme.lower() == "bearer" and hmac.compare_digest(given.strip().encode(), self._token):
            return True
        try:
            kept = SimpleCookie(headers.get("cookie", "")).get(COOKIE)
        except CookieError:
            kept = None
        return is_reading and kept is not None and hmac.compare_digest(kept.value.encode(), self._cookie)

    def _welcome(self, scope: Scope) -> Response | None:
        """Answer a browser with the token in its address: a cookie, and a redirect to the address without the token."""
        if scope["method"] != "GET":
            return None
        asked = parse_qsl(scope["query_string"].decode("latin-1"), keep_blank_values=True)
        given = "".join(value for name, value in asked if name == "token")
        assert self._token is not None and self._cookie is not None  # noqa: PT018
        if not hmac.compare_digest(given.encode(), self._token):
            return None
        rest = urlencode([(name, value) for name, value in asked if name != "token"])
        # relative and without a path, which could lead to another site
        response = RedirectResponse(f"?{rest}", 303)
        response.set_cookie(
            COOKIE, self._cookie.decode(), httponly=True, samesite="strict", secure=scope["scheme"] == "https"
        )
        return response


def _without_port(host: str) -> str:
    return host[1:].partition("]")[0] if host.startswith("[") else host.partition(":")[0]
