"""The web server: a page, its files, a websocket of pictures, metrics. A process of its own.

It reads the bus as any other node, and has no means to send. A viewer can only call `Feed.ask`, for
seek, pause and speed of a log. Nothing here runs in the process of the gateway.
"""

from __future__ import annotations

import asyncio
import json
import logging
import socket
from collections import Counter
from collections.abc import AsyncIterator, Awaitable, Callable, Mapping, Sequence
from contextlib import asynccontextmanager, suppress
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import anyio
import uvicorn
from starlette.applications import Starlette
from starlette.requests import Request
from starlette.responses import FileResponse, Response
from starlette.routing import BaseRoute, Route, WebSocketRoute
from starlette.staticfiles import StaticFiles
from starlette.types import ASGIApp
from starlette.websockets import WebSocket, WebSocketDisconnect

from gateway.monitor.feed import Feed, Picture
from gateway.monitor.guard import Guard
from gateway.monitor.model.access import Access, Listen
from gateway.monitor.request_timeout import REQUEST_S, timed_protocol
from gateway.settings.config import ConfigError

if TYPE_CHECKING:
    from prometheus_client import CollectorRegistry

log = logging.getLogger(__name__)

STATIC: Final = Path(__file__).parent / "static"
VIEWERS: Final = 8
CONNECTIONS: Final = 64
READ_S: Final = 5.0
"""A viewer who has not read a picture after this time is dropped."""
STUCK_MS: Final = 10_000
"""The kernel closes a connection whose other end accepts no data for this time."""
SEND_BYTES: Final = 65_536
"""Send buffer of a connection in the kernel, which limits the data that a viewer has not read."""
REQUEST_BYTES: Final = 256
REQUESTS_S: Final = 50
"""Most requests of a viewer in a second; dragging a slider makes ten."""
TOO_MANY, TOO_FAST, NOT_UNDERSTOOD, TOO_SLOW = 4013, 4008, 4007, 4009
"""Close codes of the websocket; the page has a text for each."""


class Viewers:
    """The websocket: each viewer gets its next picture when it has read the last."""

    def __init__(self, feed: Feed, *, most: int = VIEWERS, read_s: float = READ_S) -> None:
        """most: viewers at a time. read_s: time after which one that does not read is dropped."""
        self._feed = feed
        self._most = most
        self._read_s = read_s

    async def serve(self, socket: WebSocket) -> None:
        """Serve one viewer until it leaves or is dropped."""
        feed = self._feed
        await socket.accept()
        if feed.viewers >= self._most:
            feed.counts["too_many_viewers"] += 1
            await self._close(socket, TOO_MANY)
            return
        codes: list[int] = []

        async def until_over(job: Callable[[WebSocket], Awaitable[int]]) -> None:
            codes.append(await job(socket))
            both.cancel_scope.cancel()

        feed.viewers += 1
        try:
            async with anyio.create_task_group() as both:
                both.start_soon(until_over, self._show)
                both.start_soon(until_over, self._hear)
        finally:
            feed.viewers -= 1
        if code := max(codes, default=0):
            await self._close(socket, code)

    async def _show(self, socket: WebSocket) -> int:
        had: Picture | None = None
        while True:
            picture = await self._feed.after(had)
            text = picture.message(had)
            try:
                with anyio.fail_after(self._read_s):
                    # This waits while the buffers of the connection are full.
                    await socket.send_text(text)
            except TimeoutError:
                self._feed.counts["slow"] += 1
                log.warning("a viewer that did not read for %g s was dropped", self._read_s)
                return TOO_SLOW
            except (WebSocketDisconnect, RuntimeError):  # the viewer has left
                return 0
            had = picture

    async def _hear(self, socket: WebSocket) -> int:
        begin, asked = anyio.current_time(), 0
        while True:
            try:
                text = await socket.receive_text()
            except (WebSocketDisconnect, RuntimeError):
                return 0
            except KeyError:  # bytes
                text = ""
            if anyio.current_time() - begin >= 1.0:
                begin, asked = anyio.current_time(), 0
            asked += 1
            if asked > REQUESTS_S:
                self._feed.counts["too_fast"] += 1
                return TOO_FAST
            if not self._feed.ask(_parsed(text)):
                self._feed.counts["bad_request"] += 1
                return NOT_UNDERSTOOD

    async def _close(self, socket: WebSocket, code: int) -> None:
        # A viewer that does not read does not receive the close frame either.
        with suppress(WebSocketDisconnect, RuntimeError), anyio.move_on_after(0.2):
            await socket.close(code)


def _parsed(text: str) -> object:
    try:
        return json.loads(text)
    except (ValueError, RecursionError):
        return None


class Files(StaticFiles):
    """The page's files; a browser checks each time whether they have changed."""

    def file_response(self, *given: Any, **named: Any) -> Response:
        """See starlette."""
        answer = super().file_response(*given, **named)
        answer.headers["cache-control"] = "no-cache"
        return answer


