"""Refuse requests that do not come from the studio's own page.

A web page that the user visits can send requests to 127.0.0.1. It cannot choose their ``Host``,
``Origin`` and ``Sec-Fetch-Site``, which the browser writes. A name whose address an attacker
changes to 127.0.0.1 (DNS rebinding) is still in ``Host``.
"""

import ipaddress
import secrets
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any
from urllib.parse import urlsplit

from starlette.datastructures import MutableHeaders
from starlette.requests import Request
from starlette.responses import PlainTextResponse, RedirectResponse
from starlette.types import ASGIApp, Receive, Scope, Send

#: Name of the token in the address, and prefix of its cookie's name, which has the port too,
#: because browsers share cookies between ports.
TOKEN, COOKIE = "token", "clmorph-studio-"
#: What no page but the studio's own may do with an answer.
HEADERS = {
    "Content-Security-Policy": (
        "default-src 'none'; script-src 'self'; style-src 'self'; img-src 'self' data: blob:; "
        "connect-src 'self'; frame-src 'self'; base-uri 'none'; form-action 'none'; "
        "frame-ancestors 'none'"
    ),
    "Cache-Control": "no-store",
    "Cross-Origin-Opener-Policy": "same-origin",
    "Cross-Origin-Resource-Policy": "same-origin",
    "Referrer-Policy": "no-referrer",
    "X-Content-Type-Options": "nosniff",
}
#: The policy of a viewer's page, which stands in a frame of the studio; it has one of its own too.
FRAMED = "frame-ancestors 'self'"


@dataclass(frozen=True)
class Access:
    """Who may send requests."""

    #: The address or name at which the studio listens.
    host: str
    port: int
    #: The secret that a browser has to bring; empty if none is needed.
    token: str = ""

    def refusal(self, headers: Mapping[str, str], path: str, cookie: str = "") -> str:
        """Return why a request is refused, or ""; header names are in lower case."""
        host = headers.get("host", "")
        if not self._is_ours(host):
            return "this host name is not the studio's"
        origin = headers.get("origin")
        if origin is not None and origin != f"http://{host}":
            return "this origin is not the studio's page"
        opened = path == "/" and headers.get("sec-fetch-mode", "navigate") == "navigate"
        if not opened and headers.get("sec-fetch-site", "none") not in ("none", "same-origin"):
            return "another site's page must not ask the studio"
        if self.token and not secrets.compare_digest(cookie.encode(), self.token.encode()):
            return "the token is missing: open the address that clmorph studio has printed"
        return ""

    def _is_ours(self, host: str) -> bool:
        try:
            parts = urlsplit(f"//{host}")
            name, port = parts.hostname or "", parts.port or 80
        except ValueError:
            return False
        if port != self.port or parts.netloc != host or "@" in host:
            return False
        if name in ("localhost", self.host.lower()):
            return True
        try:
            address = ipaddress.ip_address(name)
        except ValueError:
            return False  # a name that somebody else may lead to this machine
        return address.is_loopback or bool(self.token)


class Guard:
    """Middleware that asks `Access`, and adds `HEADERS` to each answer."""

    def __init__(self, app: ASGIApp, access: Access) -> None:
        self._app, self._access = app, access

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Answer a request, or refuse it."""
        if scope["type"] == "lifespan":
            await self._app(scope, receive, send)
            return
        if scope["type"] != "http":
            return
        request, name = Request(scope), f"{COOKIE}{self._access.port}"
        headers = request.headers
        given = request.query_params.get(TOKEN, "") if scope["path"] == "/" else ""
        cookie = given or request.cookies.get(name, "")
        why = self._access.refusal(headers, scope["path"], cookie)
        answer = self._app
        if len(headers.getlist("host")) != 1 or why:
            answer = PlainTextResponse((why or "expected one host") + "\n", 403)
        elif self._access.token and given:
            redirect = RedirectResponse("/", 303)
            redirect.set_cookie(name, given, httponly=True, samesite="strict")
            answer = redirect
        await answer(scope, receive, _with_headers(send))


def _with_headers(send: Send) -> Callable[[Any], Any]:
    async def sending(message: Any) -> None:
        if message["type"] == "http.response.start":
            headers = MutableHeaders(scope=message)
            for name, value in HEADERS.items():
                headers.setdefault(name, value)
        await send(message)

    return sending
