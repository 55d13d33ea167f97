"""`fleet-thresholds DIR`: derive thresholds from a healthy fleet's results."""

from __future__ import annotations

import argparse
from pathlib import Path

from gateway.commands.common import GOOD
from gateway.io.console import console
from gateway.io.extras import need


def arguments(parser: argparse.ArgumentParser) -> None:
    """Options of the verb."""
    parser.add_argument("results", metavar="DIR", help="results of `fleet -o DIR`, or their URL")
    parser.add_argument("-o", "--output", type=Path, required=True, metavar="FILE.toml",
                        help="the thresholds to write")  # fmt: skip
    parser.add_argument("--force", action="store_true",
                        help="count flags that were raised as false alarms")  # fmt: skip


def run(options: argparse.Namespace) -> int:
    """Measure; write and print the fragment. Exit 2 if the fleet is not healthy."""
    need(("pyarrow",), "fleet")
    from gateway.fleet.storage import place
    from gateway.fleet.thresholds import measure, to_toml
    from gateway.io.whole_file import write_text

    measured = measure(place(options.results), force=options.force)
    if measured.bad:
        console().print(f"{measured.bad} bad logs left out")
    text = to_toml(measured)
    write_text(options.output, text)
    print(text, end="")
    return GOOD
