"""Frames into files: candump text, python-can's formats, Parquet with a row per frame.

Every writer takes blocks, counts what it wrote and what its format has no room for, by cause.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator
from pathlib import Path
from typing import Any, Final, Protocol

import numpy as np

from dbc.candump.reader import Writer
from dbc.frame import BRS, ERROR, ESI, EXTENDED, FD, REMOTE, Frame
from dbc.frames import Block

GROUP: Final = 1 << 17
"""Rows of a Parquet row group: what is kept in memory."""


class Sink(Protocol):
    """A file being written."""

    written: int
    """Frames."""
    left_out: Counter[str]
    """Frames that were not written, by cause."""

    def add(self, block: Block) -> None:
        """Append."""

    def close(self) -> None:
        """Make the file whole."""


def interface(channel: str) -> str:
    """A channel's name for candump: the bare numbers of other formats are `can` and the number."""
    return f"can{channel}" if channel.isdecimal() else channel


class Candump:
    """`candump -L` text."""

    def __init__(self, path: Path) -> None:
        """Creates the file."""
        self.written = 0
        self.left_out: Counter[str] = Counter()
        self._writer = Writer(path)

    def add(self, block: Block) -> None:
        """Append."""
        names = [interface(name) for name in block.names]
        for k, frame in enumerate(block.frames()):
            try:
                self._writer.write(frame._replace(channel=names[block.channel[k]]))
            except ValueError:
                # A time before 1970, or a name with a blank in it.
                self.left_out["not_expressible"] += 1
            else:
                self.written += 1

    def close(self) -> None:
        """Make the file whole."""
        self._writer.close()


_NO_ROOM: Final = {".asc": 0, ".blf": 0, ".trc": FD | REMOTE | ERROR, ".csv": FD}
"""Ending -> flags of frames that python-can's writer drops or mistakes for others."""


class PythonCan:
    """python-can's own writers: `.asc`, `.blf`, `.trc`, and `.csv` of frames."""

    def __init__(self, path: Path) -> None:
        """Creates the file; the format is by its ending."""
        import can

        self.written = 0
        self.left_out: Counter[str] = Counter()
        self._no_room = _NO_ROOM[path.suffix.lower()]
        self._first_ns: int | None = None
        self._logger = can.Logger(path)

    def add(self, block: Block) -> None:
        """Append."""
        from dbc.python_can_logs import to_message

        for frame in block.frames():
            if (cause := self._objection(frame)) is not None:
                self.left_out[cause] += 1
                continue
            if self._first_ns is None:
                self._first_ns = frame.t_ns
            self._logger.on_message_received(to_message(frame))
            self.written += 1

    def _objection(self, frame: Frame) -> str | None:
        for flag, name in ((FD, "fd"), (REMOTE, "remote"), (ERROR, "error")):
            if frame.flags & flag & self._no_room:
                return name
        # These formats count from the first frame and have no sign.
        if self._first_ns is not None and frame.t_ns < self._first_ns:
            return "before_the_first"
        return None

    def close(self) -> None:
        """Make the file whole."""
        self._logger.stop()


_FLAGS: Final = {
    "extended": EXTENDED, "remote": REMOTE, "error": ERROR, "fd": FD, "brs": BRS, "esi": ESI,
}  # fmt: skip


class ParquetFrames:
    """A row per frame, nothing lost: `read_parquet` gives the same frames."""

    def __init__(self, path: Path) -> None:
        """Creates the file."""
        import pyarrow as pa
        import pyarrow.parquet as pq

        self.written = 0
        self.left_out: Counter[str] = Counter()
        self._schema = pa.schema(
            [
                ("time", pa.timestamp("ns", "UTC")),
                ("channel", pa.string()),
                ("id", pa.uint32()),
                *((name, pa.bool_()) for name in _FLAGS),
                ("dlc", pa.int8()),
                ("data", pa.binary()),
            ]
        )
        self._held: list[Any] = []
        self._rows = 0
        self._writer = pq.ParquetWriter(path, self._schema, compression="zstd")

    def add(self, block: Block) -> None:
        """Append."""
        import pyarrow as pa

        rows = [block.data[k, :n].tobytes() for k, n in enumerate(block.length.tolist())]
        names = np.array(block.names, dtype=object)
        arrays = [
            pa.array(block.t_ns, pa.timestamp("ns", "UTC")),
            pa.array(names[block.channel], pa.string()),
            pa.array(block.can_id, pa.uint32()),
            *(pa.array(block.flags & flag != 0) for flag in _FLAGS.values()),
            pa.array(block.dlc, pa.int8(), mask=block.dlc < 0),
            pa.array(rows, pa.binary()),
        ]
        self._held.append(pa.record_batch(arrays, schema=self._schema))
        self._rows += block.size
        self.written += block.size
        if self._rows >= GROUP:
            self._flush()

    def _flush(self) -> None:
        import pyarrow as pa

        self._writer.write_table(pa.Table.from_batches(self._held, schema=self._schema))
        self._held, self._rows = [], 0

    def close(self) -> None:
        """Make the file whole."""
        self._flush()
        self._writer.close()


def read_parquet(path: Path) -> Iterator[Frame]:
    """Frames of a file that `ParquetFrames` wrote. Raises LogError for any other."""
    import pyarrow as pa
    import pyarrow.parquet as pq

    from dbc.candump.reader import LogError

    try:
        with pq.ParquetFile(path) as file:
            missing = {"time", "channel", "id", "dlc", "data", *_FLAGS}
            missing -= set(file.schema_arrow.names)
            if missing:
                what = "holds no frames (write them with `convert --frames`); no column "
                raise LogError(str(path), 0, what + ", ".join(sorted(missing)))
            for batch in file.iter_batches(1 << 13):
                yield from _frames(batch)
    except pa.ArrowException as error:
        text = " ".join(str(error).split())
        raise LogError(str(path), 0, f"cannot be read: {text}") from error


def _frames(batch: Any) -> Iterator[Frame]:
    import pyarrow as pa

    flags = np.zeros(batch.num_rows, dtype=np.int64)
    for name, flag in _FLAGS.items():
        flags |= np.where(batch[name].to_numpy(zero_copy_only=False), flag, 0)
    rows = zip(
        batch["time"].cast(pa.timestamp("ns", "UTC")).cast(pa.int64()).to_pylist(),
        batch["id"].to_pylist(),
        batch["data"].to_pylist(),
        flags.tolist(),
        batch["channel"].to_pylist(),
        batch["dlc"].fill_null(-1).to_pylist(),
        strict=True,
    )
    return (Frame(*row) for row in rows)


__all__ = ["Candump", "ParquetFrames", "PythonCan", "Sink", "interface", "read_parquet"]
