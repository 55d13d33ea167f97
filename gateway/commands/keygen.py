"""`keygen`: signing keys, authentication keys for flags, and tokens for the monitor's page."""

from __future__ import annotations

import argparse
import secrets
from pathlib import Path

from gateway.commands.common import GOOD


def arguments(parser: argparse.ArgumentParser) -> None:
    """Options of the verb."""
    parser.add_argument("-o", "--output", type=Path, required=True, metavar="FILE",
                        help="the private key; an existing file is not overwritten")  # fmt: skip
    kind = parser.add_mutually_exclusive_group()
    kind.add_argument(
        "--flags", action="store_true",
        help="a key for [authentication]: the gateway and every receiver on one bus need this one",
    )  # fmt: skip
    kind.add_argument(
        "--token", action="store_true",
        help="a token for 'monitor --token-file', with which viewers log in",
    )  # fmt: skip


def run(options: argparse.Namespace) -> int:
    """Write the keys. Raises OSError where a file of that name exists."""
    from gateway.io.signing import make_keys, write_private

    private = options.output
    private.parent.mkdir(parents=True, exist_ok=True)
    if options.flags:
        write_private(private, secrets.token_hex(16).encode("ascii") + b"\n")
        print(f"{private}: key for the flags of one bus; give it to the gateway and its receivers")
        return GOOD
    if options.token:
        write_private(private, secrets.token_urlsafe(32).encode("ascii") + b"\n")
        print(f"{private}: token for the monitor's page and metrics")
        return GOOD
    public = private.with_name(private.stem + ".pub" + private.suffix)
    make_keys(private, public)
    print(f"{private}: signs configurations; do not keep it on a gateway")
    print(
        f"{public}: for 'run --public-key'; whoever edits configurations must not be able to write "
        "it"
    )
    return GOOD
