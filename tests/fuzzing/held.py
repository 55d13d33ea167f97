"""A file that is none: what is read of a path without a disk."""

from __future__ import annotations

import io
from pathlib import Path
from typing import IO


class Held(type(Path())):  # type: ignore[misc]
    """A path whose file is these bytes."""

    def __new__(cls, data: bytes, name: str = "log") -> Held:
        held = super().__new__(cls, name)
        held.data = data
        return held

    def __init__(self, data: bytes, name: str = "log") -> None:
        # From Python 3.12 on paths take their parts here.
        if type(Path()).__init__ is not object.__init__:
            super().__init__(name)

    @property
    def parent(self) -> Path:
        """An ordinary path."""
        return Path(*self.parts[:-1])

    def open(self, mode="r", buffering=-1, encoding=None, errors=None, newline=None) -> IO:
        """As `Path.open`, for reading."""
        stream = io.BytesIO(self.data)
        if "b" in mode:
            return stream
        return io.TextIOWrapper(stream, encoding=encoding, errors=errors, newline=newline)
