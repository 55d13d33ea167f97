"""`replay LOG`: run the gateway over a recorded log."""

from __future__ import annotations

import argparse
import time
from contextlib import ExitStack
from pathlib import Path
from typing import TYPE_CHECKING, Any

from dbc.text import printable
from gateway.commands.common import (
    FAILED,
    GOOD,
    add_config,
    add_line,
    add_signature,
    faults,
    pattern_of,
    report_log,
    verdict_of_input,
)
from gateway.commands.progress import Progress, stepped, track_file
from gateway.io import extras, quick_start
from gateway.io.console import console, note
from gateway.io.prepare import prepare
from gateway.reports import known
from gateway.settings.config import ConfigError

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from dbc.candump.reader import LogReader
    from dbc.codec import Codec
    from dbc.frames import Block
    from gateway.io.replay import Replayed
    from gateway.reports.record import Change
    from gateway.reports.reporting import Reporting
    from gateway.settings.config import Config

REPORT_STEPS = 3
"""Progress steps of a report beside the picture of each drive: checksum, flags, page."""
SHOWN = 5
"""Most steps of the log's clock that are printed."""


def arguments(parser: argparse.ArgumentParser) -> None:
    """Options of the verb."""
    parser.add_argument("log", type=Path, help="candump log (.log, .gz), or any python-can format")
    add_config(parser)
    add_signature(parser)
    parser.add_argument("-o", "--output", type=Path, metavar="OUT.log",
                        help="frames that the gateway sends, as candump -L writes")  # fmt: skip
    parser.add_argument(
        "--results", type=Path, metavar="DIR",
        help="folder for report.html, flags.csv, estimates.csv and pictures",
    )  # fmt: skip
    parser.add_argument(
        "--mcap", action="store_true",
        help="replay.mcap and foxglove.json among the --results, for Foxglove and PlotJuggler",
    )  # fmt: skip
    parser.add_argument(
        "--truth", type=Path, metavar="CSV",
        help="ground truth as `sim --truth` writes it, for the report",
    )  # fmt: skip
    parser.add_argument(
        "--detector",
        help="override [adhesion] detector (switching, vb, median, kmeans, vmp, paper_vb, "
        "paper_vb_reuse)",
    )
    parser.add_argument(
        "--expect-known", type=known.wanted, action="append", default=[],
        metavar="[FLAG=]PERCENT",
        help="exit 1 if a drive's FLAG (adhesion, the default, or thermal) was known for less "
        "than PERCENT of the time",
    )  # fmt: skip
    add_line(parser)
    parser.add_argument("--log-channel", metavar="NAME", help="channel, if the log has several")
    parser.add_argument("--strict", action="store_true",
                        help="stop at the first line that cannot be read")  # fmt: skip


def run(options: argparse.Namespace) -> int:
    """Replay; print tables and counts. Exit 1 if more than 1 % of the log was dropped."""
    with ExitStack() as results:
        return _replay(options, results)


def _replay(options: argparse.Namespace, results: ExitStack) -> int:
    with quick_start.unsearched():
        from dbc.candump.reader import Reader
        from dbc.candump.writer import Writer
        from dbc.prefetch import ahead
        from gateway.core.gateway import Gateway
        from gateway.io.log_file import OneChannel, open_log
        from gateway.io.replay import Briefly, replay
        from gateway.io.whole_file import whole
        from gateway.reports.record import Changes

        changes: dict[str, Any] = (
            {"adhesion": {"detector": options.detector}} if options.detector else {}
        )
        config, codec = prepare(options.config, signature=options, **changes)
    log = open_log(options.log, options.strict, pattern_of(options.log, options.line))
    if isinstance(log.reader, Reader):  # much of it is compiled, so it runs beside the core
        log = log._replace(blocks=ahead(iter(log.blocks)))
    blocks = OneChannel(track_file(log, options.log, "replaying"), options.log_channel)
    left = _reporting(options, config, codec, results)
    noted = Changes()
    writer: Writer | None = None

    def new_gateway(start: int) -> Gateway:
        gateway = Gateway(config, codec, start)
        if left is not None:
            left.begin(gateway)
        return gateway

    def write(out: Block) -> None:
        if writer is not None:
            writer.write_block(out, blocks.name or "")

    sink = Briefly(write, noted.follow, left)
    began = time.perf_counter()
    with ExitStack() as stack:
        if left is not None:
            if options.mcap:
                sink = sink._replace(read=_messages(stack, left, config, codec))
            stack.enter_context(left)
        if options.output:
            writer = stack.enter_context(Writer(stack.enter_context(whole(options.output))))
        done = replay(blocks, new_gateway, config.loop.period_ns, sink)
    seconds = time.perf_counter() - began
    span = (done.last_ns - done.first_ns) / 1e9
    flags = noted.changes
    _summary(log.reader, done, flags)
    note(
        f"replayed {span:.2f} s of {printable(done.channel) or 'the log'} in {seconds:.2f} s "
        f"({span / max(seconds, 1e-9):.0f} times real time), {done.ticks} ticks", wrap=True,
    )  # fmt: skip
    if left is not None:
        report = _report(options, left, done, log.reader)
        results.close()
        print(f"report: {options.results / report.name}")
    code = verdict_of_input(
        {"time_back": done.dropped, **faults(log.reader)}, done.frames - done.dropped
    )
    from gateway.reports import cures

    check = cures.check_of(options.config, options.log, options.line)
    known_code = _verdict_of_flags(done, flags, dict(options.expect_known), check)
    return code or known_code


