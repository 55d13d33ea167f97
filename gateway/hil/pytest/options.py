"""Bus, expectations and the gateway's fault from the pytest command line."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import pytest

if TYPE_CHECKING:
    from gateway.hil.mutants import Mutant


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


def mutant_of(config: pytest.Config) -> Mutant | None:
    """The fault that the gateway has, from `--hil-mutant`; None: none. Raises UsageError."""
    word = config.getoption("--hil-mutant")
    if word is None:
        return None
    from gateway.hil.mutants import mutants

    number, _, seed = word.partition(":")
    try:
        mutant = mutants(int(number), int(seed or 0))[int(number) - 1]
    except (ValueError, IndexError):
        msg = f"--hil-mutant {word}: expected NUMBER or NUMBER:SEED as in `hil --mutate`"
        raise pytest.UsageError(msg) from None
    if mutant.settings is not None and config.getoption("--hil-gateway") == "external":
        raise pytest.UsageError(f"--hil-mutant {word}: an external gateway keeps its settings")
    return mutant
