"""Frames in text formats of other programs: Vector's ASC, PEAK's TRC 2.1, python-can's CSV.

The writers are our own, so that the same frames give the same bytes anywhere and at any time:
python-can's write the time of export, in the local time zone, instead of the log's own time
(docs/upstream/asc.md).
"""

from __future__ import annotations

from binascii import b2a_base64
from collections.abc import Iterator
from datetime import timedelta
from pathlib import Path
from typing import Any, Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from dbc.frame import BRS, ERROR, ESI, EXTENDED, FD, REMOTE, SECOND, TX, Nanos
from dbc.frames import MAX_DATA_BYTES, Block
from dbc.logs.format import DLC_OF
from dbc.logs.times import DAY_NS, EPOCH
from dbc.logs.trc import EPOCH_DAYS
from gateway.logfiles.channels import ChannelNumbers
from gateway.logfiles.frames import Sink, without

_DAYS: Final = ("Mon", "Tue", "Wed", "Thu", "Fri", "Sat", "Sun")
_MONTHS: Final = (
    "Jan", "Feb", "Mar", "Apr", "May", "Jun", "Jul", "Aug", "Sep", "Oct", "Nov", "Dec",
)  # fmt: skip
_DAY_DIGITS: Final = 14
_FORMS_KEPT: Final = 100_000
_MICRO: Final = np.uint64(1_000_000)
_CHANNEL_BITS: Final = 11
_ALL_BUT_CHANNEL: Final = (1 << (64 - _CHANNEL_BITS)) - 1
_EARLIEST, _LATEST = -62_000_000_000 * SECOND, 250_000_000_000 * SECOND
_FLAG_EDL, _FLAG_BRS, _FLAG_ESI = 0x1000, 0x2000, 0x4000


Times = NDArray[np.int64]


class Form(NamedTuple):
    """Text before and after the data in the lines of frames that differ only in time and data."""

    before: str
    behind: str
    has_data: bool = True


