"""`verify CONFIG`: whether this configuration is the one that was signed."""

from __future__ import annotations

import argparse
from pathlib import Path

from gateway.commands.common import GOOD, add_signature, shown
from gateway.io.prepare import prepare


def arguments(parser: argparse.ArgumentParser) -> None:
    """Options of the verb."""
    parser.add_argument("config", type=Path, help="the configuration")
    add_signature(parser, required=True)


def run(options: argparse.Namespace) -> int:
    """Exit 0 if `run` would accept the configuration. Raises ConfigError if not (exit 2)."""
    from gateway.settings import calibration

    config, codec = prepare(options.config, signature=options)
    word = calibration.config_hash(config, codec.digest, calibration.of(config))
    print(
        f"{shown(options.config)}: signed by the owner of {shown(options.public_key)}, "
        f"hash {word:06x}"
    )
    return GOOD
