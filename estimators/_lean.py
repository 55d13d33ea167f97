"""How loops over many arrays are compiled; `dbc._lean`, which nobody here may import, says why."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, TypeVar

from numba import njit

F = TypeVar("F", bound=Callable[..., Any])


def lean(function: F) -> F:
    """Compiled, cached, without reference counts: it can make no array."""
    return njit(cache=True, _nrt=False, error_model="numpy")(function)  # type: ignore[no-any-return,call-overload]


def fused(function: F) -> F:
    """The same, products fused with sums, and nothing raised on a division by zero."""
    return njit(cache=True, _nrt=False, fastmath={"contract"}, error_model="numpy")(function)  # type: ignore[no-any-return,call-overload]
