"""`monitor --web`, `monitor --metrics`: listening address and access."""

from __future__ import annotations

import argparse
import socket
import sys
from collections.abc import Callable, Mapping
from contextlib import ExitStack, suppress
from pathlib import Path
from typing import TYPE_CHECKING

from gateway.commands.common import GOOD
from gateway.settings.config import ConfigError

if TYPE_CHECKING:
    from gateway.monitor.model.access import Listen
    from gateway.monitor.sources import Source

WEB, METRICS = "127.0.0.1:8090", "127.0.0.1:8091"


def arguments(parser: argparse.ArgumentParser) -> None:
    """Options of page and metrics."""
    parser.add_argument(
        "--web", nargs="?", const=WEB, metavar="HOST:PORT",
        help=f"a page instead of the terminal (default: {WEB}); metrics are there at /metrics",
    )  # fmt: skip
    parser.add_argument(
        "--metrics", nargs="?", const=METRICS, metavar="HOST:PORT",
        help=f"metrics for Prometheus, beside the page or alone (default: {METRICS})",
    )  # fmt: skip
    parser.add_argument(
        "--token-file", metavar="FILE",
        help="viewers log in with this token; required for addresses that others can reach",
    )  # fmt: skip


def run(options: argparse.Namespace, source: Callable[[argparse.Namespace], Source]) -> int:
    """Serve until the user stops it. The addresses are checked before anything is opened.

    source: opens the bus or log that the options name. Raises ConfigError.
    """
    from gateway.monitor.feed import Feed
    from gateway.monitor.model.access import Access
    from gateway.monitor.web import bind, serve

    asked = {"web": _where(options.web, WEB), "metrics": _where(options.metrics, METRICS)}
    wanted = {what: where for what, where in asked.items() if where is not None}
    token = _token(options.token_file, wanted)
    sockets = {where: bind(where) for where in dict.fromkeys(wanted.values())}
    with ExitStack() as stack:
        for made in sockets.values():
            stack.enter_context(made)
        opened = source(options)
        stack.callback(opened.close)
        # Port 0 lets the system choose.
        ports = {where: made.getsockname()[1] for where, made in sockets.items()}
        names = [socket.gethostname(), *(where.host for where in wanted.values())]
        page = "web" in wanted
        alone = [ports[w] for what, w in wanted.items() if what == "metrics" and page]
        if page and len(ports) == 1:
            alone = []
        # Once an address is announced, a signal is the normal end. The server shuts down in good
        # order, and then raises the signal once more.
        with suppress(KeyboardInterrupt):
            for what, where in wanted.items():
                shown = where._replace(port=ports[where])
                path = "metrics" if what == "metrics" else ""
                print(f"{what}: http://{shown}/{path}", file=sys.stderr, flush=True)
            serve(
                Feed(opened, waits=page), Access(token, names if token else ()),
                list(sockets.values()), page=page, metrics_only=alone,
            )  # fmt: skip
    return GOOD


def _where(text: str | None, default: str) -> Listen | None:
    from gateway.monitor.model.access import Listen, listen

    if text is None:
        return None
    if Path(text).is_file():
        cure = f"put the log before the option: 'monitor {text} --web'"
        raise ConfigError(text, [f"is a file, not an address; {cure}"])
    host, _, port = default.rpartition(":")
    try:
        return listen(text, Listen(host, int(port)))
    except ValueError as error:
        raise ConfigError("monitor", [str(error)]) from None


def _token(name: str | None, wanted: Mapping[str, Listen]) -> bytes | None:
    """Read the token, if a file is named. Raises ConfigError if an address needs one."""
    from gateway.io.credentials import private_file
    from gateway.monitor.model.access import token_of
    from gateway.monitor.web import is_loopback

    open_to_others = {str(where) for where in wanted.values() if not is_loopback(where)}
    if name is not None:
        path, content = private_file(name, Path())
        return token_of(content, str(path))
    if open_to_others:
        cure = (
            "others can reach this address; viewers then need a token: "
            "'traction-gateway keygen --token -o FILE', then --token-file FILE"
        )
        raise ConfigError(", ".join(sorted(open_to_others)), [cure])
    return None
