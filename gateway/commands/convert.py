"""`convert IN OUT`: convert a log into another format, or into decoded signals."""

from __future__ import annotations

import argparse
import time
from collections.abc import Iterable
from pathlib import Path
from typing import TYPE_CHECKING, Any

from dbc.text import printable
from gateway.commands.common import (
    BAD_INPUT,
    add_config,
    add_line,
    faults,
    pattern_of,
    report_dbc,
    report_log,
    shown,
    verdict_of_input,
)
from gateway.commands.progress import track_file
from gateway.io.console import console
from gateway.io.prepare import prepare

if TYPE_CHECKING:
    from dbc.codec import Codec
    from gateway.io.log_file import Log
    from gateway.logfiles.convert import Done
    from gateway.logfiles.signals import Decoder

_EPILOG = """\
OUT by its ending. Frames: .log and .log.gz (candump -L), .asc, .blf, .trc (python-can).
Decoded signals by the DBC: .parquet and .csv (.csv.gz), a row per frame and a column per
signal; .mf4, a channel group per message; .mcap, a topic per message, and all frames. With
--frames these four hold frames alone: .csv as python-can's, .mf4 as bus logging. What each
keeps is in docs/files.md.
"""


OUTSIDE_SHOWN = 20
"""Most signals out of range that are listed."""


def arguments(parser: argparse.ArgumentParser) -> None:
    """Options of the verb."""
    parser.epilog = _EPILOG
    parser.add_argument("log", type=Path, metavar="IN",
                        help="candump log (.log, .gz), any python-can format, or .parquet of "
                        "frames")  # fmt: skip
    parser.add_argument("output", type=Path, metavar="OUT", help="the file to write, see below")
    add_config(parser)
    parser.add_argument("--dbc", type=Path, metavar="FILE.dbc",
                        help="decode by this DBC, not by the configuration's")  # fmt: skip
    parser.add_argument("--frames", action="store_true",
                        help="frames, not signals, into .parquet, .mf4, .mcap, .csv")  # fmt: skip
    add_line(parser)
    parser.add_argument("--log-channel", metavar="NAME", help="this channel only (default: all)")
    parser.add_argument("--strict", action="store_true",
                        help="stop at the first fault in IN, and leave no file")  # fmt: skip


def run(options: argparse.Namespace) -> int:
    """Convert; print counts. Exit 2 also if a binary log was cut, or ended in a fault.

    Exit 1 if more than 1 % is dropped: faulty lines, and frames left out for their time stamps.
    """
    from gateway.io.log_file import BadLogError
    from gateway.logfiles import convert
    from gateway.logfiles.signals import Decoder

    kind = convert.out_ending(options.output, options.frames)
    line = pattern_of(options.log, options.line)
    log = convert.open_input(options.log, options.strict, line)
    decoder: Decoder | None = None
    if kind in convert.SIGNALS and not options.frames:
        decoder = Decoder(_codec(options))

    def blocks(log: Log, what: str) -> Iterable[Any]:
        return convert.of_channel(track_file(log, options.log, what), options.log_channel)

    def make(path: Path) -> Any:
        if decoder is None:
            return convert.frame_sink(path, kind)
        first = convert.open_input(options.log, False, line)
        return convert.signal_sink(path, kind, decoder, blocks(first, "looking"))

    began = time.perf_counter()
    try:
        done = convert.convert(
            blocks(log, "converting"), options.output, make, strict=options.strict
        )
    except convert.NothingWrittenError as error:
        left = [f"{k} {n}" for k, n in error.sink.left_out.items() if n]
        advice = ""
        if decoder is not None:
            left += [f"{k.name.lower()} {n}" for k, n in decoder.counts.items()]
            other = "" if options.dbc is not None else "name the DBC with --dbc, or "
            advice = f" by {decoder.codec.path.name}; {other}use --frames for frames"
        raise BadLogError(f"{options.log}: {error}{advice} ({', '.join(left)})") from None
    _summary(log, done, decoder)
    seconds = time.perf_counter() - began
    console().print(f"{shown(options.output)}: {done.read} frames in {seconds:.2f} s", markup=False)
    if done.cut:
        console().print(
            f"traction-gateway: {printable(done.cut)}; {shown(options.output)} ends there",
            markup=False, soft_wrap=True,
        )  # fmt: skip
        return BAD_INPUT
    if log.reader.truncated and log.reader.unit != "lines":
        return BAD_INPUT
    late = done.time_faults
    return verdict_of_input(faults(log.reader) | late, done.read - sum(late.values()))


def _codec(options: argparse.Namespace) -> Codec:
    """Codec of the DBC that was named, unchanged; otherwise that of the configuration."""
    from dbc.codec import bind_usable

    if options.dbc is not None:
        codec = bind_usable(options.dbc)
        report_dbc(codec)
        return codec
    return prepare(options.config)[1]


def _summary(log: Log, done: Done, decoder: Decoder | None) -> None:
    """Print what was read, written and left out."""
    report_log(log.reader)
    print(f"frames: read {done.read}, written {done.sink.written}")
    left = dict(done.sink.left_out)
    reduced = done.sink.reduced
    if decoder is not None and "signals" not in reduced:
        left |= {match.name.lower(): n for match, n in decoder.counts.items() if match}
    if done.steps:
        print(
            f"time: the log's clock was set back {done.steps} times; all later times are moved "
            "forward by the same amount"
        )
    if any(left.values()):
        words = (f"{cause} {n}" for cause, n in sorted(left.items()) if n)
        print("not written: " + ", ".join(words))
    if any(reduced.values()):
        words = (f"{what} {n}" for what, n in sorted(reduced.items()) if n)
        print("written without: " + ", ".join(words))
    if decoder is not None:
        words = (f"{how.name.lower()} {n}" for how, n in sorted(decoder.cells.items()))
        print("values: " + ", ".join(words))
        if decoder.outside:
            named = decoder.outside.most_common(OUTSIDE_SHOWN)
            more = len(decoder.outside) - len(named)
            rest = f" and {more} signals more" if more else ""
            print("out of range, kept and marked: "
                  + ", ".join(f"{name} {n}" for name, n in named) + rest)  # fmt: skip
        if decoder.longer:
            print(f"frames longer than their message: {decoder.longer}")
