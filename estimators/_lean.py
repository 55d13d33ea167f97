"""How loops over many arrays are compiled, until they are C."""

from __future__ import annotations

from numba import njit

from dbc._core_symbols import symbol

__all__ = ["njit", "symbol"]
