"""Configuration and codec of a command: reading, signature check, binding to the DBC."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import TYPE_CHECKING, Any

from gateway.settings.config import Config, ConfigError, load

if TYPE_CHECKING:
    from dbc.codec import Codec


def prepare(
    path: Path | None, *, signature: argparse.Namespace | None = None, **changes: Any
) -> tuple[Config, Codec]:
    """Return configuration and codec. Raises ConfigError or DbcMismatch with every problem.

    signature: options of `add_signature`; with a public key, nothing unsigned is parsed.
    changes: fields of `[section]`s to override, as `section={"key": value}`; None: not overridden.
    """
    from dbc.codec import bind

    given = {
        section: {k: v for k, v in values.items() if v is not None}
        for section, values in changes.items()
    }
    if signature is None or signature.public_key is None:
        if signature is not None and signature.signature is not None:
            raise ConfigError("--signature", ["has no effect without --public-key"])
        config = load(path, **given)
        return config, bind(config.dbc_path, config.nodes)
    from gateway.io.signing import check_digest, check_files, default_signature, verified

    if path is None:
        raise ConfigError("--public-key", ["the built-in configuration has no signature"])
    seals = verified(signature.signature or default_signature(path), signature.public_key)
    config = load(path, seals, **given)
    check_files(config)
    codec = bind(config.dbc_path, config.nodes)
    check_digest(config, codec.digest)
    return config, codec
