"""CAN bus logging in MF4, read by asammdf in whole arrays.

This module exists because python-can's reader takes every identifier for 29 bits if there is no IDE
channel, needs DataLength, and takes local time to be in the zone of the reading machine
(docs/upstream/mf4.md). Here a file with local time of an unknown zone is read as UTC.
"""

from __future__ import annotations

import contextlib
import logging
import shutil
import tempfile
from collections.abc import Iterator
from contextlib import ExitStack
from functools import reduce
from pathlib import Path
from typing import IO, Any, Final

import numpy as np
from numpy.typing import NDArray

from dbc.candump.grammar import Verdict
from dbc.candump.reader import LogError
from dbc.extras import how_to_install
from dbc.frame import BRS, ERROR, ESI, EXTENDED, FD, REMOTE, TX
from dbc.frames import EMPTY, MAX_DATA_BYTES, Block, join
from dbc.logs.format import CLASSIC_BYTES, FD_SIZES
from dbc.logs.mf4_blocks import missing_part
from dbc.logs.mf4_unfinished import end_of_records
from dbc.logs.objects import ObjectReader
from dbc.logs.python_can import mf4_module

_ROWS: Final = 1 << 14
"""Number of records of a group that are read at once."""
_KINDS: Final = {"CAN_DataFrame": 0, "CAN_ErrorFrame": ERROR, "CAN_RemoteFrame": REMOTE}
_FINISHED: Final = b"MDF     "
"""Start of a file that its recorder has closed."""
_LOCAL_TIME: Final = 1
"""Bit in the time flags of the header."""
_LONG_ID: Final = 0x8000_0000
_SIZES: Final = np.array(FD_SIZES, dtype=np.int64)
_BITS: Final = {"IDE": EXTENDED, "EDL": FD, "BRS": BRS, "ESI": ESI}


class Mf4(ObjectReader):
    """Reader of one MF4 file; its groups are merged by time."""

    unit = "frames and records"

    def blocks(self) -> Iterator[Block]:
        """See `ObjectReader.blocks`."""
        self._reset()
        module = mf4_module()
        if getattr(module, "asammdf", None) is None:
            raise LogError(self.name, 0, f"cannot be read: needs asammdf: {how_to_install('mf4')}")
        _calm(module)
        try:
            with ExitStack() as stack:
                source = self._whole(stack)
                try:
                    # For a long log, asammdf's own table of identifiers takes half a gigabyte.
                    mdf = module.MDF(source, process_bus_logging=False)
                    yield from self._read(stack.enter_context(mdf))
                    self._end()
                except Exception as error:
                    if part := missing_part(source):
                        raise LogError(self.name, 0, f"cannot be read{self._where}: {part}") from (
                            error
                        )
                    raise
        except LogError:
            raise
        except Exception as error:  # asammdf raises anything from KeyError to struct.error
            text = " ".join(str(error).split()) or type(error).__name__
            raise LogError(self.name, 0, f"cannot be read{self._where}: {text}") from error

    @property
    def _where(self) -> str:
        return f" after {self.lines} frames" if self.lines else ""

    def _read(self, mdf: Any) -> Iterator[Block]:
        """Yield the frames of an open file."""
        groups = list(self._groups(mdf))
        if self.counts[Verdict.EVENT] and not groups:
            why = "has no group of CAN frames (bus logging), only signals or another bus"
            raise LogError(self.name, 0, why)
        if mdf.header.time_flags & _LOCAL_TIME:
            self.notes.append("the file's times are local, without a time zone: read as UTC")
        yield from self._merged([_Group(mdf, k, name) for k, name in groups])

    def _whole(self, stack: ExitStack) -> Path | IO[bytes]:
        """The file; a gzip file is unpacked on disk, because asammdf needs random access.

        asammdf maps a path into memory, and only for a path does it complete an unfinished file.
        """
        source = self._open(stack)
        source = _copied(source, stack) if self.zipped else source
        finished = source.read(len(_FINISHED)) == _FINISHED
        ends = None if finished else end_of_records(source)
        source.seek(0)
        if ends is None or ends[0] == ends[1]:
            return source if finished or self.zipped else self.path
        self.truncated = "in the middle of a record"
        source = source if self.zipped else _copied(source, stack)
        source.truncate(ends[0])
        return source

    def _groups(self, mdf: Any) -> Iterator[tuple[int, str]]:
        """Yield the groups of CAN bus logging; records of all other groups are counted."""
        for index, group in enumerate(mdf.groups):
            names = {channel.name for channel in group.channels}
            found = next((name for name in _KINDS if name in names), None)
            count = int(group.channel_group.cycles_nr)
            if found is not None and count:
                yield index, found
            elif count:
                self._skip(Verdict.EVENT, count)

    def _merged(self, groups: list[_Group]) -> Iterator[Block]:
        """Yield blocks sorted by time. At equal times groups keep their order in the file."""
        while waiting := [group for group in groups if group.fill()]:
            last = min(group.held[0].max() for group in waiting)
            parts = [group.frames_until(last) for group in waiting]
            order = np.argsort(np.concatenate([part.t_ns for part in parts]), kind="stable")
            yield self._checked(reduce(join, parts).pick(order))

    def _checked(self, block: Block) -> Block:
        """The possible frames of a block; the others are faults. All are counted by verdict."""
        flags, size = block.flags, block.length
        data = flags & (ERROR | REMOTE) == 0
        long = (flags & FD == 0) & (size > CLASSIC_BYTES) & data
        bad_length = long | ((flags & FD != 0) & data & ~np.isin(size, FD_SIZES))
        bad_id = (flags & (EXTENDED | ERROR) == 0) & (block.can_id > 0x7FF) & ~bad_length
        for verdict, which in ((Verdict.BAD_LENGTH, bad_length), (Verdict.BAD_ID, bad_id)):
            for k in np.flatnonzero(which).tolist():
                self._skip_fault(verdict, f"id {block.can_id.item(k):X}, {size.item(k)} bytes")
        block = block.pick(~(bad_length | bad_id))
        self._count(block)
        return block


