"""The gateway: a pure core `step(frames, now) -> frames` and the drivers around it.

`gateway.replay`, `gateway.scenario` and the other names of `gateway.api` are the Python API.
"""

from __future__ import annotations

import _signal  # type: ignore[import-not-found]  # `signal` imports `enum`: some milliseconds
import os
import sys

NAME = "traction-gateway"


def _is_program() -> bool:
    """Whether this process is the command line, and no worker of it or program of its user."""
    name = (getattr(sys, "argv", None) or [""])[0]
    ours = name == "-m" or os.path.basename(name) == NAME  # noqa: PTH119 pathlib is slow to load
    return ours and "multiprocessing" not in sys.modules


if _is_program() and _signal.getsignal(_signal.SIGINT) is _signal.default_int_handler:
    # Before any other import: until `gateway.io.endings` handles signals, Ctrl-C ends the program
    # without a traceback.
    _signal.signal(_signal.SIGINT, lambda *_: os._exit(130))

import importlib  # noqa: E402
from typing import TYPE_CHECKING, Any  # noqa: E402

if TYPE_CHECKING:  # at run time `__getattr__` imports them
    from gateway.api import (  # noqa: I001
        Config, ConfigError, Evidence, Gateway, InputError, Opinion, detectors, replay, scenario,
    )  # fmt: skip

__all__ = [
    "Config", "ConfigError", "Evidence", "Gateway", "InputError", "Opinion", "detectors", "replay",
    "scenario",
]  # fmt: skip


def __getattr__(name: str) -> Any:
    """Import a name of the API on first use, so that a command imports only what it uses."""
    if name not in __all__:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(importlib.import_module("gateway.api"), name)


def __dir__() -> list[str]:
    """Names for completion in a notebook."""
    return [*globals(), *__all__]
