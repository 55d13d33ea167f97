"""MF4 by asammdf: decoded signals in a channel group per message, or frames as bus logging.

Times count from the first frame's full second, in float seconds: exact to the nanosecond for
97 days. asammdf keeps appended data in a temporary file, so memory does not grow.
"""

from __future__ import annotations

import contextlib
from datetime import timedelta
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from dbc.frame import BRS, ERROR, ESI, EXTENDED, FD, REMOTE, SECOND, TX
from dbc.frames import Block
from dbc.logs.times import EPOCH
from dbc.spec import MessageSpec, SignalSpec
from gateway.logfiles.channels import ChannelNumbers
from gateway.logfiles.frames import Sink
from gateway.logfiles.signal_files import Comments, labels_of
from gateway.logfiles.signals import Decoded, Decoder, is_exact

_BUS, _CAN = 2, 2
"""MF4's numbers for the source type bus and the bus type CAN."""
_MOST_CHANNEL: Final = 0xFF
"""Highest channel number: ASAM's BusChannel has 8 bits."""


class _Mf4(Sink):
    """Base of both kinds of MF4: the file, its start time, groups that grow."""

    def __init__(self, path: Path) -> None:
        from asammdf import MDF

        super().__init__()
        self._path = path
        self._mdf = MDF(version="4.10")
        self._base_ns: int | None = None
        self._groups: dict[Any, int] = {}
        self._latest: dict[Any, int] = {}

    def _seconds(self, t_ns: NDArray[np.int64]) -> NDArray[np.float64]:
        if self._base_ns is None:
            seconds = int(t_ns[0]) // SECOND
            self._base_ns = seconds * SECOND
            self._mdf.header.start_time = EPOCH + timedelta(seconds=seconds)
        return np.asarray((t_ns - self._base_ns) / SECOND, dtype=np.float64)

    def _forward(self, key: Any, t_ns: NDArray[np.int64]) -> NDArray[np.bool_]:
        """Mask of a group's times that do not go back, as MF4 needs ascending times."""
        latest = self._latest.get(key, int(t_ns[0]))
        highest = np.maximum(np.maximum.accumulate(t_ns), latest)
        self._latest[key] = int(highest[-1])
        good = np.asarray(t_ns == highest)
        if not good.all():
            self.left_out["time_back"] += int(np.count_nonzero(~good))
        return good

    def close(self) -> None:
        """Write the file and close it."""
        with contextlib.closing(self._mdf):
            self._mdf.save(self._path, overwrite=True, compression=2)


class Mf4Signals(_Mf4):
    """Decoded signals: a channel group per message and bus; units and comments as in the DBC.

    A missing value has its invalidation bit set, and is NaN for readers that ignore this bit.
    """

    def __init__(self, path: Path, decoder: Decoder, comments: Comments) -> None:
        """Prepare the file, which is at `path` only after `close`."""
        super().__init__(path)
        self._decoder = decoder
        self._comments = comments

    def add(self, block: Block) -> None:
        """Append the frames' signals."""
        done = self._decoder.decode(block)
        frames = done.frames
        if frames.size:
            self._seconds(frames.t_ns)
        pairs = frames.channel.astype(np.int64) << 32 | done.message
        for pair in np.unique(pairs).tolist():
            message = self._decoder.codec.messages[pair & 0xFFFF_FFFF]
            channel = frames.names[pair >> 32]
            key = (channel, message.index)
            rows = np.flatnonzero(pairs == pair)
            rows = rows[self._forward(key, frames.t_ns[rows])]
            if not rows.size or not message.signals:
                self.left_out["no_signals"] += len(rows)
                continue
            times = self._seconds(frames.t_ns[rows])
            cells = [_cells(done, message, place, rows) for place in range(len(message.signals))]
            if key not in self._groups:
                self._groups[key] = self._begin(message, channel, times, cells)
            else:
                self._mdf.extend(self._groups[key], [(times, None), *cells])
            self.written += len(rows)

    def _begin(
        self, message: MessageSpec, channel: str, times: Any, cells: list[tuple[Any, Any]]
    ) -> int:
        from asammdf import Signal, Source

        source = Source(name=channel, path=channel, comment="", source_type=_BUS, bus_type=_CAN)
        signals = []
        for signal, (column, missing) in zip(message.signals, cells, strict=True):
            name = f"{message.name}.{signal.name}"
            signals.append(
                Signal(
                    samples=column,
                    timestamps=times,
                    name=name,
                    unit=signal.unit,
                    comment=self._comments.get(name, ""),
                    conversion=_names(signal),
                    source=source,
                    invalidation_bits=missing,
                )
            )
        comment = self._comments.get(message.name, "")
        return int(
            self._mdf.append(signals, acq_name=message.name, acq_source=source, comment=comment)
        )


