"""Compiled functions, called without asking each time what their arguments are.

numba looks through every tuple of arrays at every call to find out its types: ten times as long as
a tick's receive loop takes for one frame, 30 us a tick in all. Here they are found out once.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from numba import typeof


class Direct:
    """One compiled function in one place, where its arguments are of the same types for good.

    Each place has its own: types are those of its first call, and whoever calls keeps to them
    (arrays contiguous). No other type is noticed here; `tests/keptypes.py` notices it in tests.

    What it gives must not be of a class of Python's, such as a named tuple: numba calls the class
    and goes on with nothing where that raises, as it does when a signal comes meanwhile.
    """

    __slots__ = ("_call", "_compiled")

    def __init__(self, compiled: Any) -> None:
        """compiled: by `numba.njit`; a function that is not, such as a twin, is called as it is."""
        self._compiled = compiled
        self._call: Callable[..., Any] | None = None if hasattr(compiled, "overloads") else compiled

    def __deepcopy__(self, _memo: dict[int, object]) -> Direct:
        """Shared: the copy of a place has arguments of the same types."""
        return self

    @property
    def name(self) -> str:
        """Of the function."""
        return str(self._compiled.__name__)

    def __call__(self, *arguments: Any) -> Any:
        """What the function gives. Raises what it raises."""
        if self._call is not None:
            return self._call(*arguments)
        given = self._compiled(*arguments)
        self._call = self._compiled.overloads[tuple(map(typeof, arguments))].entry_point
        return given