class TextFile(Sink):
    """Base of the three formats: a file, times from the first frame, counts."""

    not_held = 0
    """Flags (FD, REMOTE, ERROR) of frames that the format cannot hold."""
    has_channel = True
    has_error_class = False
    undirected = 0
    """Flags of frames whose direction is not kept."""
    as_hex = True
    counts_from_first = True
    """Whether times count from the first frame, without a sign."""

    def __init__(self, path: Path) -> None:
        super().__init__()
        self._numbered = 0
        self._first_ns: Nanos | None = None
        self._channels = ChannelNumbers()
        self._forms: dict[tuple[int, int], Form] = {}
        self._file = path.open("w", encoding="ascii", newline="")

    def add(self, block: Block) -> None:
        """Append frames."""
        block = self._representable(block)
        if not block.size:
            return
        for part in _with_few_channels(block):
            self._file.write("".join(self._text(part)))
        self.written += block.size
        self._count_reduced(block)

    def _text(self, block: Block) -> Iterator[str]:
        """Lines of a block."""
        size = min(int(block.length.max()), MAX_DATA_BYTES)
        # All bytes of the block in one text, from which each line takes its part.
        content = block.data[:, :size].tobytes()
        text, width = (content.hex(" ").upper(), 3) if self.as_hex else (content, 1)
        kinds, first, kind = np.unique(_kinds(block), return_index=True, return_inverse=True)
        forms = [
            self._form_of(one, block, at) for one, at in zip(kinds.tolist(), first, strict=True)
        ]
        starts = size * width * np.arange(block.size)
        shown = np.maximum(width * block.length.astype(np.int64) - (width - 1) // 2, 0)
        shown *= np.array([form.has_data for form in forms])[kind]
        parts = zip(starts.tolist(), (starts + shown).tolist(), strict=True)
        number = kind.tolist()
        return self._lines(
            block.t_ns,
            [forms[k].before for k in number],
            [text[start:end] for start, end in parts],
            [forms[k].behind for k in number],
        )

    def _form_of(self, kind: int, block: Block, at: int) -> Form:
        """The form of frames of one kind, such as the frame at `at`."""
        channel = self._channel(block.names[block.channel[at]])
        key = kind & _ALL_BUT_CHANNEL, channel
        form = self._forms.get(key)
        if form is None:
            if len(self._forms) > _FORMS_KEPT:
                self._forms.clear()
            can_id, flags, length, dlc = (
                field.item(at) for field in (block.can_id, block.flags, block.length, block.dlc)
            )
            form = self._form(can_id, flags, length, dlc, channel)
            self._forms[key] = form
        return form

    def _representable(self, block: Block) -> Block:
        """The frames that the format can hold; the others are counted."""
        for flag, name in ((FD, "fd"), (REMOTE, "remote"), (ERROR, "error")):
            block = without(block, block.flags & flag & self.not_held != 0, self.left_out, name)
        if not block.size:
            return block
        if self._first_ns is None:
            self._first_ns = block.t_ns.item(0)
            self._file.write("".join(self._head(self._first_ns)))
        if not self.counts_from_first:
            return block
        return without(block, block.t_ns < self._first_ns, self.left_out, "before_the_first")

    def _count_reduced(self, block: Block) -> None:
        """Count the written frames of which a property is not kept."""
        flags = block.flags
        if not self.has_error_class:
            described = (block.can_id != 0) | (block.length != 0)
            self.reduced["error_class"] += int(np.count_nonzero((flags & ERROR != 0) & described))
        lost = (flags & TX != 0) & (flags & self.undirected != 0)
        self.reduced["direction"] += int(np.count_nonzero(lost))
        if self.has_channel:
            self.reduced["channel"] += self._channels.lost(block)
        else:
            named = np.array([bool(name) for name in block.names])[block.channel]
            self.reduced["channel"] += int(np.count_nonzero(named))
            raw = (block.dlc > block.length) & (flags & REMOTE == 0)
            self.reduced["raw_length"] += int(np.count_nonzero(raw))

    @property
    def _start_ns(self) -> Nanos:
        return self._first_ns or 0

    def _channel(self, name: str) -> int:
        return self._channels.number(name) + 1

    def _head(self, first_ns: Nanos) -> Iterator[str]:
        raise NotImplementedError

    def _form(self, can_id: int, flags: int, length: int, dlc: int, channel: int) -> Form:
        """Text before and after the data of frames of one kind."""
        raise NotImplementedError

    def _lines(
        self, t_ns: Times, before: list[str], data: list[Any], behind: list[str]
    ) -> Iterator[str]:
        """Lines. data: hexadecimal with a space between bytes, or bytes (CSV); empty: no data."""
        raise NotImplementedError

    def _since_first(self, t_ns: Times) -> NDArray[np.uint64]:
        """Microseconds since the first frame, rounded; unsigned, so no difference overflows."""
        first = np.uint64(self._start_ns % 2**64)
        return (t_ns.view(np.uint64) - first + np.uint64(500)) // np.uint64(1000)

    def _tail(self) -> str:
        return ""

    def close(self) -> None:
        """Complete the file and close it."""
        if self._first_ns is not None:
            self._file.write(self._tail())
        self._file.close()


class AscFile(TextFile):
    """ASC; the date is that of the first frame, in UTC."""

    undirected = ERROR

    def _head(self, first_ns: Nanos) -> Iterator[str]:
        date = _date(first_ns)
        yield f"date {date}\nbase hex  timestamps absolute\ninternal events logged\n"
        yield f"Begin Triggerblock {date}\n 0.000000 Start of measurement\n"

    def _form(self, can_id: int, flags: int, length: int, dlc: int, channel: int) -> Form:
        if flags & ERROR:
            return Form(f" {channel}  ErrorFrame", "\n", has_data=False)
        name, way = f"{can_id:X}{'x' if flags & EXTENDED else ''}", _way(flags)
        if flags & FD:
            return self._fd_form(flags, length, f" CANFD {channel:>3} {way}   {name:>8}")
        if flags & REMOTE:
            asked = max(dlc, 0)
            return Form(f" {channel}  {name:<15} {way}   r {asked:x}", "\n", has_data=False)
        return Form(f" {channel}  {name:<15} {way}   d {dlc if dlc >= 0 else length:x} ", "\n")

    def _fd_form(self, flags: int, length: int, start: str) -> Form:
        brs, esi = bool(flags & BRS), bool(flags & ESI)
        bits = _FLAG_EDL | (_FLAG_BRS if brs else 0) | (_FLAG_ESI if esi else 0)
        middle = f"  {'':>32} {brs:d} {esi:d} {DLC_OF[length]:x} {length:>2} "
        zero = f"{0:>8}"
        end = f" {zero} {0:>4} {bits:>8X} {zero} {zero} {zero} {zero} {zero}\n"
        return Form(start + middle, end)

    def _lines(
        self, t_ns: Times, before: list[str], data: list[Any], behind: list[str]
    ) -> Iterator[str]:
        whole, part = (each.tolist() for each in divmod(self._since_first(t_ns), _MICRO))
        return map("%2d.%06d%s%s%s".__mod__, zip(whole, part, before, data, behind, strict=True))

    def _tail(self) -> str:
        return "End TriggerBlock\n"


class TrcFile(TextFile):
    """TRC 2.1; the start time is that of the first frame, in UTC, in whole microseconds."""

    @property
    def _start_ns(self) -> Nanos:
        return super()._start_ns // 1000 * 1000

    def _head(self, first_ns: Nanos) -> Iterator[str]:
        first_ns = self._start_ns
        days, rest = divmod(first_ns, DAY_NS)
        part = rest * 10**_DAY_DIGITS // DAY_NS
        moment = EPOCH + timedelta(microseconds=first_ns // 1000)
        yield f";$FILEVERSION=2.1\r\n;$STARTTIME={days + EPOCH_DAYS}.{part:0{_DAY_DIGITS}d}\r\n"
        yield ";$COLUMNS=N,O,T,B,I,d,R,L,D\r\n;\r\n"
        yield f";   Start time: {moment.isoformat(' ').removesuffix('+00:00')} UTC\r\n"
        yield ";   Generated by traction-gateway\r\n"
        yield ";---+-- ------+------ +- +- --+----- +- +- +--- +- -- -- -- -- -- -- --\r\n"

    def _form(self, can_id: int, flags: int, length: int, dlc: int, channel: int) -> Form:
        name = f"{can_id:08X}" if flags & EXTENDED else f"{can_id:04X}"
        code, kind = dlc if dlc >= 0 else DLC_OF.get(length, 0), "DT"
        if flags & ERROR:
            kind, name, code = "ER", "-", 0
        elif flags & REMOTE:
            kind, code = "RR", max(dlc, 0)
        elif flags & FD:
            kind = {0: "FD", BRS: "FB", BRS | ESI: "FE", ESI: "BI"}[flags & (BRS | ESI)]
        before = f" {kind} {channel:>2} {name:>8} {_way(flags)} -  {code:<4} "
        return Form(before, "\r\n", has_data=not flags & (ERROR | REMOTE))

    def _lines(
        self, t_ns: Times, before: list[str], data: list[Any], behind: list[str]
    ) -> Iterator[str]:
        whole, part = (each.tolist() for each in divmod(self._since_first(t_ns), np.uint64(1000)))
        numbers = range(self._numbered + 1, self._numbered + 1 + len(whole))
        self._numbered += len(whole)
        rows = zip(numbers, whole, part, before, data, behind, strict=True)
        return map("%7d %9d.%03d%s%s%s".__mod__, rows)


class CsvFrames(TextFile):
    """python-can's CSV of frames."""

    not_held = FD
    has_channel = False
    undirected = TX
    has_error_class = True
    as_hex = False
    counts_from_first = False

    def _head(self, first_ns: Nanos) -> Iterator[str]:
        del first_ns
        yield "timestamp,arbitration_id,extended,remote,error,dlc,data\n"

    def _form(self, can_id: int, flags: int, length: int, dlc: int, channel: int) -> Form:
        del channel
        bits = ",".join(str(int(bool(flags & flag))) for flag in (EXTENDED, REMOTE, ERROR))
        size = max(dlc, 0) if flags & REMOTE else length
        return Form(f",{can_id:#x},{bits},{size},", "\n")

    def _lines(
        self, t_ns: Times, before: list[str], data: list[Any], behind: list[str]
    ) -> Iterator[str]:
        del behind
        size, negative = t_ns.view(np.uint64), t_ns < 0
        size = np.where(negative, np.uint64(0) - size, size)
        whole, part = (each.tolist() for each in divmod(size, np.uint64(SECOND)))
        sign = ["-" if one else "" for one in negative.tolist()]
        # b2a_base64 ends with the line break.
        shown = [b2a_base64(one).decode() for one in data]
        return map("%s%d.%09d%s%s".__mod__, zip(sign, whole, part, before, shown, strict=True))


def _kinds(block: Block) -> NDArray[np.uint64]:
    """(n,) keys, equal for frames that differ only in time and data."""
    made = block.channel.astype(np.uint64)
    fields = (block.dlc.view(np.uint8), 8), (block.length, 8), (block.flags, 8), (block.can_id, 29)
    for field, bits in fields:
        made = made << np.uint64(bits) | field.astype(np.uint64)
    return made


def _with_few_channels(block: Block) -> Iterator[Block]:
    """The block in parts whose channel numbers fit into the bits that `_kinds` has for them."""
    most = 1 << _CHANNEL_BITS
    if block.channel.max() < most:
        yield block
        return
    for first in range(0, block.size, most):
        part = block.part(first, min(first + most, block.size))
        used, number = np.unique(part.channel, return_inverse=True)
        names = [block.names[k] for k in used.tolist()]
        yield part._replace(channel=number.astype(np.uint16), names=names)


def _way(flags: int) -> str:
    return "Tx" if flags & TX else "Rx"


def _date(t_ns: Nanos) -> str:
    """A date as Vector writes it, in UTC, and in English whatever the machine's language."""
    moment = EPOCH + timedelta(microseconds=min(max(t_ns, _EARLIEST), _LATEST) // 1000)
    clock = f"{moment:%H:%M:%S}.{moment.microsecond // 1000:03d}"
    day = f"{_DAYS[moment.weekday()]} {_MONTHS[moment.month - 1]} {moment.day:02d}"
    return f"{day} {clock} {moment.year}"
