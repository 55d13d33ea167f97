"""Which lines of a log dbc/candump_read.c reads itself, and what it says of the others.

The oracle is a regular expression for the grammar of its first comment. All other tests of candump
read such lines as well, but a line that it leaves to `grammar.parse_line` gives the same frame.
"""

import random
import re

import numpy as np
import pytest
from _traction_core import lib

from dbc.candump.blocks import LineKind
from dbc.frame import BRS, ESI, FD, TX
from dbc.frames import blank
from dbc.records import INTERFACE_NAME, pointer, zeros

LINE = re.compile(
    rb"\((\d{1,10})\.(\d{6}|\d{9})\) {1,21}([^\0- \x7f]{1,21}) {1,21}([0-7][\da-fA-F]{2})"
    rb"#(?:#([\da-fA-F]))?((?:[\da-fA-F]{2})*)(?: ([RT]))?\r?"
)
FD_LENGTHS = {*range(9), 12, 16, 20, 24, 32, 48, 64}
SHORTEST = 17
"""Characters of the shortest line that can have a frame."""


def expected(line):
    """(kind, frame or None) of a line; frame: ns, id, flags, data, name."""
    found = LINE.fullmatch(line)
    if found:
        seconds, fraction, name, can_id, flags, digits, direction = found.groups()
        data, bits = bytes.fromhex(digits.decode()), int(flags or b"0", 16)
        fits = len(data) in FD_LENGTHS and (flags or len(data) <= 8)
        if fits and int(seconds) < 9_000_000_000:
            own = (FD if flags else 0) | BRS * (bits & 1) | ESI * (bits >> 1 & 1)
            own |= TX if direction == b"T" else 0
            t_ns = int(seconds) * 10**9 + int(fraction.ljust(9, b"0"))
            kind = LineKind.FD if flags else LineKind.CLASSIC
            return kind, (t_ns, int(can_id, 16), own, data, name)
    line = line.removesuffix(b"\r")
    if not line.strip(b" \t"):
        return LineKind.BLANK, None
    if line.startswith((b"#", b";", b"//")):
        return LineKind.COMMENT, None
    known = line.startswith((b"(", b"D")) and len(line) >= SHORTEST
    return LineKind.OTHER if known else LineKind.MALFORMED, None


def read(text, size=None, rows=4096):
    """(kind, frame or None) of every complete line in the first `size` bytes."""
    block = blank(rows, [])
    for column in (block.data, block.flags, block.length):
        column.view(np.uint8)[...] = 0xAA
    names = zeros(lib.CANDUMP_NAMES, INTERFACE_NAME)
    kind, places = np.empty(rows, np.uint8), np.empty(rows + 1, np.int64)
    n = lib.candump_read(
        text, 0, len(text) if size is None else size, rows, block.columns(),
        pointer("struct interface_name", names), pointer("uint8_t", kind),
        pointer("int64_t", places),
    )  # fmt: skip
    out = []
    for k in range(n):
        frame = None
        if kind[k] in (LineKind.CLASSIC, LineKind.FD):
            length, own = block.length[k].item(), names[block.channel[k]]
            assert not block.data[k, length:].any()
            frame = (
                block.t_ns[k].item(), block.can_id[k].item(), block.flags[k].item(),
                block.data[k, :length].tobytes(), own.text[: own.length].tobytes(),
            )  # fmt: skip
        out.append((LineKind(kind[k]), frame))
    return out


def usual(rng):
    """A line, some of its parts on or beyond their limits."""
    seconds = rng.choice([0, 7, 1_700_000_000, 8_999_999_999, 9_000_000_000, 12_345_678_901])
    fraction = "".join(rng.choices("0123456789", k=rng.choice([5, 6, 6, 6, 8, 9, 9, 10])))
    gaps = [" " * rng.choice([1, 1, 1, 2, 21, 22]) for _ in range(2)]
    name = "".join(rng.choices("vcan0_-#é", k=rng.choice([1, 4, 5, 5, 21, 22])))
    can_id = rng.choice(["000", "123", "7fF", "7FF", "800", "12", "1234"])
    flags = rng.choice(["", "", "#0", "#3", "#f", "#g", "#"])
    count = rng.choice([0, 1, 7, 8, 9, 12, 13, 48, 63, 64, 65])
    digits = "".join(rng.choices("0123456789abcdefABCDEF", k=2 * count + rng.choice([0, 0, 0, 1])))
    end = rng.choice(["", "", "", " R", " T", " X", "\r", " R\r", " T\r", "  ", " "])
    return f"({seconds}.{fraction}){gaps[0]}{name}{gaps[1]}{can_id}#{flags}{digits}{end}".encode()


def damaged(rng, line):
    """One character more, less, or another one."""
    at, new = rng.randrange(len(line)), bytes([rng.choice(b"0:/#;@GgDRT() .\t\r\x7f\x1f\xff\0")])
    return line[:at] + rng.choice([new, b"", new + line[at : at + 1]]) + line[at + 1 :]


ODD = [
    b"", b" ", b" \t\r", b"#", b"# x", b"; x", b"// x", b"/", b"/ x", b"x", b"/x/", b"(", b"D",
    b"DROPCOUNT: 1 dro", b"DROPCOUNT: 1 drop", b"(0.000000) a 123#", b"(0.000000) a 12#",
    b"(0.000000) a 12#\r", b"0.000000) a 123#00", b"X0.000000) a 123#00", b"(0:000000) a 123#00",
    b"(.000000) a 123#00", b"(0.000000] a 123#00", b"(0.0000000) a 123#0011",
]  # fmt: skip


@pytest.mark.parametrize("seed", range(20))
def test_it_reads_what_its_grammar_says_and_no_other_line(seed):
    rng = random.Random(seed)
    lines = [usual(rng) for _ in range(300)]
    lines += [damaged(rng, usual(rng)) for _ in range(600)] + ODD
    rng.shuffle(lines)
    lines = [line for line in lines if b"\n" not in line]
    assert read(b"\n".join(lines) + b"\n") == [expected(line) for line in lines]


def test_nothing_at_or_after_the_end_is_read():
    text = b"(1.000000) can0 123#1122 R\r\n(1.000000) can0 123##100\n"
    first = text.index(b"\n") + 1
    for size in range(len(text) + 1):
        whole = 2 if size == len(text) else size // first
        assert len(read(text, size)) == whole, size


def test_no_more_lines_are_read_than_there_are_rows():
    line = b"(1.000000) can0 123#11\n"
    assert len(read(9 * line, rows=4)) == 4