def _copied(stream: IO[bytes], stack: ExitStack) -> IO[bytes]:
    """A copy on disk of the rest of the stream, at its start."""
    copy = stack.enter_context(tempfile.TemporaryFile())  # noqa: SIM115 the stack closes it
    shutil.copyfileobj(stream, copy)
    copy.seek(0)
    return copy


def _calm(module: Any) -> None:
    """Silence asammdf: the error raised here already describes a damaged file.

    The half-made object of a rejected file also raises an exception when it is collected.
    """
    logging.getLogger("asammdf").setLevel(logging.CRITICAL)
    kind = module.asammdf.blocks.mdf_v4.MDF4
    whole = kind.__del__
    if getattr(whole, "is_calm", False):
        return

    def end(half: Any) -> None:
        with contextlib.suppress(Exception):
            whole(half)

    end.is_calm = True  # type: ignore[attr-defined]
    kind.__del__ = end


class _Group:
    """Frames of one channel group, read piece by piece."""

    def __init__(self, mdf: Any, index: int, name: str) -> None:
        self._mdf, self._index, self._name = mdf, index, name
        self._left = int(mdf.groups[index].channel_group.cycles_nr)
        self._done = 0
        self._start_ns = int(mdf.header.abs_time)
        self.held: tuple[NDArray[np.int64], Block] = (np.zeros(0, np.int64), EMPTY)

    def fill(self) -> bool:
        """Read frames if none are held; False at the end."""
        while not len(self.held[0]) and self._done < self._left:
            records = self._mdf.get(
                self._name, self._index, record_offset=self._done, record_count=_ROWS, raw=False
            )
            self._done += _ROWS
            if len(records):
                block = self._block(records)
                self.held = block.t_ns, block
        return bool(len(self.held[0]))

    def frames_until(self, last_ns: int) -> Block:
        """Return the held frames up to a time; the others stay held."""
        times, block = self.held
        late = np.flatnonzero(times > last_ns)
        end = late.item(0) if late.size else len(times)
        self.held = times[end:], block.part(end, len(times))
        return block.part(0, end)

    def _block(self, records: Any) -> Block:
        samples, count, kind = records.samples, len(records), _KINDS[self._name]
        present = set(samples.dtype.names)

        def field(name: str) -> NDArray[np.int64] | None:
            full = f"{self._name}.{name}"
            if full not in present or samples[full].dtype.kind not in "iubf":
                return None
            values = samples[full].reshape(count, -1)[:, 0]
            if values.dtype.kind == "f":  # of a virtual channel: no bits, only a conversion
                values = np.nan_to_num(values).clip(0.0, 2.0**32)
            return values.astype(np.int64)  # type: ignore[no-any-return]

        def or_zero(name: str) -> NDArray[np.int64]:
            found = field(name)
            return np.zeros(count, np.int64) if found is None else found

        can_id, long = or_zero("ID"), field("IDE")
        flags = np.full(count, kind, np.int64)
        # Without an IDE channel, bit 31 of the identifier marks 29 bits.
        flags |= np.where(can_id & _LONG_ID if long is None else long, EXTENDED, 0)
        if not kind:
            for name, flag in _BITS.items():
                flags |= np.where(or_zero(name) != 0, flag, 0) if name != "IDE" else 0
            flags &= np.where(flags & FD, 0xFF, ~(BRS | ESI))
        if kind == ERROR:
            flags[:] = ERROR
        flags |= np.where(or_zero("Dir") != 0, TX, 0)
        dlc, data = or_zero("DLC"), np.zeros((count, MAX_DATA_BYTES), np.uint8)
        length = np.zeros(count, np.int64)
        if kind != REMOTE and f"{self._name}.DataBytes" in present:
            content = samples[f"{self._name}.DataBytes"].reshape(count, -1)[:, :MAX_DATA_BYTES]
            size = field("DataLength")
            if size is None and field("DLC") is not None:
                size = np.where(flags & FD, _SIZES[dlc & 15], np.minimum(dlc, CLASSIC_BYTES))
            width = content.shape[1]
            length = np.full(count, width) if size is None else np.minimum(size, 255)
            data[:, :width] = content
            data[np.arange(MAX_DATA_BYTES) >= length[:, None]] = 0
        raw = (flags & (FD | ERROR) == 0) & (dlc > CLASSIC_BYTES) & (length == CLASSIC_BYTES)
        raw |= (kind == REMOTE) & (dlc > 0)
        channel = or_zero("BusChannel")
        numbers, places = np.unique(channel, return_inverse=True)
        times = np.rint(records.timestamps.astype(np.float64) * 1e9).astype(np.int64)
        return Block(
            times + self._start_ns, (can_id & 0x1FFF_FFFF).astype(np.uint32),
            flags.astype(np.uint8), length.astype(np.uint8), data,
            np.where(raw, np.minimum(dlc, 15), -1).astype(np.int8), places.astype(np.uint16),
            [str(number) for number in numbers.tolist()],
        )  # fmt: skip
