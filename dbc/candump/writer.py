"""Write candump logs: frames, or blocks of them, to a file or a stream."""

from __future__ import annotations

import gzip
from contextlib import AbstractContextManager, ExitStack
from pathlib import Path
from typing import IO, Final, cast

from _traction_core import ffi, lib

from dbc.candump.grammar import format_frame, name_bytes, not_writable
from dbc.frame import Frame
from dbc.frames import MAX_DATA_BYTES, Block

_LINES: Final = 512
"""Number of the longest lines that the text buffer holds."""


class NotWritableError(ValueError):
    """Frame `row` of a block cannot be written as a line; those before it are written."""

    def __init__(self, row: int, text: str) -> None:
        """`text`: the message, without the row."""
        self.row = row
        super().__init__(text)


class Writer(AbstractContextManager["Writer"]):
    """Writes frames to a log (gzip by the suffix `.gz`). Context manager; `close` when done."""

    def __init__(self, target: Path | str | IO[bytes], channel: str = "can0") -> None:
        """Create or empty the file; `channel` is for frames without one. Raises OSError."""
        self._channel = channel
        self._text = ffi.new("char[]", _LINES * lib.CANDUMP_MAX_TEXT)
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
        """Append one frame; `channel` is used if the frame has none.

        Raises ValueError (see `format_frame`) or OSError.
        """
        self._stream.write(format_frame(frame, channel or self._channel) + b"\n")

    def write_block(self, block: Block, channel: str = "") -> None:
        """Append the frames of a block; much faster than `write` frame by frame.

        Raises NotWritableError at the first frame that no line can hold.
        """
        if not block.size:
            return
        names = [name_bytes(name or channel or self._channel) for name in block.names]
        records = ffi.new("struct interface_name[]", [(name, len(name)) for name in names])
        columns, filled = block.columns(), ffi.new("int64_t *")
        row = 0
        while row < block.size:
            row = lib.candump_write(
                columns, row, block.size, records, self._text, len(self._text), filled
            )
            self._stream.write(ffi.unpack(self._text, filled[0]))
            if row < block.size and not filled[0]:
                # A block keeps no more bytes of a frame; written, the cut frame would look whole.
                if block.length[row] > MAX_DATA_BYTES:
                    msg = f"cannot be written as a candump line: more than {MAX_DATA_BYTES} bytes"
                    raise NotWritableError(row, msg)
                raise NotWritableError(row, str(not_writable(block.frame(row))))

    def close(self) -> None:
        """Flush and close a file that this object opened; a given stream stays open."""
        self._stack.close()

    def __exit__(self, *error: object) -> None:
        """Close."""
        self.close()
