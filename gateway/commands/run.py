"""`run`: the gateway on a bus."""

from __future__ import annotations

import argparse
import logging
import os
import sys
from contextlib import nullcontext
from pathlib import Path
from typing import TYPE_CHECKING, Any

from dbc.frame import SECOND
from gateway.commands.common import GOOD, add_bus, add_config, add_signature, positive_seconds
from gateway.io import quick_start
from gateway.io.console import console
from gateway.io.prepare import prepare

if TYPE_CHECKING:
    from dbc.codec import Codec
    from gateway.core.gateway import Gateway
    from gateway.io.live import LiveSnapshot
    from gateway.io.realtime import Ticker
    from gateway.io.transport import Transport
    from gateway.settings.config import Config

log = logging.getLogger(__name__)

DISPLAY_EVERY = 20
"""Ticks between two updates of the live table: the display must never disturb the loop."""
REHEARSED = 100
"""Ticks of a throw-away gateway before the loop starts."""


def arguments(parser: argparse.ArgumentParser) -> None:
    """Options of the verb."""
    add_config(parser)
    add_signature(parser)
    parser.add_argument("--listen-only", action="store_true",
                        help="send nothing: only listen to the bus")  # fmt: skip
    parser.add_argument(
        "--duration", type=positive_seconds, metavar="S", help="stop after this long"
    )
    parser.add_argument("--results", type=Path, metavar="DIR",
                        help="folder for the timing report (lateness, latency)")  # fmt: skip
    parser.add_argument("--quiet", action="store_true", help="no live table")
    parser.add_argument(
        "--realtime", type=int, metavar="PRIORITY",
        help="SCHED_FIFO with this priority (1 to 99) and locked memory; needs permission",
    )  # fmt: skip
    add_bus(parser)


def _start(options: argparse.Namespace) -> tuple[Config, Transport, Ticker, Gateway]:
    """Load the files and make all objects. Raises ConfigError or DbcMismatch with all problems."""
    from gateway.core.gateway import Gateway
    from gateway.io.bus import open_transport
    from gateway.io.credentials import flag_authenticator
    from gateway.io.permission import Mode, allowed
    from gateway.io.realtime import Ticker
    from gateway.io.scheduling import be_realtime, described, use_given

    config, codec = prepare(options.config, signature=options)
    mode = Mode.LISTEN if options.listen_only else Mode.RUN
    # A gateway that only listens needs no key and uses up no value of the trip counter.
    authenticator = None if mode is Mode.LISTEN else flag_authenticator(config)
    if options.results:
        # If the report cannot be written, this is reported now, not after the run.
        options.results.mkdir(parents=True, exist_ok=True)
    if options.realtime is not None:
        be_realtime(options.realtime)
    else:
        use_given()
    log.info("user %d, %s", os.geteuid(), described())
    transport = open_transport(bus_options(options, config), allowed(mode, config, codec))
    ticker = Ticker(config.loop.period_ns)
    _rehearse(config, codec)
    gateway = Gateway(config, codec, ticker.clock(), authenticator)
    log.info("configuration %06x", gateway.outbox.config_hash)
    return config, transport, ticker, gateway


def _rehearse(config: Config, codec: Codec) -> None:
    """Touch the memory pages that a tick uses before the clock starts: they then stay locked."""
    from gateway.core.gateway import Gateway

    gateway = Gateway(config.unmapped(), codec, 0)
    for tick in range(REHEARSED):
        gateway.step([], tick * config.loop.period_ns)


