"""`warm`: does nothing, because nothing is compiled at run time; removed in the next version."""

from __future__ import annotations

import argparse
from pathlib import Path

from gateway.commands.common import GOOD


def arguments(parser: argparse.ArgumentParser) -> None:
    """Options of the verb as they were; none has an effect."""
    parser.add_argument("config", type=Path, nargs="*", metavar="CONFIG", help="without effect")
    parser.add_argument("-o", "--output", type=Path, metavar="DIR", help="without effect")


def run(_options: argparse.Namespace) -> int:
    """Print that the verb does nothing."""
    print("`warm` does nothing: the package contains the compiled core. The next version has none.")
    return GOOD
