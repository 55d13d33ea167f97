"""The compiled core, as far as the maths may know it."""

from __future__ import annotations

from dbc import records
from dbc.records import Addressed, Records, pointer

__all__ = ["Addressed", "Records", "pointer", "records"]
