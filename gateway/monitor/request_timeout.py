"""Time limit for a complete request, which uvicorn does not have.

Without it, 64 connections that each send half a request block all other clients.
"""

from __future__ import annotations

import asyncio
import logging
from collections import Counter
from typing import Any, Final

import h11
from uvicorn.protocols.http.h11_impl import H11Protocol

log = logging.getLogger(__name__)

REQUEST_S: Final = 5.0


def timed_protocol(counts: Counter[str], request_s: float) -> type[asyncio.Protocol]:
    """Uvicorn's protocol, closing connections with an incomplete request, counted as `half_sent`.

    request_s: limit from the connection, and from the first byte of each further request.
    """

    class TimedProtocol(H11Protocol):
        timeout: asyncio.TimerHandle | None = None

        def connection_made(self, transport: Any) -> None:
            super().connection_made(transport)
            self._start()

        def data_received(self, data: bytes) -> None:
            if self.timeout is None:
                self._start()
            super().data_received(data)
            whole = self.conn.their_state not in (h11.IDLE, h11.SEND_BODY)
            if whole or self.transport.get_protocol() is not self:  # a websocket by now
                self._stop()

        def connection_lost(self, exc: Exception | None) -> None:
            self._stop()
            super().connection_lost(exc)

        def _start(self) -> None:
            self.timeout = self.loop.call_later(request_s, self._close)

        def _stop(self) -> None:
            if self.timeout is not None:
                self.timeout.cancel()
                self.timeout = None

        def _close(self) -> None:
            counts["half_sent"] += 1
            log.info("closed %s: no whole request after %g s", self.client, request_s)
            self.transport.close()

    return TimedProtocol
