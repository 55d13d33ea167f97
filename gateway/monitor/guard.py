"""Checks before every request: methods, host names, the token; and headers of each response.

Starlette parses requests, but its own middleware is not sufficient. `TrustedHostMiddleware` has no
rule for numeric addresses, `AuthenticationMiddleware` no limit for wrong tokens; neither checks
Origin or counts rejected requests.
"""

from __future__ import annotations

import logging
import time
from collections import Counter
from typing import Final

from starlette.requests import HTTPConnection
from starlette.responses import PlainTextResponse, RedirectResponse
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from gateway.monitor.model.access import Access, Refusal

log = logging.getLogger(__name__)

POLICY: Final = (
    "default-src 'none'; script-src 'self'; style-src 'self'; img-src 'self'; "
    "connect-src 'self'; base-uri 'none'; form-action 'none'; frame-ancestors 'none'"
)
HEADERS: Final = (
    ("content-security-policy", POLICY),
    ("x-content-type-options", "nosniff"),
    ("x-frame-options", "DENY"),
    ("referrer-policy", "no-referrer"),
    ("cross-origin-opener-policy", "same-origin"),
    ("cross-origin-resource-policy", "same-origin"),
    ("cache-control", "no-store"),
)
_RAW: Final = tuple((name.encode(), value.encode()) for name, value in HEADERS)


class Guard:
    """ASGI middleware: passes on requests that `Access` allows, and counts the others by cause."""

    def __init__(self, app: ASGIApp, access: Access, counts: Counter[str]) -> None:
        """counts: of rejected requests."""
        self._app = app
        self._access = access
        self._counts = counts

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """See ASGI."""
        if scope["type"] not in ("http", "websocket"):
            await self._app(scope, receive, send)
            return
        refusal, given = self._judge(scope)

        async def send_response(message: Message) -> None:
            if message["type"] in ("http.response.start", "websocket.http.response.start"):
                names = {name for name, _ in message.get("headers", ())}
                extra = [(name, value) for name, value in _RAW if name not in names]
                message = {**message, "headers": [*message.get("headers", ()), *extra]}
            await send(message)

        if refusal is not None:
            self._counts[refusal.cause] += 1
            log.info("refused %s: %s", _address(scope), refusal.cause)
            await _refuse(refusal, scope, receive, send_response)
        elif given is not None:
            # Redirect, so that the token is neither shown in the address bar nor in its history.
            answer = RedirectResponse("/", status_code=303)
            answer.set_cookie(
                cookie_name(scope), self._access.session, httponly=True, samesite="strict", path="/"
            )
            await answer(scope, receive, send_response)
        else:
            await self._app(scope, receive, send_response)

    def _judge(self, scope: Scope) -> tuple[Refusal | None, str | None]:
        """(reason to reject the request or None, token in its URL or None)."""
        if scope["type"] == "http" and scope["method"] != "GET":
            return Refusal(405, "method", "only GET", (("allow", "GET"),)), None
        asked = HTTPConnection(scope)
        for name in ("host", "origin"):
            if len(asked.headers.getlist(name)) > 1:
                return Refusal(400, "host", f"more than one {name}"), None
        if (refusal := self._access.page(asked.headers)) is not None:
            return refusal, None
        given = None
        if scope["type"] == "http" and scope["path"] == "/" and self._access.wants_token:
            given = asked.query_params.get("token") or None
        session = asked.cookies.get(cookie_name(scope), "")
        refusal = self._access.person(
            asked.headers, given, session, _address(scope), time.monotonic()
        )
        return refusal, given


def cookie_name(scope: Scope) -> str:
    """Name of the cookie of this port: a browser sends a cookie to all ports of a host."""
    server = scope.get("server") or ("", 0)
    return f"traction_gateway_{server[1]}"


def _address(scope: Scope) -> str:
    client = scope.get("client")
    return str(client[0]) if client else "?"


async def _refuse(refusal: Refusal, scope: Scope, receive: Receive, send: Send) -> None:
    headers = {**dict(refusal.headers), "connection": "close"}
    if scope["type"] == "websocket":
        await receive()  # websocket.connect
        if "websocket.http.response" not in (scope.get("extensions") or {}):
            await send({"type": "websocket.close", "code": 1008})
            return
    await PlainTextResponse(refusal.text + "\n", refusal.status, headers)(scope, receive, send)
