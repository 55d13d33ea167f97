"""`text_read` against a regular expression: which lines of a log are plain, and what they say."""

import re

import pytest
from hypothesis import given
from hypothesis import strategies as st

from dbc.logs.format import Head
from dbc.logs.lines import ROWS, Scanner, shape_of

SECOND, MS, LATEST_NS = 10**9, 10**6, 4 * 10**18
WORD = rb"[\x21-\xff]++"
PLAIN = re.compile(
    rb"[ \t]*+" + WORD + rb"[ \t]*+(\d{1,12})(?:\.(\d{0,9}))?(?=[ \t])[ \t]*+"
    rb"(" + WORD + rb"[ \t]++" + WORD + rb")((?:[ \t]++[0-9a-fA-F]{2}(?![\x21-\xff])){0,64})"
)
MOST_HEAD = 63


def expected(line, unit_ns):
    """Time, head and data of a plain line."""
    found = PLAIN.match(line)
    if not found or len(found[3]) > MOST_HEAD or found[3].split()[1] != b"d":
        return None
    part = (found[2] or b"").ljust(9, b"0")
    if int(found[1]) > LATEST_NS // unit_ns or int(part) * unit_ns % SECOND:
        return None
    t_ns = int(found[1]) * unit_ns + int(part) * unit_ns // SECOND
    return t_ns, found[3], bytes.fromhex(found[4].decode())


def read(lines, unit_ns):
    """What the core says of the same lines; every length of data is taken for the head's."""
    found = []
    for line in lines:
        heads = []
        wanted = expected(line, unit_ns)

        def learn(head, _, heads=heads, wanted=wanted):
            heads.append(head.encode("latin-1"))
            size = len(wanted[2]) if isinstance(wanted, tuple) else 0
            return Head(1, 0, size)

        shape = shape_of(unit_ns, 1, 2, "d", 1)
        scan = Scanner(learn).scan(line + b"\n", 0, shape)
        assert scan.start.tolist() == [0, len(line) + 1]
        if not heads:
            found.append(None)
            continue
        assert scan.plain.all()
        size = scan.rows.length.item()
        found.append((scan.rows.t_ns.item(), heads[0], scan.rows.data[0, :size].tobytes()))
    return found


@pytest.mark.parametrize("unit_ns", [SECOND, MS])
@pytest.mark.parametrize("line", [
    b"x 1.5 123 d 01 Fe\t9a", b"  x\t7 1 d", b"x 1. 1 d 00", b"x 0.123456789 1 d 01",
    b"x 0.1234567890 1 d 01", b"x 999999999999 1 d", b"x 9999999999999 1 d", b"x 4000000001 1 d",
    b"x 4000000000 1 d", b"x .5 1 d", b"x 1.5", b"x 1.5x 1 d", b"x 1.5 1", b"x 1.5 1 e 01", b"",
    b"x 1.5 1 dd 01", b"x", b"x 1.5 1 d 0", b"x 1.5 1 d 01 0", b"x 1.5 1 d 0g", b"x 1.5 1 d g0",
    b"x 1.5 1 d 012", b"x 1.5 1 d 01 02 ", b"x 1.5 1 d 01\x01", b"x 1.5 1 d" + 64 * b" ab",
    b"x 1.5 1 d" + 65 * b" ab", b"x 1.5 " + 61 * b"1" + b" d 01", b"x 1.5 " + 62 * b"1" + b" d 01",
    b"x 1:5 1 d", b"x 1/5 1 d", b"x 1.5 1 d 0: 0@", b"x 0.0000001 1 d", b"x 0.0000000 1 d", b"x 1.",
    b"x 1", b"x 1 ", b"\x01x 1 1 d", b"x 1.5 1 d -1",
    b"x 99999999999999 1 d", b"x 0.12345678901 1 d",
])  # fmt: skip
def test_lines(line, unit_ns):
    assert read([line], unit_ns) == [expected(line, unit_ns)]


@given(
    st.lists(st.lists(st.sampled_from([
        b"x", b" ", b"\t", b"1", b"1.5", b".", b"d", b" d ", b"0a", b" 0a", b" FF", b"\r", b"g",
    ]), max_size=14).map(b"".join), max_size=4)
)  # fmt: skip
def test_any_line(lines):
    assert read(lines, SECOND) == [expected(line, SECOND) for line in lines]


def test_more_heads_than_the_table_holds():
    """Heads beyond it are left to Python, the others are found again."""
    met = []

    def learn(head, line):
        assert line == f"1 {head}\n"
        met.append(head)
        return Head(1, 0, 0)

    scanner, shape = Scanner(learn), shape_of(SECOND, 0, 2, "", -1)
    text = b"".join(b"1 %x d\n" % k for k in range(8000))
    first = scanner.scan(text, 0, shape)
    assert 3000 < first.plain.sum() == len(met) == len(set(met)) <= 4096
    again = scanner.scan(text, 0, shape)
    assert (again.plain == first.plain).all()
    assert len(met) == first.plain.sum()


@pytest.mark.parametrize(("head_words", "line"), [(0, b"1 01 02\n"), (2, b"1 a\n")])
def test_a_line_without_its_head_is_not_plain(head_words, line):
    shape = shape_of(SECOND, 0, head_words, "", -1)
    anything = Scanner(lambda _, __: Head(1, 0, 0))
    assert not anything.scan(line, 0, shape).plain.any()


def test_a_line_that_does_not_end_waits_and_a_scan_has_an_end():
    shape = shape_of(SECOND, 0, 1, "", -1)
    line = b"1 a\n"
    scan = Scanner(lambda _, __: None).scan(line + b"2 b", 0, shape)
    assert scan.start.tolist() == [0, 4]
    assert not scan.plain.any()
    scan = Scanner(lambda _, __: None).scan(line * (ROWS + 1), 4, shape)
    assert len(scan.plain) == ROWS
    assert scan.start[-1] == 4 * (ROWS + 1)
    assert len(Scanner(lambda _, __: None).scan(line, 4, shape).plain) == 0
