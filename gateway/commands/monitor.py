"""`monitor [LOG]`: a live view of a bus or a log; read-only.

`run` has a few lines for each kind of view: `need` its extra, `open_source`, then draw.
"""

from __future__ import annotations

import argparse
import logging
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

from gateway.commands import monitor_web
from gateway.commands.common import GOOD, add_bus, add_config, positive_seconds
from gateway.io.extras import need
from gateway.io.prepare import prepare
from gateway.settings.config import ConfigError

if TYPE_CHECKING:
    from gateway.monitor.sources import Source


def arguments(parser: argparse.ArgumentParser) -> None:
    """Options of the verb."""
    parser.add_argument("log", type=Path, nargs="?", metavar="LOG",
                        help="a log instead of a bus: any format that `replay` reads")  # fmt: skip
    add_config(parser)
    parser.add_argument("--log-channel", metavar="NAME", help="channel, if the log has several")
    parser.add_argument("--at", type=_seconds, default=0.0, metavar="S",
                        help="start time in the log")  # fmt: skip
    parser.add_argument("--speed", type=positive_seconds, default=1.0, metavar="X",
                        help="speed of a log, as a multiple of real time")  # fmt: skip
    parser.add_argument(
        "--shadow", action="store_true",
        help="if no gateway is on the bus, show the flags it would send, marked as such",
    )  # fmt: skip
    monitor_web.arguments(parser)
    add_bus(parser)


def _seconds(text: str) -> float:
    return 0.0 if text.strip() in ("0", "0.0") else positive_seconds(text)


def run(options: argparse.Namespace) -> int:
    """Show the view until the user leaves."""
    if options.web is not None:
        need(("starlette", "uvicorn", "websockets"), "web")
    if options.metrics is not None:
        need(("prometheus_client", "starlette", "uvicorn", "websockets"), "metrics")
    if options.web is not None or options.metrics is not None:
        return monitor_web.run(options, open_source)
    if options.token_file is not None:
        raise ConfigError("--token-file", ["has no effect without --web or --metrics"])
    need(("textual", "textual_plotext"), "monitor")
    if not sys.stdout.isatty():
        raise ConfigError("monitor", ["the view needs a terminal as output; or use --web"])
    source = open_source(options)
    from gateway.monitor.terminal import MonitorApp

    app = MonitorApp(source)
    with quiet():
        app.run()
    if app.problem is not None:
        raise app.problem
    return GOOD


def open_source(options: argparse.Namespace) -> Source:
    """Open the bus or log that the options name; every kind of view begins with this.

    Raises ConfigError, DbcMismatch, BadLogError or LogError if it cannot be used.
    """
    from gateway.io.bus import bus_options as named
    from gateway.monitor.model.observer import Observer

    if options.log is not None and named(options):
        raise ConfigError("monitor", ["a log and a bus were named; leave one of them out"])
    if options.log is None and (options.at or options.speed != 1 or options.log_channel):
        raise ConfigError("monitor", ["--at, --speed and --log-channel are for a log; name one"])
    config, codec = prepare(options.config)

    def make() -> Observer:
        return Observer(codec, config, show_shadow=options.shadow)

    if options.log is not None:
        from gateway.monitor.log_source import LogSource

        source = LogSource(options.log, make, options.log_channel)
        source.speed = options.speed
        source.seek(options.at, 0.0)
        return source
    return _live(options, config, codec, make())


def _live(options: argparse.Namespace, config: Any, codec: Any, observer: Any) -> Source:
    from gateway.commands.run import bus_options, options_name
    from gateway.io.bus import open_transport
    from gateway.io.permission import Mode, allowed
    from gateway.monitor.sources import LiveSource, silently

    chosen = silently(bus_options(options, config))
    transport = open_transport(chosen, allowed(Mode.LISTEN, config, codec))
    return LiveSource(transport, observer, options_name(options))


@contextmanager
def quiet() -> Iterator[None]:
    """Suppress logging, which would spoil the view; the view shows the state of the bus itself."""
    before = logging.root.manager.disable
    logging.disable(logging.CRITICAL)
    try:
        yield
    finally:
        logging.disable(before)
