"""Open a log to be replayed or converted: its reader, its blocks, and one of its channels."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Final, NamedTuple

import numpy as np

from dbc.candump.reader import LogReader, Reader
from dbc.frames import Block
from dbc.logs.opening import OTHERS, ending, open_reader
from dbc.text import InputError
from gateway.io import quick_start

REPORTED = 200
"""Most characters that a message quotes of a line that is no frame, its fault included."""

NO_FRAME: Final = "no frame in the log (or none on this channel)"


class BadLogError(InputError):
    """The log cannot be replayed; the text says why and what to do."""


class OneChannel:
    """The frames of one channel of a log; `name` is known once the first frame has been read."""

    def __init__(
        self, blocks: Iterable[Block], wanted: str | None, option: str = "--log-channel"
    ) -> None:
        """wanted: the channel's name; None takes the only channel of the log.

        option: what the caller has to name a channel, for messages.
        """
        self.name = wanted
        self._blocks = blocks
        self._wanted, self._option = wanted, option

    def __iter__(self) -> Iterator[Block]:
        """Raises BadLogError for several channels if none was named, or if none has that name."""
        others: set[str] = set()
        found = False
        for block in self._blocks:
            if self.name is None:
                self.name = block.names[block.channel[0]]
            if block.names == [self.name]:
                found = True
                yield block
                continue
            names = np.array([name == self.name for name in block.names])
            mine = names[block.channel]
            found = found or bool(mine.any())
            if mine.all():
                yield block
                continue
            others.update(block.names)
            if self._wanted is None:
                other = block.names[block.channel[np.argmin(mine)]]
                raise BadLogError(
                    f"the log has several channels ({self.name}, {other}, ..); "
                    f"name one with {self._option}"
                )
            if mine.any():
                yield block.pick(mine)
        if others and not found:
            msg = f"no channel {self._wanted} in the log; it has {', '.join(sorted(others))}"
            raise BadLogError(msg)


class Log(NamedTuple):
    """A log that can be read: its blocks, and the reader, which keeps the counts."""

    blocks: Iterable[Block]
    reader: LogReader


def open_log(path: Path, strict: bool, line: str = "") -> Log:
    """Open a log: by its file extension, else by its content, see `dbc.logs.opening`.

    line: a pattern of its lines. Raises BadLogError if the path is not that of a regular file.
    """
    require_file(path)
    if ending(path) in OTHERS:
        quick_start.python_can()
    reader = open_reader(path, strict=strict, line=line)
    return Log(_some(reader, path, line), reader)


def require_file(path: Path) -> None:
    """Raise BadLogError if the path does not exist or is not a regular file.

    A FIFO or a device may never end.
    """
    if not path.exists():
        raise BadLogError(f"{path}: no such file")
    if path.is_dir():
        raise BadLogError(f"{path}: a folder, not a log")
    if not path.is_file():
        raise BadLogError(f"{path}: a FIFO, device or socket, not a log; write a file first")


def _some(reader: LogReader, path: Path, pattern: str) -> Iterator[Block]:
    """The log's blocks. Raises BadLogError at its end if there was no frame."""
    found = False
    for block in reader.blocks():
        found = found or block.size > 0
        yield block
    if found:
        return
    from dbc.logs.text import TextReader

    header = reader.nearest_header() if isinstance(reader, TextReader) else None
    if reader.problems or header:
        line, verdict, text = header or reader.problems[0]
        candump = isinstance(reader, Reader) and not isinstance(reader, TextReader)
        name = "frame as candump -L writes them" if candump else "frame"
        what = "" if candump else "cannot be read: "
        msg = (
            f"{path}: {what}not one of its {reader.lines} {reader.unit} is a {name}; "
            f"line {line}: {verdict.name.lower()}: {text[:REPORTED]}"
        )
        with path.open("rb") as file:
            head = file.read(8192)
        if candump and b"\r" in head and b"\n" not in head:
            msg = f"{path}: its lines end in CR only; change them with `tr '\\r' '\\n'`"
            raise BadLogError(msg)
        from dbc.logs.screen import is_screen_form

        if is_screen_form(text):
            msg += (
                "; candump shows this on a screen: record with `candump -L IF` or `candump -l IF`"
            )
        elif not pattern and reader.unit == "lines":
            cure = f"traction-gateway convert {path} OUT.log --line auto"
            msg += f"; for text of another program: `{cure}`"
        raise BadLogError(msg)
    if left := [f"{v.name.lower()} {n}" for v, n in reader.counts.items() if n]:
        raise BadLogError(f"{path}: no frame in the log ({', '.join(left)})")
    raise BadLogError(f"{path}: no frame in the log")
