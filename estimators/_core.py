"""The part of the compiled core that the estimators use."""

from __future__ import annotations

from dbc import records
from dbc.records import Addressed, Records, pointer

__all__ = ["Addressed", "Records", "pointer", "records"]
