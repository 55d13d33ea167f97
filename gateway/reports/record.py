"""The record of a run: `flags.csv`, `estimates.csv`, and the changes of flags."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from contextlib import AbstractContextManager, ExitStack
from functools import cache
from pathlib import Path
from typing import IO, TYPE_CHECKING, Any, Final, NamedTuple

import numpy as np
from _traction_core import ffi, lib
from numpy.typing import NDArray

from dbc.records import pointer
from gateway.core.codes import FaultClass, Flag, Health, Reason
from gateway.core.flags import FlagKind
from gateway.core.view import GatewayView
from gateway.io.whole_file import whole

if TYPE_CHECKING:
    from gateway.core.gateway import Gateway
    from gateway.reports.ticks import Ticks

ADHESION = {Flag.UNKNOWN: "Unknown", Flag.GOOD: "Adhering", Flag.BAD: "AdhesionLost"}
FAULT = {Flag.UNKNOWN: "Unknown", Flag.GOOD: "NoFault", Flag.BAD: "Fault"}
COMMON = {Flag.UNKNOWN: "Unknown", Flag.GOOD: "NotDetected", Flag.BAD: "AllDrives"}
Change = tuple[int, int, str, str]
"""Time in ns, node, flag, new state."""
FLAGS, ESTIMATES = "flags.csv", "estimates.csv"
FLAGS_HEADER = (
    "t_s", "drive", "adhesion", "thermal", "reason", "adhesion_reason", "thermal_reason",
)  # fmt: skip
ESTIMATES_HEADER = (
    "t_s", "drive", "health", "speed_rad_s", "load_nm", "load_sigma_nm", "loss_probability",
    "nis", "fault_class", "mixed_c", "maisd_k", "degradation_k_h", "degradation_sigma_k_h",
    "hours_to_limit",
)  # fmt: skip

_DECIMALS: Final = (4, 4, 4, 4, 3, 2, 3, 4, 4, 1)
"""Decimals of the numbers in `estimates.csv`."""
_LINES: Final = 512
"""Number of the longest lines that the text buffer holds."""
NEITHER: Final = -1
"""A value that no flag has."""


def camel(name: str) -> str:
    """`NOT_AVAILABLE` as the DBC writes it: `NotAvailable`."""
    return "".join(part.capitalize() for part in name.split("_"))


Column = NDArray[Any]


class Coded(NamedTuple):
    """A column of codes, and the word of each code."""

    code: NDArray[np.uint8]
    words: Column


def in_words(column: Coded | Column) -> Column:
    """The words of a column of codes; any other column unchanged."""
    return column.words[column.code] if isinstance(column, Coded) else column


def by_code(words: Mapping[Any, str]) -> Column:
    """(256,): the word of each code."""
    made = np.full(256, "", dtype=object)
    for code, word in words.items():
        made[code] = word
    return made


_ADHESION, _FAULT = by_code(ADHESION), by_code(FAULT)
_REASONS, _HEALTH, _CLASSES = (
    by_code({one: camel(one.name) for one in kind}) for kind in (Reason, Health, FaultClass)
)


def flag_columns(ticks: Ticks) -> tuple[Coded, ...]:
    """The columns behind the drive in `flags.csv`, each (K N,) for K ticks of N drives."""
    drives = ticks.drives.reshape(-1)
    states = drives["flag"]["state"]
    adhesion, thermal = drives["adhesion_reason"], drives["thermal_reason"]
    return (
        Coded(states[:, FlagKind.ADHESION], _ADHESION),
        Coded(states[:, FlagKind.THERMAL], _FAULT),
        Coded(np.where(adhesion, adhesion, thermal), _REASONS),
        Coded(adhesion, _REASONS),
        Coded(thermal, _REASONS),
    )


def estimate_columns(ticks: Ticks) -> tuple[Coded | Column, ...]:
    """The columns behind the drive in `estimates.csv`, each (K N,); NaN: not known."""
    drives, wear = ticks.drives.reshape(-1), ticks.wear.reshape(-1, ticks.wear.shape[2])
    return (
        Coded(drives["health"], _HEALTH), drives["speed_rad_s"], drives["load_nm"],
        drives["load_sigma_nm"], drives["loss_probability"], drives["nis"],
        Coded(drives["fault_class"], _CLASSES), drives["mixed_c"], drives["maisd_k"], *wear.T,
    )  # fmt: skip


class Table:
    """Writes the lines of a table: seconds and node, then its columns."""

    def __init__(self, stream: IO[bytes], header: Sequence[str], nodes: Sequence[int]) -> None:
        """nodes: in the order of the drives in the ticks. Raises OSError."""
        self._stream = stream
        self._nodes = np.array(nodes, np.int32)
        line_bytes = lib.TABLE_MAX_HEAD + len(header) * lib.TABLE_MAX_FIELD
        self._text = ffi.new("uint8_t[]", _LINES * line_bytes)
        stream.write(",".join(header).encode() + b"\n")

    def write_rows(self, t_ns: NDArray[np.int64], columns: Sequence[Coded | Column]) -> None:
        """Write the rows of ticks; number columns use `_DECIMALS` in turn. Raises OSError."""
        decimals = iter(_DECIMALS)
        arrays = [np.ascontiguousarray(one.code if isinstance(one, Coded) else one)
                  for one in columns]  # fmt: skip
        records = ffi.new("struct table_column[]", len(columns))
        for record, column, array in zip(records, columns, arrays, strict=True):
            if isinstance(column, Coded):
                record.code, record.words = pointer("uint8_t", array), _words_of(column.words)
            else:
                record.value, record.decimals = pointer("double", array), next(decimals)
        table = ffi.new("struct table *", (
            pointer("int64_t", t_ns), pointer("int32_t", self._nodes), records, len(self._nodes),
            len(columns),
        ))  # fmt: skip
        row, last, filled = 0, len(t_ns) * len(self._nodes), ffi.new("int64_t *")
        while row < last:
            row = lib.table_write(table, row, last, self._text, len(self._text), filled)
            self._stream.write(ffi.buffer(self._text, filled[0]))
            if row < last and not filled[0]:
                self._stream.write(self._line(t_ns, columns, row))
                row += 1

    def _line(self, t_ns: NDArray[np.int64], columns: Sequence[Coded | Column], row: int) -> bytes:
        """A row with a number that is too long for the core."""
        tick, drive = divmod(row, len(self._nodes))
        seconds, ns = divmod(t_ns.item(tick), 1_000_000_000)
        fields, decimals = [f"{seconds}.{ns:09d}", f"{self._nodes[drive]}"], iter(_DECIMALS)
        for column in columns:
            if isinstance(column, Coded):
                fields.append(column.words[column.code[row]])
            else:
                text = f"{column[row]:.{next(decimals)}f}"
                fields.append("" if text == "nan" else text)
        return ",".join(fields).encode() + b"\n"


@cache
def _kept(words: tuple[str, ...]) -> Any:
    return ffi.new("struct table_word[]", [(word.encode(), len(word)) for word in words])


def _words_of(words: Column) -> Any:
    """The words by code, as an array for the core."""
    return _kept(tuple(words))


class Changes:
    """Changes of the flags of the drives, their first values included."""

    def __init__(self) -> None:
        self.changes: list[Change] = []
        self._last: dict[int, tuple[Flag, Flag]] = {}
        self._before: NDArray[np.int64] | None = None

    def add_view(self, view: GatewayView) -> None:
        """Process one tick."""
        for d in view.drives:
            self.note(view.t_ns, d.node, d.adhesion, d.thermal)

    def follow(self, gateway: Gateway) -> None:
        """Process the tick that a gateway has just done."""
        assert gateway.view is not None
        self.add_view(gateway.view)

    def note(self, t_ns: int, node: int, adhesion: Flag, thermal: Flag) -> None:
        """Process the flags of one drive in a tick."""
        before = self._last.get(node, (None, None))
        self._last[node] = adhesion, thermal
        if adhesion is not before[0]:
            self.changes.append((t_ns, node, "adhesion", ADHESION[adhesion]))
        if thermal is not before[1]:
            self.changes.append((t_ns, node, "thermal", FAULT[thermal]))

    def add_ticks(self, ticks: Ticks, nodes: Sequence[int]) -> None:
        """Process ticks; nodes: in the order of the drives in them."""
        states = ticks.drives["flag"]["state"][:, :, [FlagKind.ADHESION, FlagKind.THERMAL]]
        states = states.astype(np.int64)
        first = np.full_like(states[:1], NEITHER) if self._before is None else self._before
        before = np.concatenate([first, states[:-1]])
        self._before = states[-1:]
        for k, j in np.argwhere((states != before).any(axis=2)).tolist():
            adhesion, thermal = states[k, j].tolist()
            self.note(ticks.t_ns.item(k), nodes[j], Flag(adhesion), Flag(thermal))


class Recorder(AbstractContextManager["Recorder"]):
    """Writes both tables during the run. Context manager.

    The tables get their final names when the context ends; after an exception there are none.
    """

    def __init__(self, folder: Path, nodes: Sequence[int]) -> None:
        """folder: for the tables; nodes: in the order of the drives in the ticks."""
        self.nodes = nodes
        self._files = ExitStack()
        parts = [self._files.enter_context(whole(folder / n)) for n in (FLAGS, ESTIMATES)]
        flags, estimates = (self._files.enter_context(part.open("wb")) for part in parts)
        self._flags = Table(flags, FLAGS_HEADER, nodes)
        self._estimates = Table(estimates, ESTIMATES_HEADER, nodes)

    def add_ticks(self, ticks: Ticks) -> None:
        """Write ticks to both tables."""
        t_ns = np.ascontiguousarray(ticks.t_ns)
        self._flags.write_rows(t_ns, flag_columns(ticks))
        self._estimates.write_rows(t_ns, estimate_columns(ticks))

    def close(self) -> None:
        """Finish the tables. Raises OSError."""
        self._files.close()

    def __exit__(self, *error: Any) -> None:
        """Finish the tables, or remove them after an exception. Raises OSError."""
        self._files.__exit__(*error)