def make_app(
    feed: Feed,
    access: Access,
    *,
    page: bool = True,
    metrics_only: Sequence[int] = (),
    ended: Callable[[BaseException], None] | None = None,
    **limits: Any,
) -> ASGIApp:
    """The application. page: False serves only metrics, as do the ports of metrics_only.

    The feed runs as long as the application; an error that stops the feed is passed to `ended`.
    limits: those of `Viewers`. There are metrics only if prometheus-client is installed.
    """
    registry = _registry(feed)
    viewers = Viewers(feed, **limits)

    async def index(_: Request) -> Response:
        return FileResponse(STATIC / "index.html", headers={"cache-control": "no-store"})

    async def metrics(_: Request) -> Response:
        from prometheus_client.exposition import CONTENT_TYPE_LATEST, generate_latest

        assert registry is not None
        return Response(generate_latest(registry), headers={"content-type": CONTENT_TYPE_LATEST})

    @asynccontextmanager
    async def playing(_: Starlette) -> AsyncIterator[None]:
        job = asyncio.create_task(feed.play())
        job.add_done_callback(lambda done: _report_end(done, ended))
        yield
        job.cancel()
        await asyncio.gather(job, return_exceptions=True)

    routes: list[BaseRoute] = []
    if registry is not None:
        routes.append(Route("/metrics", metrics, methods=["GET"]))
    few = Starlette(routes=routes, lifespan=playing)
    if page:
        routes += [Route("/", index, methods=["GET"]), WebSocketRoute("/look", viewers.serve)]
        whole = Starlette(routes=routes, lifespan=playing)
        whole.mount("/static", Files(directory=STATIC))
    else:
        whole = few
    return Guard(_by_port(whole, dict.fromkeys(metrics_only, few)), access, feed.counts)


def _report_end(done: asyncio.Task[None], ended: Callable[[BaseException], None] | None) -> None:
    if not done.cancelled() and (error := done.exception()) is not None and ended is not None:
        ended(error)


def _by_port(whole: ASGIApp, others: Mapping[int, ASGIApp]) -> ASGIApp:
    async def chosen(scope: Any, receive: Any, send: Any) -> None:
        server = scope.get("server")
        app = others.get(server[1], whole) if server else whole
        await app(scope, receive, send)

    return chosen


def _registry(feed: Feed) -> CollectorRegistry | None:
    try:
        from prometheus_client import CollectorRegistry
    except ImportError:
        return None
    from gateway.monitor.model.metrics import FeedCollector

    registry = CollectorRegistry(auto_describe=False)
    registry.register(FeedCollector(feed))
    return registry


def bind(where: Listen) -> socket.socket:
    """A listening socket with small send buffers. Raises ConfigError if the address is taken."""
    try:
        kind, address = _resolved(where)
        made = socket.socket(kind, socket.SOCK_STREAM)
    except OSError as error:
        raise ConfigError(str(where), [f"cannot listen there: {error.strerror}"]) from None
    try:
        made.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        # Accepted connections inherit these options.
        made.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, SEND_BYTES)
        made.setsockopt(socket.SOL_SOCKET, socket.SO_KEEPALIVE, 1)
        if hasattr(socket, "TCP_USER_TIMEOUT"):
            made.setsockopt(socket.IPPROTO_TCP, socket.TCP_USER_TIMEOUT, STUCK_MS)
        made.bind(address)
        # A client may connect at once: its request waits until the server runs.
        made.listen(CONNECTIONS)
    except OSError as error:
        made.close()
        cure = "; name another port" if error.errno == 98 else ""
        raise ConfigError(str(where), [f"cannot listen there: {error.strerror}{cure}"]) from None
    return made


def _resolved(where: Listen) -> tuple[int, Any]:
    found = socket.getaddrinfo(where.host, where.port, type=socket.SOCK_STREAM)
    return found[0][0], found[0][4]


def is_loopback(where: Listen) -> bool:
    """Whether only this machine can reach the address. Raises ConfigError for unknown names."""
    import ipaddress

    try:
        _, address = _resolved(where)
    except OSError as error:
        raise ConfigError(str(where), [f"cannot be resolved: {error.strerror}"]) from None
    return ipaddress.ip_address(address[0].partition("%")[0]).is_loopback


def make_server(app: ASGIApp, counts: Counter[str], request_s: float = REQUEST_S) -> uvicorn.Server:
    """Uvicorn with the limits of this module, to be run with sockets of `bind`.

    counts: receives `half_sent`, connections without a complete request after request_s.
    """
    # Uvicorn would log requests with their URLs, tokens included.
    logging.getLogger("uvicorn.error").setLevel(logging.WARNING)
    return uvicorn.Server(
        uvicorn.Config(
            app, http=timed_protocol(counts, request_s), ws="websockets-sansio", lifespan="on",
            log_config=None, access_log=False, server_header=False, proxy_headers=False,
            limit_concurrency=CONNECTIONS, backlog=CONNECTIONS, ws_max_size=REQUEST_BYTES,
            ws_per_message_deflate=False, ws_ping_interval=5.0, ws_ping_timeout=STUCK_MS / 1e3,
            timeout_keep_alive=5, timeout_graceful_shutdown=2, h11_max_incomplete_event_size=8192,
        )
    )  # fmt: skip


def serve(
    feed: Feed,
    access: Access,
    sockets: Sequence[socket.socket],
    *,
    page: bool = True,
    metrics_only: Sequence[int] = (),
) -> None:
    """Serve until SIGINT or SIGTERM. Raises the error that stopped the feed."""
    errors: list[BaseException] = []

    def ended(error: BaseException) -> None:
        errors.append(error)
        server.should_exit = True

    app = make_app(feed, access, page=page, metrics_only=metrics_only, ended=ended)
    server = make_server(app, feed.counts)
    server.run(sockets=list(sockets))
    if errors:
        raise errors[0]