def _cells(
    done: Decoded, message: MessageSpec, place: int, rows: NDArray[np.int64]
) -> tuple[Any, NDArray[np.bool_]]:
    """(values of a signal in these rows, mask of the missing ones)."""
    values = done.value[rows, place]
    missing = np.isnan(values)
    signal = message.signals[place]
    if is_exact(signal):
        found = done.exact[message.index, place][rows]
        kind = np.int64 if signal.is_signed else np.uint64
        return np.array([0 if raw is None else raw for raw in found], dtype=kind), missing
    return np.ascontiguousarray(values), missing


def _names(signal: SignalSpec) -> dict[str, Any] | None:
    """Labels of a state as MF4's value-to-text table; None for a signal that is a number.

    A state has a label for every valid value, because a value not in the table would show no text.
    """
    labels = labels_of(signal)
    named = sum(signal.raw_min <= raw <= signal.raw_max for raw in labels)
    if named <= signal.raw_max - signal.raw_min or (signal.scale, signal.offset) != (1, 0):
        return None
    table: dict[str, Any] = {}
    for k, (raw, text) in enumerate(sorted(labels.items())):
        table[f"val_{k}"] = float(raw)
        table[f"text_{k}"] = text
    return table


class Mf4Frames(_Mf4):
    """Frames as bus logging, for MF4 tools, which decode with their own DBC, and for python-can."""

    def __init__(self, path: Path) -> None:
        """Prepare the file, which is at `path` only after `close`."""
        super().__init__(path)
        self._channels = ChannelNumbers(_MOST_CHANNEL)

    def add(self, block: Block) -> None:
        """Append frames."""
        if block.size:
            self._seconds(block.t_ns)
        kind = np.where(block.flags & ERROR, 1, np.where(block.flags & REMOTE, 2, 0))
        for number, name in enumerate(("CAN_DataFrame", "CAN_ErrorFrame", "CAN_RemoteFrame")):
            rows = np.flatnonzero(kind == number)
            if rows.size:
                rows = rows[self._forward(name, block.t_ns[rows])]
            if rows.size:
                self._append(name, block.pick(rows))

    def _append(self, name: str, block: Block) -> None:
        from asammdf import Signal, Source

        times = self._seconds(block.t_ns)
        records = _records(name, block, [self._channels.number(each) for each in block.names])
        self.reduced["channel"] += self._channels.lost(block)
        if name in self._groups:
            self._mdf.extend(self._groups[name], [(times, None), (records, None)])
        else:
            source = Source(name="CAN", path="CAN", comment="", source_type=_BUS, bus_type=_CAN)
            signal = Signal(samples=records, timestamps=times, name=name, source=source)
            self._groups[name] = int(self._mdf.append(signal, acq_name="CAN", acq_source=source))
        self.written += block.size


def _records(name: str, block: Block, numbers: list[int]) -> NDArray[np.void]:
    """ASAM's records of frames; remote frames have no data. numbers: of the block's channels."""
    from can.util import len2dlc

    from dbc.logs.python_can import mf4_module

    mf4 = mf4_module()

    remote = name == "CAN_RemoteFrame"
    kinds = {"CAN_DataFrame": mf4.STD_DTYPE, "CAN_ErrorFrame": mf4.ERR_DTYPE}
    out = np.zeros(block.size, dtype=mf4.RTR_DTYPE if remote else kinds[name])
    codes = np.array([len2dlc(n) for n in range(65)], dtype=np.uint8)
    fd = block.flags & FD != 0
    length = block.length.clip(max=64)
    dlc = np.where(fd, codes[length], length)
    dlc = np.where((block.dlc >= 0) & ~fd, block.dlc, dlc)
    out[f"{name}.BusChannel"] = np.array(numbers, np.uint8)[block.channel]
    out[f"{name}.ID"] = block.can_id
    out[f"{name}.IDE"] = block.flags & EXTENDED != 0
    out[f"{name}.DLC"] = dlc
    out[f"{name}.Dir"] = block.flags & TX != 0
    out[f"{name}.DataLength"] = np.where(remote, 0, length)
    if not remote:
        out[f"{name}.DataBytes"] = block.data
        out[f"{name}.EDL"] = fd
        out[f"{name}.BRS"] = block.flags & BRS != 0
        out[f"{name}.ESI"] = block.flags & ESI != 0
    return out
