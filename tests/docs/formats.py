"""What each format of frames keeps, found by writing and reading: the table in docs/files.md.

`python -m tests.docs.formats` writes it anew.
"""

import re
import tempfile
from itertools import pairwise
from pathlib import Path
from typing import Final

from dbc.frame import BRS, ERROR, ESI, EXTENDED, FD, REMOTE, TX, Frame
from dbc.frames import block_of
from gateway.logfiles.convert import frame_sink, open_input

PAGE: Final = Path(__file__).parents[2] / "docs" / "files.md"
MARK: Final = "<!-- made by python -m tests.docs.formats -->"
T0: Final = 1_700_000_000_123_456_789
ENDINGS: Final = (".log", ".log.gz", ".parquet", ".mf4", ".blf", ".asc", ".trc", ".csv")
PARTS: Final = {
    "data, 11 and 29 bits": [Frame(0, 0x181, b"\1\2"), Frame(0, 0x18FEF100, b"\3" * 8, EXTENDED)],
    "remote": [Frame(0, 0x182, b"", REMOTE, "", 4), Frame(0, 0x183, b"", REMOTE)],
    "error": [Frame(0, 0x4, bytes(8), ERROR), Frame(0, 0, b"", ERROR)],
    "FD with BRS and ESI": [
        Frame(0, 0x184, b"\4" * 64, FD | flags) for flags in (0, BRS, ESI, BRS | ESI)
    ] + [Frame(0, 0x185, b"", FD | BRS), Frame(0, 0x186, b"\5" * 12, FD | EXTENDED)],
    "raw DLC 9 to 15": [
        Frame(0, 0x187, b"\6" * 8, 0, "", 15), Frame(0, 0x188, b"\7" * 8, 0, "", 9),
    ],
    "Tx": [
        Frame(0, 0x189, b"\1", TX), Frame(0, 0x18FEF100, b"\2", EXTENDED | TX),
        Frame(0, 0x18A, b"\3", 0), Frame(0, 0x18B, b"", REMOTE | TX, "", 2),
    ],
    "Tx, FD": [Frame(0, 0x18C, b"\4" * 12, FD | TX), Frame(0, 0x18D, b"\5" * 12, FD)],
    "Tx, error": [Frame(0, 0, b"", ERROR | TX), Frame(0, 0, b"", ERROR)],
}  # fmt: skip


def there_and_back(kind, frames):
    """The frames as a file of this ending gives them back, and what was counted when writing."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / f"x{kind}"
        sink = frame_sink(path, kind)
        try:
            sink.add(block_of(frames))
        finally:
            sink.close()
        counted = {**sink.left_out, **sink.reduced}
        if not sink.written:
            return [], counted
        found = [f for block in open_input(path, strict=True).blocks for f in block.frames()]
    return found, {what: n for what, n in counted.items() if n}


def kept(kind, part):
    """yes, or what was counted."""
    frames = [
        f._replace(t_ns=T0 + k * 1_000_000, channel="can0") for k, f in enumerate(PARTS[part])
    ]
    found, counted = there_and_back(kind, frames)
    same = [(f.can_id, f.data, f.flags, f.dlc) for f in frames]
    if [(f.can_id, f.data, f.flags, f.dlc) for f in found] == same:
        return "yes"
    counted.pop("channel", None)
    assert counted, f"{kind}: {part}: something is lost without a count: {found}"
    lost = ", ".join(f"`{what}`" for what in sorted(counted))
    return f"no: {lost}" if not found else f"without {lost}"


def times(kind):
    """Largest error, and whether the first time is kept."""
    frames = [Frame(T0 + k * 1_234_567, 0x181, b"", 0, "can0") for k in range(200)]
    found, _ = there_and_back(kind, frames)
    steps = [
        abs((b.t_ns - found[0].t_ns) - (a.t_ns - T0)) for a, b in zip(frames, found, strict=True)
    ]
    first = abs(found[0].t_ns - T0)
    assert all(b.t_ns >= a.t_ns for a, b in pairwise(found))
    exact = "exact" if not max(steps) else f"to {max(steps)} ns"
    if found[0].t_ns == 0:
        return f"{exact}, starts at 0"
    return exact if first <= max(steps) else f"{exact}, the first {first} ns"


def channels(kind):
    """name, number or none."""
    frames = [Frame(T0 + k, 0x181, b"", 0, name) for k, name in enumerate(("vcan1", "can2"))]
    found, counted = there_and_back(kind, frames)
    names = [f.channel for f in found]
    if names == ["vcan1", "can2"]:
        return "name"
    if names == ["1", "2"]:
        return "number"
    assert counted["channel"] == len(frames)
    return "none: `channel`"


def table():
    """A row for each ending."""
    heads = ["ending", *PARTS, "time", "channel"]
    lines = [f"| {' | '.join(heads)} |", "|" + "---|" * len(heads)]
    for kind in ENDINGS:
        cells = [f"`{kind}`", *(kept(kind, part) for part in PARTS), times(kind), channels(kind)]
        lines.append(f"| {' | '.join(cells)} |")
    return "\n".join(lines)


def main():
    """Write the table into the page."""
    text = PAGE.read_text(encoding="utf-8")
    made = f"{MARK}\n{table()}\n{MARK}"
    PAGE.write_text(re.sub(f"{MARK}.*{MARK}", lambda _: made, text, flags=re.DOTALL), "utf-8")


if __name__ == "__main__":
    main()
