"""Decoded signals as one wide table, a row per frame: Parquet and CSV.

Columns: time, channel, message, then `Message.Signal` of every message in the log; a row has
values only for the signals of its own message, and only if they are available.
"""

from __future__ import annotations

import csv
import gzip
import json
from collections.abc import Collection
from pathlib import Path
from typing import Final, TextIO, cast

import numpy as np
from numpy.typing import NDArray

from dbc.frame import SECOND
from dbc.frames import Block
from dbc.spec import MessageSpec, SignalSpec
from gateway.logfiles.frames import ParquetRows, Sink
from gateway.logfiles.signals import Decoded, Decoder, columns, is_exact

_LARGEST: Final = 2.0**64
_CELLS: Final = 1 << 22
"""Cells of a Parquet row group, which is kept in memory: some 40 MB."""
MARKS: Final = "out_of_range"
"""The last column: names of the row's signals that are out of range or saturated."""
Comments = dict[str, str]
"""`Message` and `Message.Signal` -> comment in the DBC."""


def labels_of(signal: SignalSpec) -> dict[int, str]:
    """Raw value -> label of a signal, without the not-available code, which is no value."""
    return {raw: name for raw, name in signal.labels.items() if raw != signal.not_available}


class ParquetSignals(ParquetRows):
    """The wide table in Parquet; unit, comment and labels (JSON) in each field's metadata."""

    def __init__(
        self, path: Path, decoder: Decoder, messages: Collection[MessageSpec], comments: Comments
    ) -> None:
        """Create the file. messages: those that get columns."""
        import pyarrow as pa

        self._decoder = decoder
        self._columns = list(columns(messages))
        self._names = [m.name for m in decoder.codec.messages]
        word = pa.dictionary(pa.int16(), pa.string())
        fields = [
            pa.field("time", pa.timestamp("ns", "UTC")),
            pa.field("channel", word),
            pa.field("message", word),
        ]
        for name, message, place in self._columns:
            signal = message.signals[place]
            metadata = {"unit": signal.unit, "comment": comments.get(name, "")}
            if labels := labels_of(signal):
                metadata["labels"] = json.dumps(labels)
            metadata = {key: text for key, text in metadata.items() if text}
            kind = pa.float64()
            if is_exact(signal):
                kind = pa.int64() if signal.is_signed else pa.uint64()
            fields.append(pa.field(name, kind, metadata=metadata))
        fields.append(pa.field(MARKS, pa.string()))
        super().__init__(path, pa.schema(fields), max(_CELLS // len(fields), 1))

    def add(self, block: Block) -> None:
        """Append frames."""
        for first in range(0, block.size, self._group):
            self._add(block.part(first, min(first + self._group, block.size)))

    def _add(self, block: Block) -> None:
        import pyarrow as pa

        done = self._decoder.decode(block)
        frames = done.frames
        channel = pa.array(frames.channel.astype(np.int16))
        arrays = [
            pa.array(frames.t_ns, pa.timestamp("ns", "UTC")),
            pa.DictionaryArray.from_arrays(channel, pa.array(frames.names, pa.string())),
            pa.DictionaryArray.from_arrays(
                pa.array(done.message.astype(np.int16)), pa.array(self._names, pa.string())
            ),
        ]
        for k, (_, message, place) in enumerate(self._columns, 3):
            if is_exact(message.signals[place]):
                whole = done.exact.get((message.index, place), [None] * frames.size)
                arrays.append(pa.array(list(whole), self._schema.field(k).type))
                continue
            values = _column(done, message, place)
            arrays.append(pa.array(values, pa.float64(), mask=np.isnan(values)))
        marks = np.full(frames.size, None, dtype=object)
        for k in np.flatnonzero(done.marked.any(axis=1)).tolist():
            marks[k] = done.marks(k, self._decoder.codec.messages[done.message[k]])
        arrays.append(pa.array(marks, pa.string()))
        self._append(arrays, frames.size)


def _column(done: Decoded, message: MessageSpec, place: int) -> NDArray[np.float64]:
    return np.where(done.message == message.index, done.value[:, place], np.nan)


class CsvSignals(Sink):
    """The wide table as CSV: `t_s` with nine decimals, units in the header, empty: no value."""

    def __init__(self, path: Path, decoder: Decoder, messages: Collection[MessageSpec]) -> None:
        """Create the file, compressed if it ends in `.gz`. messages: those that get columns."""
        super().__init__()
        self._decoder = decoder
        head = ["t_s", "channel", "message"]
        self._first: dict[int, int] = {}
        for name, message, place in columns(messages):
            self._first.setdefault(message.index, len(head))
            unit = message.signals[place].unit
            head.append(f"{name} [{unit}]" if unit else name)
        head.append(MARKS)
        self._width = len(head)
        if path.suffix.lower() == ".gz":
            stream = gzip.open(path, "wt", encoding="utf-8", newline="")  # noqa: SIM115
            self._file = cast("TextIO", stream)
        else:
            self._file = path.open("w", encoding="utf-8", newline="")
        self._rows = csv.writer(self._file, lineterminator="\n")
        self._rows.writerow(head)

    def add(self, block: Block) -> None:
        """Append frames."""
        done = self._decoder.decode(block)
        frames, messages = done.frames, self._decoder.codec.messages
        has_marks = np.atleast_1d(done.marked.any(axis=1)).tolist()
        stamps, channels = frames.t_ns.tolist(), frames.channel.tolist()
        for k, (number, values) in enumerate(
            zip(done.message.tolist(), done.value.tolist(), strict=True)
        ):
            message = messages[number]
            row = [""] * self._width
            row[:3] = (_seconds(stamps[k]), frames.names[channels[k]], message.name)
            first = self._first.get(number, 0)  # 0: a message without signals has no column
            for place, value in enumerate(values[: len(message.signals)], first):
                if value == value:  # noqa: PLR0124 - not NaN
                    row[place] = decimal(value)
            if has_marks[k]:
                row[-1] = done.marks(k, message)
            for (index, place), whole in done.exact.items():
                if index == number and whole[k] is not None:
                    row[first + place] = str(whole[k])
            self._rows.writerow(row)
        self.written += frames.size

    def close(self) -> None:
        """Close the file."""
        self._file.close()


def decimal(value: float) -> str:
    """15 digits, which a float always preserves; all digits of an integer from 1e15 to 2**64."""
    if 1e15 <= abs(value) < _LARGEST and value.is_integer():
        return f"{value:.0f}"
    return format(value, ".15g")


def _seconds(t_ns: int) -> str:
    """Seconds with nine decimals, exact; at today's dates a float loses the last two digits."""
    sign, size = ("-", -t_ns) if t_ns < 0 else ("", t_ns)
    return f"{sign}{size // SECOND}.{size % SECOND:09d}"
