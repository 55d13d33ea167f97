"""`shrink LOG --flag adhesion:2@41.3`: make a short test from a long recording."""

from __future__ import annotations

import argparse
import re
from pathlib import Path
from typing import TYPE_CHECKING

from dbc.text import number_or_nan
from gateway.commands.common import GOOD, add_config, positive_seconds, shown
from gateway.commands.progress import Progress, stepped
from gateway.io import quick_start
from gateway.io.prepare import prepare

if TYPE_CHECKING:
    from gateway.logfiles.shrink import Wanted

_EPILOG = """\
KIND is adhesion or thermal, DRIVE a node number, SECONDS the time since the first frame of the
log at which `replay` prints the change. DIR gets shrunk.log (candump), start.bin (the state of the
gateway before the first frame) and test_shrunk.py (for pytest).
"""


def arguments(parser: argparse.ArgumentParser) -> None:
    """Options of the verb."""
    parser.epilog = _EPILOG
    parser.add_argument("log", type=Path, help="candump log (.log, .gz), or any python-can format")
    parser.add_argument("--flag", type=wanted, required=True, metavar="KIND:DRIVE@SECONDS",
                        help="the change of a flag that the test is about")  # fmt: skip
    parser.add_argument("-o", "--output", type=Path, required=True, metavar="DIR",
                        help="folder for the three files")  # fmt: skip
    add_config(parser)
    parser.add_argument("--before", type=positive_seconds, default=0.05, metavar="SECONDS",
                        help="start this long before the evidence (default: 0.05)")  # fmt: skip
    parser.add_argument("--log-channel", metavar="NAME", help="channel, if the log has several")


def wanted(text: str) -> Wanted:
    """Parse a text like `adhesion:2@41.3`. Raises ArgumentTypeError for anything else."""
    from gateway.core.flags import FlagKind
    from gateway.logfiles.shrink import Wanted

    found = re.fullmatch(r"(adhesion|thermal):(\d{1,3})@(\S+)", text)
    at_s = number_or_nan(found[3] if found else "")
    if found is None or not 0.0 <= at_s < 1e9:
        msg = f"{text!r} is not KIND:DRIVE@SECONDS, such as adhesion:2@41.3 or thermal:1@600"
        raise argparse.ArgumentTypeError(msg)
    return Wanted(FlagKind[found[1].upper()], int(found[2]), at_s)


def run(options: argparse.Namespace) -> int:
    """Shrink the log; print what remains of it."""
    with quick_start.unsearched():
        from dbc.frame import SECOND
        from gateway.logfiles import shrunk_files
        from gateway.logfiles.shrink import STEPS, shrink

        config, codec = prepare(options.config)
    before_ns = round(options.before * SECOND)
    with Progress("", len(STEPS) + 1) as progress:
        step = stepped(progress)
        left = shrink(
            options.log, config, codec, options.flag, before_ns, options.log_channel, step
        )
        step("writing the test")
        shrunk_files.write_test(options.output, left, options.flag, options.config, options.log)
        shrunk_files.read_back(options.output, left, config, codec)
    at_s, since_s, start_s = (
        (t_ns - left.first_ns) / SECOND
        for t_ns in (left.change.now_ns, left.change.since_ns, left.start.now_ns)
    )
    print(f"{options.flag.name}: {left.word} at {at_s:.3f} s, evidence since {since_s:.3f} s")
    print(f"frames: {left.frames.size:,} of {left.total:,} "
          f"({100.0 * left.frames.size / left.total:.2f} %), from {start_s:.3f} s on")  # fmt: skip
    print(f"the same flag bytes: {left.flag_frame.data.hex()}")
    print(f"pytest {shown(options.output / shrunk_files.TEST)}")
    return GOOD