def _verdict_of_flags(
    done: Replayed, changes: Sequence[Change], wanted: dict[str, float], check: str
) -> int:
    """Exit code for the time in which flags were known; print it, and on stderr what is short."""
    from gateway.core.codes import Reason
    from gateway.reports import cures
    from gateway.reports.record import camel

    gateway = done.gateway
    shares = known.shares(changes, gateway.nodes, done.first_ns, done.last_ns)
    print(f"known: {known.text(shares)}")
    assert gateway.view is not None
    for flag, nodes in known.silent(shares).items():
        views = zip(gateway.nodes, gateway.view.drives, strict=True)
        reasons = sorted(
            {Reason(getattr(v, f"{flag}_reason")) for node, v in views if node in nodes}
        )
        words = ", ".join(camel(reason.name) for reason in reasons)
        how, cure = cures.cure(flag, reasons, gateway.config, nodes, check)
        whose = known.drives(nodes, len(gateway.nodes))
        note(f"{how}: {flag}{whose} was never known ({words}), so nothing was flagged; {cure}")
    short = known.short_of(shares, wanted)
    for line in short:
        note(line)
    return FAILED if short else GOOD


def _reporting(
    options: argparse.Namespace, config: Config, codec: Codec, results: ExitStack
) -> Reporting | None:
    """Recorder of the run for a report, if one is wanted. Raises ConfigError.

    results: holds the folder of the report until it is complete.
    """
    if options.results is None:
        for option in ("truth", "mcap"):
            if getattr(options, option):
                raise ConfigError(f"--{option}", ["is for the report; add --results DIR"])
        return None
    if options.mcap:
        extras.need(("mcap",), "mcap", "--mcap")
    from gateway.io.whole_file import whole_folder
    from gateway.reports.reporting import Reporting
    from gateway.reports.ticks import MOST_OF_LOG
    from gateway.reports.truth import check

    if options.truth is not None:
        check(options.truth)
    folder = results.enter_context(whole_folder(options.results))
    return Reporting(folder, config, codec, MOST_OF_LOG)


def _messages(
    stack: ExitStack, left: Reporting, config: Config, codec: Codec
) -> Callable[[Block], None]:
    """Function that writes received frames into an MCAP; the ticks of `left` go there too."""
    from gateway.io.whole_file import whole, write_text
    from gateway.logfiles.convert import comments_of
    from gateway.logfiles.mcap import McapFile
    from gateway.logfiles.signals import Decoder
    from gateway.reports.topics import Topics, layout

    path = stack.enter_context(whole(left.folder / "replay.mcap"))
    file = stack.enter_context(McapFile(path, Decoder(codec), comments_of(codec)))
    left.uses.append(Topics(config.nodes, file).add_ticks)
    write_text(left.folder / "foxglove.json", layout(config.nodes))
    return file.add_frames


def _report(
    options: argparse.Namespace, left: Reporting, done: Replayed, reader: LogReader
) -> Path:
    """Write the report and return its path."""
    from gateway.reports.page import literal
    from gateway.reports.reporting import leave, replay_facts
    from gateway.reports.truth import read

    with Progress("report", len(done.gateway.nodes) + REPORT_STEPS) as progress:
        step = stepped(progress)
        step("checksum of the log")
        facts = replay_facts(options.log, done, left.trace)
        notes = []
        lines = sorted((verdict.name.lower(), n) for verdict, n in reader.counts.items() if n)
        facts.append((f"{reader.unit} of the log", ", ".join(f"{name} {n:,}" for name, n in lines)))
        if options.truth is not None:
            left.truth, same = read(options.truth, done.first_ns / 1e9, done.last_ns / 1e9)
            facts.append(("truth", literal(options.truth.name)))
            if not same:
                notes.append("The truth has another clock than the log: its 0 is set to the "
                             "log's first frame.")  # fmt: skip
        run = left.run(options.log.name, facts, notes=notes, step=step)
        step("page")
        return leave(left.folder, f"Replay of {options.log.name}", [run], single=True)


def _summary(reader: LogReader, done: Replayed, changes: Sequence[Change]) -> None:
    """Print what the log contained and how the flags changed."""
    from gateway.settings.calibration import promise_lines

    report_log(reader)
    print(f"configuration: {done.gateway.outbox.config_hash:06x}")
    for line in promise_lines(done.gateway.calibration, done.gateway.config.adhesion):
        print(f"promise: {line}")
    for back in done.clock.backs[:SHOWN]:
        console().print(
            f"the log's clock was set back by {(back.before_ns - back.after_ns) / 1e9:.3f} s, "
            f"from {back.before_ns / 1e9:.3f} to {back.after_ns / 1e9:.3f}", markup=False,
        )  # fmt: skip
    if done.clock.steps > SHOWN:
        console().print(f"and {done.clock.steps - SHOWN} more times")
    counts = done.gateway.inbox.counts
    print("frames: " + ", ".join(f"{k} {v}" for k, v in sorted(counts.items()) if v))
    whole, part = divmod(done.first_ns, 10**9)
    print(f"times: from the first frame, {whole}.{part:09d} s on the log's clock")
    for t_ns, node, what, word in changes:
        seconds = (t_ns - done.first_ns) / 1e9
        print(f"{seconds:12.3f} s  drive {node}  {what:8}  {word}")
