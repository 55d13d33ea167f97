"""What several verbs share: options, progress, exit codes."""

from __future__ import annotations

import argparse
import math
import sys
from collections.abc import Iterable, Iterator, Mapping, Sequence
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING, Final

from dbc.text import printable
from gateway.io.console import console, note

if TYPE_CHECKING:
    from dbc.candump.reader import Reader
    from dbc.frames import Block
    from gateway.io.replay import Log

GOOD, FAILED, BAD_INPUT = 0, 1, 2
"""Exit codes of the contract."""
PATIENCE_S: Final = 3.0


def positive_seconds(text: str) -> float:
    """A duration on the command line. Raises ArgumentTypeError unless finite and positive."""
    try:
        seconds = float(text)
    except ValueError:
        seconds = math.nan
    if not 0.0 < seconds < 1e7:
        raise argparse.ArgumentTypeError(f"{text!r} is not a duration in seconds")
    return seconds


def add_config(parser: argparse.ArgumentParser) -> None:
    """`--config`."""
    parser.add_argument(
        "--config", type=Path, metavar="TRAIN.toml",
        help="configuration; without it: three drives on nodes 1-3 with the bench motor",
    )  # fmt: skip


def add_signature(parser: argparse.ArgumentParser, *, required: bool = False) -> None:
    """`--public-key`, `--signature`."""
    parser.add_argument(
        "--public-key", type=Path, metavar="PUBLIC.pem", required=required,
        help="take no configuration that this ed25519 key has not signed",
    )  # fmt: skip
    parser.add_argument(
        "--signature", type=Path, metavar="FILE.sig",
        help="default: beside the configuration, its name and .sig",
    )  # fmt: skip


def add_bus(parser: argparse.ArgumentParser) -> None:
    """python-can's own bus options: -i, -c, -b, --fd, --data-bitrate, --bus-kwargs .."""
    from gateway.io import quick_start as leanstart

    leanstart.python_can()
    import can.cli

    can.cli.add_bus_arguments(parser)


def need(modules: Sequence[str], extra: str) -> None:
    """Raises ConfigError that says what to install where any of them is not there."""
    from gateway.settings.config import ConfigError

    missing = [name for name in modules if find_spec(name) is None]
    if missing:
        raise ConfigError(
            f"needs {', '.join(missing)}", [f"pip install 'traction-gateway[{extra}]'"]
        )  # fmt: skip


def faults(reader: Reader | None) -> dict[str, int]:
    """Lines of a log that are none, by cause; of other formats nobody knows."""
    counts = {} if reader is None else reader.counts
    return {verdict.name.lower(): n for verdict, n in counts.items() if verdict.is_fault}


def verdict_of_input(dropped: Mapping[str, int], used: int) -> int:
    """The exit code for what was left out of a log; says on stderr if that is too much.

    dropped: cause -> lines or frames; used: those that were not.
    """
    from gateway.reports.dropped import warning

    text = warning(dropped, used)
    if text:
        note(f"warning: {text}")
    return FAILED if text else GOOD


def track_file(log: Log, path: Path, what: str) -> Iterable[Block]:
    """Its blocks, with a progress bar of how much of the file is read, if a person is watching."""
    return _bar(log, path, what) if sys.stderr.isatty() else log.blocks


def _bar(log: Log, path: Path, what: str) -> Iterator[Block]:
    from rich.progress import Progress

    with Progress(console=console(), transient=True) as progress:
        task = progress.add_task(what, total=path.stat().st_size if log.reader else None)
        for block in log.blocks:
            progress.update(task, completed=log.reader.bytes_read if log.reader else 0)
            yield block


def shown(path: Path) -> str:
    """A path for the terminal, control characters in it escaped."""
    return printable(str(path))
