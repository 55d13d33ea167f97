"""How the loops are compiled that get many arrays at once.

numba counts references to every array of every tuple that is handed on, atomically, although
whoever called keeps them all alive: three quarters of the receive loop's time. Without that a
function can make no array: rows are written number by number, not as slices.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, TypeVar

from dbc._kernelcache import njit

F = TypeVar("F", bound=Callable[..., Any])


def lean(function: F) -> F:
    """Compiled, cached, without reference counts."""
    return njit(cache=True, _nrt=False, error_model="numpy")(function)


def unlocked(function: F) -> F:
    """The same, and other threads go on meanwhile: for what takes milliseconds."""
    return njit(cache=True, nogil=True, _nrt=False, error_model="numpy")(function)


def inlined(function: F) -> F:
    """As `lean`, put in where it is called."""
    return njit(cache=True, forceinline=True, _nrt=False, error_model="numpy")(function)
