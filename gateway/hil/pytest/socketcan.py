"""A real SocketCAN interface for a test, if the machine can have one."""

from __future__ import annotations

import itertools
import subprocess
from collections.abc import Iterator

import pytest

_NUMBERS = itertools.count()
HOW = "run it inside: `traction-gateway vcan -- python -m pytest`"


def interface(*, required: bool) -> Iterator[str]:
    """Name of a fresh vcan interface, up, with CAN FD; it is deleted afterwards.

    If none can be made, the test is skipped with the cause, or fails if `required`.
    """
    from gateway.hil.vcan.links import Links
    from gateway.hil.vcan.ways import searched

    name = f"hil{next(_NUMBERS)}"
    for line in Links((name,)).making():
        done = subprocess.run(
            ["sh", "-c", line], capture_output=True, text=True, check=False, env=searched()
        )
        if done.returncode:
            why = f"no SocketCAN here ({' '.join(done.stderr.split())}); {HOW}"
            (pytest.fail if required else pytest.skip)(why)
    try:
        yield name
    finally:
        delete = ["ip", "link", "delete", name]
        subprocess.run(delete, capture_output=True, check=False, env=searched())
