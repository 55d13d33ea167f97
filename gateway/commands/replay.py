"""`replay LOG`: the gateway over a recorded log."""

from __future__ import annotations

import argparse
import time
from pathlib import Path
from typing import TYPE_CHECKING, Any

from gateway.commands.common import (
    GOOD,
    add_config,
    add_signature,
    console,
    out_file,
    prepare,
    track_file,
)

if TYPE_CHECKING:
    from dbc.candump import Reader
    from gateway.drivers.replay import Replayed
    from gateway.results.record import Recorder

HELP = "run the gateway over a recorded log, as fast as the machine can"


def arguments(parser: argparse.ArgumentParser) -> None:
    """Options of the verb."""
    parser.add_argument("log", type=Path, help="candump log (.log, .gz), or any python-can format")
    add_config(parser)
    add_signature(parser)
    parser.add_argument("-o", "--output", type=Path, metavar="OUT.log",
                        help="the gateway's own frames, as candump -L writes them")  # fmt: skip
    parser.add_argument("--results", type=Path, metavar="DIR",
                        help="folder for flags.csv, estimates.csv and pictures")  # fmt: skip
    parser.add_argument(
        "--detector",
        help="override [adhesion] detector (vb, median, kmeans, vmp, paper_vb, paper_vb_reuse)",
    )
    parser.add_argument("--log-channel", metavar="NAME", help="channel, if the log has several")
    parser.add_argument("--strict", action="store_true",
                        help="stop at the first line that is not candump's")  # fmt: skip


def run(options: argparse.Namespace) -> int:
    """Replay; tables and counts on stdout."""
    from dbc.candump import Writer
    from gateway.core import Gateway
    from gateway.drivers.replay import BadLogError, OneChannel, open_log, replay
    from gateway.results.record import Recorder

    changes: dict[str, Any] = (
        {"adhesion": {"detector": options.detector}} if options.detector else {}
    )
    config, codec = prepare(options.config, signature=options, **changes)
    if options.output and options.output.exists() and options.output.samefile(options.log):
        raise BadLogError(f"{options.output}: is the log itself; name another file for -o")
    log = open_log(options.log, options.strict)
    blocks = OneChannel(track_file(log, options.log, "replaying"), options.log_channel)
    recorder = Recorder(options.results, config.nodes, series=options.results is not None)
    writer = Writer(out_file(options.output)) if options.output else None

    def sink(_now: int, out: list[Any], view: Any) -> None:
        recorder.add(view)
        if writer is not None:
            for frame in out:
                writer.write(frame, blocks.name or "")

    began = time.perf_counter()
    try:
        done = replay(
            blocks,
            lambda start: Gateway(config, codec, start),
            config.loop.period_ns,
            sink,
        )
    finally:
        recorder.close()
        if writer is not None:
            writer.close()
    seconds = time.perf_counter() - began
    span = (done.last_ns - done.first_ns) / 1e9
    if options.results:
        from gateway.results.pictures import loads

        word = f"ConfigHash {done.gateway.outbox.config_hash:06x}\n"
        (options.results / "configuration.txt").write_text(word, encoding="ascii")
        for suffix in ("png", "svg"):
            loads(options.results / f"loads.{suffix}", recorder.series, options.log.name)
    _summary(log.reader, done, recorder)
    console().print(
        f"replayed {span:.2f} s of {done.channel or 'the log'} in {seconds:.2f} s "
        f"({span / max(seconds, 1e-9):.0f} times real time), {done.ticks} ticks"
    )
    return GOOD


def _summary(reader: Reader | None, done: Replayed, recorder: Recorder) -> None:
    """What the log held and what the gateway said, on stdout."""
    if reader is not None:
        lines = sorted((verdict.name.lower(), n) for verdict, n in reader.counts.items() if n)
        print("lines: " + ", ".join(f"{name} {n}" for name, n in lines))
        for number, verdict, text in reader.problems[:5]:
            console().print(f"line {number}: {verdict.name.lower()}: {text}", markup=False)
    print(f"configuration: {done.gateway.outbox.config_hash:06x}")
    counts = done.gateway.inbox.counts
    print("frames: " + ", ".join(f"{k} {v}" for k, v in sorted(counts.items()) if v))
    for t_ns, node, what, word in recorder.changes:
        seconds = (t_ns - done.first_ns) / 1e9
        print(f"{seconds:12.3f} s  drive {node}  {what:8}  {word}")
