"""How loops over many arrays are compiled; `dbc._lean` says why."""

from __future__ import annotations

from dbc._kernelcache import njit
from dbc._lean import lean

__all__ = ["lean", "njit"]
