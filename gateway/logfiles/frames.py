"""Files of frames: candump text, and Parquet with a row per frame.

Every writer takes blocks, and counts the frames written and, by cause, those that its format
cannot hold.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from dbc.candump.writer import NotWritableError, Writer
from dbc.frame import BRS, ERROR, ESI, EXTENDED, FD, REMOTE, TX, Frame
from dbc.frames import Block
from dbc.logs.objects import ObjectReader

GROUP: Final = 1 << 17
"""Rows of a Parquet row group, which is kept in memory."""


class Sink:
    """Base of the files that are written, with their counts."""

    def __init__(self) -> None:
        self.written = 0
        """Number of frames written."""
        self.left_out: Counter[str] = Counter()
        """Frames that were not written, by cause."""
        self.reduced: Counter[str] = Counter()
        """Written frames of which a property is not kept, by property."""

    def add(self, block: Block) -> None:
        """Append frames."""
        raise NotImplementedError

    def close(self) -> None:
        """Complete the file and close it."""
        raise NotImplementedError


def without(block: Block, out: NDArray[np.bool_], counts: Counter[str], cause: str) -> Block:
    """The block without the frames of a mask (n,), which are counted by this cause."""
    if not out.any():
        return block
    counts[cause] += int(np.count_nonzero(out))
    return block.pick(~out)


def interface(channel: str) -> str:
    """A channel's name for candump; a bare number, as in other formats, gets `can` before it."""
    return f"can{channel}" if channel.isdecimal() else channel


class Candump(Sink):
    """`candump -L` text."""

    def __init__(self, path: Path) -> None:
        super().__init__()
        self._writer = Writer(path)

    def add(self, block: Block) -> None:
        """Append frames."""
        block = without(block, block.t_ns < 0, self.left_out, "before_1970")
        block = block._replace(names=[interface(name) for name in block.names])
        while block.size:
            try:
                self._writer.write_block(block)
            except NotWritableError as error:  # a name with a blank in it, for one
                self.written += error.row
                self.left_out["not_expressible"] += 1
                block = block.part(error.row + 1, block.size)
            else:
                self.written += block.size
                return

    def close(self) -> None:
        """Complete the file and close it."""
        self._writer.close()


FLAGS: Final = {
    "extended": EXTENDED, "remote": REMOTE, "error": ERROR, "fd": FD, "brs": BRS, "esi": ESI,
    "tx": TX,
}  # fmt: skip
_ADDED: Final = frozenset({"tx"})
"""Columns that files of earlier versions lack."""


class ParquetRows(Sink):
    """Base of both kinds of Parquet files: rows are kept until they fill a row group."""

    def __init__(self, path: Path, schema: Any, group: int) -> None:
        """Create the file. group: rows of a row group."""
        import pyarrow.parquet as pq

        super().__init__()
        self._schema, self._group = schema, group
        self._held: list[Any] = []
        self._rows = 0
        self._writer = pq.ParquetWriter(path, schema, compression="zstd")

    def _append(self, arrays: list[Any], rows: int) -> None:
        import pyarrow as pa

        self._held.append(pa.record_batch(arrays, schema=self._schema))
        self._rows += rows
        self.written += rows
        if self._rows >= self._group:
            self._flush()

    def _flush(self) -> None:
        import pyarrow as pa

        table = pa.Table.from_batches(self._held, schema=self._schema)
        self._writer.write_table(table.unify_dictionaries())
        self._held, self._rows = [], 0

    def close(self) -> None:
        """Complete the file and close it."""
        self._flush()
        self._writer.close()


class ParquetFrames(ParquetRows):
    """Parquet with a row per frame, lossless: `ParquetReader` returns the same frames."""

    def __init__(self, path: Path) -> None:
        import pyarrow as pa

        fields = [
            ("time", pa.timestamp("ns", "UTC")),
            ("channel", pa.string()),
            ("id", pa.uint32()),
            *((name, pa.bool_()) for name in FLAGS),
            ("dlc", pa.int8()),
            ("data", pa.binary()),
        ]
        super().__init__(path, pa.schema(fields), GROUP)

    def add(self, block: Block) -> None:
        """Append frames."""
        import pyarrow as pa

        rows = [block.data[k, :n].tobytes() for k, n in enumerate(block.length.tolist())]
        names = np.array(block.names, dtype=object)
        arrays = [
            pa.array(block.t_ns, pa.timestamp("ns", "UTC")),
            pa.array(names[block.channel], pa.string()),
            pa.array(block.can_id, pa.uint32()),
            *(pa.array(block.flags & flag != 0) for flag in FLAGS.values()),
            pa.array(block.dlc, pa.int8(), mask=block.dlc < 0),
            pa.array(rows, pa.binary()),
        ]
        self._append(arrays, block.size)


class ParquetReader(ObjectReader):
    """Frames of a file that `ParquetFrames` wrote. Raises LogError for any other."""

    unit = "rows"

    def frames(self) -> Iterator[Frame]:
        """All frames, in their order."""
        import pyarrow as pa
        import pyarrow.parquet as pq

        from dbc.candump.reader import LogError

        try:
            with pq.ParquetFile(self.path) as file:
                missing = {"time", "channel", "id", "dlc", "data", *FLAGS} - _ADDED
                missing -= set(file.schema_arrow.names)
                if missing:
                    what = "holds no frames (write them with `convert --frames`); no column "
                    raise LogError(str(self.path), 0, what + ", ".join(sorted(missing)))
                for batch in file.iter_batches(1 << 13):
                    yield from _frames(batch)
        except pa.ArrowException as error:
            text = f"cannot be read: {' '.join(str(error).split())}"
            raise LogError(str(self.path), 0, text) from error


def _frames(batch: Any) -> Iterator[Frame]:
    import pyarrow as pa

    flags = np.zeros(batch.num_rows, dtype=np.int64)
    for name, flag in FLAGS.items():
        if name in _ADDED and name not in batch.schema.names:
            continue
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
