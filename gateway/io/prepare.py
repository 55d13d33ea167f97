"""Configuration and codec of a command: reading, signature check, binding to the DBC."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import TYPE_CHECKING, Any

from dbc.text import InputError
from gateway.settings.config import Config, ConfigError, load

if TYPE_CHECKING:
    from dbc.codec import Codec


def prepare(
    path: Path | None, *, signature: argparse.Namespace | None = None, **changes: Any
) -> tuple[Config, Codec]:
    """Return configuration and codec. Raises InputError with every problem.

    signature: options of `add_signature`; with a public key, nothing unsigned is parsed.
    changes: fields of `[section]`s to override, as `section={"key": value}`; None: not overridden.
    """
    given = {
        section: {k: v for k, v in values.items() if v is not None}
        for section, values in changes.items()
    }
    if signature is None or signature.public_key is None:
        if signature is not None and signature.signature is not None:
            raise ConfigError("--signature", ["has no effect without --public-key"])
        config = load(path, **given)
        return config, bound(config)
    from gateway.io.signing import check_digest, check_files, default_signature, verified

    if path is None:
        raise ConfigError("--public-key", ["the built-in configuration has no signature"])
    seals = verified(signature.signature or default_signature(path), signature.public_key)
    config = load(path, seals, **given)
    check_files(config)
    codec = bound(config)
    check_digest(config, codec.digest)
    return config, codec


def bound(config: Config) -> Codec:
    """Codec of a configuration's DBC. Raises InputError, with the problems of its other files."""
    from dbc.codec import bind

    def codec() -> Codec:
        with config.naming("dbc.file", config.dbc_path):
            return bind(config.dbc_path, config.nodes)

    try:
        return codec()
    except InputError:
        from gateway.mapping import plan
        from gateway.settings import calibration

        config.all_of(codec, lambda: plan.plans(config), lambda: calibration.of(config))
        raise
