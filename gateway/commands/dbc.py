"""`dbc`: write the message set of the installed package as a file."""

from __future__ import annotations

import argparse
from pathlib import Path

from gateway.commands.common import GOOD, shown
from gateway.settings.config import ConfigError, shipped_dbc


def arguments(parser: argparse.ArgumentParser) -> None:
    """Options of the verb."""
    parser.add_argument("-o", "--output", type=Path, required=True, metavar="FILE.dbc",
                        help="new file for the DBC")  # fmt: skip
    parser.add_argument("--fd", action="store_true", help="the message set for CAN FD")


def run(options: argparse.Namespace) -> int:
    """Write the DBC. Raises ConfigError if the file exists already, OSError."""
    from gateway.io.whole_file import write_text

    if options.output.exists():
        raise ConfigError(f"{options.output}: already exists", ["name another file"])
    source = shipped_dbc("traction_fd.dbc" if options.fd else "traction.dbc")
    write_text(options.output, source.read_text(encoding="utf-8"))
    print(f"written: {shown(options.output)}")
    return GOOD
