"""Bus and expectations from the pytest command line."""

from __future__ import annotations

from typing import Any

import pytest


def bus_of(config: pytest.Config) -> dict[str, Any] | None:
    """python-can's options; None if no bus was named, which means the virtual clock."""
    interface = config.getoption("--can-interface")
    if interface is None:
        return None
    given = {
        "interface": interface,
        "channel": config.getoption("--can-channel"),
        "bitrate": config.getoption("--can-bitrate"),
        "fd": config.getoption("--can-fd") or None,
    }
    return {key: value for key, value in given.items() if value is not None}


def expected_known(config: pytest.Config) -> dict[str, float]:
    """Least percentage of known time by flag, from `--hil-expect-known`. Raises UsageError."""
    from argparse import ArgumentTypeError

    from gateway.reports.known import wanted

    try:
        return dict(wanted(word) for word in config.getoption("--hil-expect-known"))
    except ArgumentTypeError as error:
        raise pytest.UsageError(f"--hil-expect-known: {error}") from None
