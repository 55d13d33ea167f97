"""How loops over many arrays are compiled; `dbc._lean` says why."""

from __future__ import annotations

from dbc._core_symbols import symbol
from dbc._kernelcache import njit
from dbc._lean import inlined, lean

__all__ = ["inlined", "lean", "njit", "symbol"]