def run(options: argparse.Namespace) -> int:
    """Run until SIGINT, SIGTERM or the duration; then send unknown flags three times and stop."""
    with quick_start.uncollected():
        try:
            config, transport, ticker, gateway = _start(options)
        except KeyboardInterrupt:
            log.warning("stopped before the bus was used")
            raise
        from gateway.io.canopen_node import CanopenNode
        from gateway.io.live import Stop, run_live
        from gateway.io.outputs import Outputs
        from gateway.io.service import Manager, Overseer

    node = CanopenNode(config.nodes, nmt_master=config.canopen.nmt_master)
    outputs = Outputs(
        gateway.outbox.specs.values(), lambda: gateway.silent, listening=options.listen_only
    )
    overseer = Overseer(
        outputs, Manager.from_environment(), options_name(options), round(options.began_s * SECOND)
    )
    stop = Stop()
    limit = None if options.duration is None else round(options.duration * config.loop.rate_hz)
    display = None if options.quiet or not sys.stderr.isatty() else _display()

    def watch(seen: LiveSnapshot) -> None:
        overseer.completed(seen)
        if limit is not None and seen.tick >= limit:
            stop()
        if display is not None and seen.tick % DISPLAY_EVERY == 0 and gateway.view is not None:
            from gateway.reports.live_table import render

            display.update(render(gateway.view, f"traction-gateway on {options_name(options)}"))

    with display or nullcontext():
        seen = run_live(gateway, transport, node, ticker, stop=stop,
                        errors=lambda: active_errors(gateway), on_tick=watch,
                        on_end=overseer.stopping)  # fmt: skip
    summary(gateway, seen)
    if options.results:
        from gateway.reports.timing import leave, timed

        title = f"Timing on {options_name(options)}, configuration {gateway.outbox.config_hash:06x}"
        leave(options.results, timed(seen, config.loop.period_ns), title)
        print(f"report: {options.results / 'report.html'}")
    return GOOD


def bus_options(options: argparse.Namespace, config: Any) -> dict[str, Any]:
    """Bus options: command line before `[bus]` before python-can's own configuration."""
    given = config.bus.options
    if given.get("interface") is None:
        given = {k: v for k, v in given.items() if k == "channel"}
    elif given["interface"] in ("socketcan", "virtual"):
        # SocketCAN's bit rates are set by `ip link`, and compared with those configured here. A
        # virtual bus has none.
        configured = config.bus.model_fields_set if given["interface"] == "socketcan" else ()
        given = {k: v for k, v in given.items() if k in ("interface", "channel", "fd", *configured)}
    return {**given, **vars(options)}


def options_name(options: argparse.Namespace) -> str:
    """Name of the bus for a person."""
    parts = (getattr(options, "interface", None), getattr(options, "channel", None))
    return " ".join(p for p in parts if p) or "the configured bus"


def active_errors(gateway: Any) -> tuple[int, ...]:
    """Errors that the gateway's own emergency messages should report."""
    from gateway.core.codes import Flag
    from gateway.io.canopen_node import GatewayError

    view = gateway.view
    if view is None:
        return ()
    intruder = (GatewayError.INTRUDER,) if gateway.integrity.intruder else ()
    pairs = (
        (view.overrun, GatewayError.OVERRUN),
        (view.comm, GatewayError.COMMUNICATION),
        (view.sensor, GatewayError.SENSOR),
        (view.estimator, GatewayError.ESTIMATOR),
    )
    return (*intruder, *(error for flag, error in pairs if flag is Flag.BAD))


def _display() -> Any:
    from rich.live import Live

    return Live(console=console(), auto_refresh=True, refresh_per_second=5, transient=False)


def summary(gateway: Any, seen: Any) -> None:
    """Print the counters at the end, and the promised rate of false alarms."""
    from gateway.settings.calibration import promise_lines

    for line in promise_lines(gateway.calibration, gateway.config.adhesion):
        print(f"promise: {line}")
    counts = gateway.inbox.counts
    print("frames: " + (", ".join(f"{k} {v}" for k, v in sorted(counts.items()) if v) or "none"))
    status = seen.status
    print(
        f"sent {status.sent}, refused {status.tx_refused}, queue full {status.tx_full}, "
        f"link down {status.tx_down}; kernel drops {status.kernel_drops}; "
        f"reopened {status.reopened}; too late to be sent {status.tx_late}"
    )
    print(
        f"ticks missed {seen.missed}; lateness {_quantiles(seen.timing.lateness)}; "
        f"frame to flag {_quantiles(seen.timing.latency)}"
    )


def _quantiles(times: Any) -> str:
    """Of a histogram, ms; one without a value is not one of zeros."""
    if not times.total:
        return "not measured: no sample came"
    return f"p50 {times.quantile(0.5) / 1e6:.3f} ms, p99 {times.quantile(0.99) / 1e6:.3f} ms"
