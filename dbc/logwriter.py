"""Writes candump logs: frames, or blocks of them, to a file or a stream."""

from __future__ import annotations

import gzip
from contextlib import ExitStack
from pathlib import Path
from types import TracebackType
from typing import IO, Final, Self, cast

import numpy as np

from dbc._logline_kernels import DIGITS, FD_LENGTH, MOST_LINE, write_lines
from dbc.block import ROOM, Block
from dbc.frame import Frame
from dbc.logblocks import MOST_NAME
from dbc.logline import format_frame, name_bytes

_LINES: Final = 512
"""That there is room for at once."""


class Writer:
    """Writes frames to a log (gzip by the suffix `.gz`). Context manager; `close` when done."""

    def __init__(self, target: Path | str | IO[bytes], channel: str = "can0") -> None:
        """Create or empty the file; `channel` is for frames without one. Raises OSError."""
        self._channel = channel
        self._lines = np.zeros(_LINES * MOST_LINE, dtype=np.uint8)
        self._stack = ExitStack()
        self._stream: IO[bytes]
        if isinstance(target, (Path, str)):
            path = Path(target)
            plain = self._stack.enter_context(path.open("wb"))
            if path.suffix.lower() == ".gz":
                # No name and time in the header: the same frames give the same bytes.
                zipped = gzip.GzipFile("", "wb", fileobj=plain, mtime=0)
                self._stack.callback(zipped.close)
                self._stream = cast("IO[bytes]", zipped)
            else:
                self._stream = plain
        else:
            self._stream = target

    def write(self, frame: Frame, channel: str = "") -> None:
        """Append one frame, `channel` standing in where it has none.

        Raises ValueError (see `format_frame`) or OSError.
        """
        self._stream.write(format_frame(frame, channel or self._channel) + b"\n")

    def write_block(self, block: Block, channel: str = "") -> None:
        """Append the frames of a block, as `write` does one by one; much sooner."""
        if not block.size:
            return
        names = [name_bytes(name or channel or self._channel) for name in block.names]
        sizes = np.array([len(name) for name in names], dtype=np.int64)
        table = np.frombuffer(
            bytearray().join([name.ljust(MOST_NAME, b"\0") for name in names]), dtype=np.uint8
        ).reshape(-1, MOST_NAME)
        row = 0
        while row < block.size:
            row, size = write_lines(
                row, block.t_ns, block.can_id, block.flags, block.length, block.data, block.dlc,
                block.channel, table, sizes, DIGITS, FD_LENGTH, self._lines,
            )  # fmt: skip
            self._stream.write(self._lines[:size].tobytes())
            if not size:
                # A block keeps no more than this of a frame, and what is cut would look whole.
                if block.length[row] > ROOM:
                    msg = f"cannot be written as a candump line: more than {ROOM} bytes"
                    raise ValueError(msg)
                self.write(block.frame(row), channel)
                row += 1

    def close(self) -> None:
        """Flush and close what was opened here; a given stream stays open."""
        self._stack.close()

    def __enter__(self) -> Self:
        """Itself."""
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        value: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        """Close."""
        self.close()
