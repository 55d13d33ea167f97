"""How loops over many arrays are compiled; `dbc._lean` says why."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, TypeVar

from dbc._core_symbols import symbol
from dbc._kernelcache import njit
from dbc._lean import inlined, lean

__all__ = ["fused", "inlined", "lean", "njit", "symbol"]
F = TypeVar("F", bound=Callable[..., Any])


def fused(function: F) -> F:
    """As `lean`, products fused with sums, and nothing raised on a division by zero."""
    return njit(cache=True, _nrt=False, fastmath={"contract"}, error_model="numpy")(function)
