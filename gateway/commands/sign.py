"""`sign CONFIG`: sign a configuration with its DBC and its calibration."""

from __future__ import annotations

import argparse
from pathlib import Path

from gateway.commands.common import GOOD, shown
from gateway.io.prepare import prepare


def arguments(parser: argparse.ArgumentParser) -> None:
    """Options of the verb."""
    parser.add_argument("config", type=Path, help="the configuration; it must be valid")
    parser.add_argument("--key", type=Path, required=True, metavar="PRIVATE.pem",
                        help="private ed25519 key, from 'keygen'")  # fmt: skip
    parser.add_argument("-o", "--output", type=Path, metavar="FILE.sig",
                        help="default: the configuration's name and .sig")  # fmt: skip


def run(options: argparse.Namespace) -> int:
    """Check the files to be signed, then write the signature. Raises ConfigError."""
    from gateway.io.signing import check_digest, default_signature, sign
    from gateway.io.whole_file import write_text
    from gateway.settings import calibration

    config, codec = prepare(options.config)
    cells = calibration.of(config)
    text, seals = sign(options.config, config, options.key)
    check_digest(config.model_copy(update={"sealed": seals}), codec.digest)
    path = options.output or default_signature(options.config)
    write_text(path, text)
    word = calibration.config_hash(config, codec.digest, cells)
    print(f"{shown(path)}: signed, hash {word:06x}")
    for role, seal in seals.items():
        print(f"  {role:12} {seal}")
    return GOOD
