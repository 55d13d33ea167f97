"""Watches that whoever calls a `Direct` keeps to the types of its first call: nobody else does."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any
from unittest.mock import patch

from numba import typeof

from gateway._direct import Direct

_SAFE = (int, float, bool, tuple, type(None))


@contextmanager
def kept_types() -> Iterator[set[str]]:
    """Gives the names of what was called. Raises AssertionError at the first other type."""
    first: dict[int, tuple[Direct, tuple[Any, ...]]] = {}
    called: set[str] = set()
    plain = Direct.__call__

    def call(self: Direct, *arguments: Any) -> Any:
        types = tuple(map(typeof, arguments))
        # The object is kept with its types, so that no other one gets its id.
        held = first.setdefault(id(self), (self, types))[1]
        assert types == held, f"{self.name}: {_other(held, types)}"
        called.add(self.name)
        given = plain(self, *arguments)
        for part in (given, *(given if isinstance(given, tuple) else ())):
            # numba would call any other class itself, and crash where a signal makes that raise.
            assert type(part) in _SAFE, f"{self.name} gives {type(part)}"
        return given

    with patch.object(Direct, "__call__", call):
        yield called


def _other(held: tuple[Any, ...], types: tuple[Any, ...]) -> str:
    pairs = [(k, a, b) for k, (a, b) in enumerate(zip(held, types, strict=True)) if a != b]
    return "; ".join(f"argument {k} was {a}, is {b}" for k, a, b in pairs)
