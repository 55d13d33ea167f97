"""The gateway: a pure core `step(frames, now) -> frames` and the drivers around it.

`gateway.replay`, `gateway.scenario` and the other names of `gateway.api` are the Python API.
"""

from __future__ import annotations

import importlib
from typing import Any

_API = (
    "Config", "ConfigError", "Evidence", "Gateway", "Opinion", "detectors", "replay", "scenario",
)  # fmt: skip


def __getattr__(name: str) -> Any:
    """Import a name of the API on first use, so that a command imports only what it uses."""
    if name not in _API:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(importlib.import_module("gateway.api"), name)


def __dir__() -> list[str]:
    """Names for completion in a notebook."""
    return [*globals(), *_API]
