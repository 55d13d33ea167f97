"""Small DBC files for tests, written as text."""

import re


def signal(name, start, length, sign="+", order=1, rest='(1,0) [0|0] ""'):
    return f" SG_ {name} : {start}|{length}@{order}{sign} {rest} Vector__XXX"


def message(can_id, name, size, *signals):
    return "\n".join([f"BO_ {can_id} {name}: {size} Vector__XXX", *signals, ""])


def write(path, *parts):
    """A file of these parts behind the usual head."""
    path.write_text("\n".join(['VERSION ""', "", "BS_:", "", "BU_: A", "", *parts, ""]))
    return path


def of_layout(path, layout):
    """A file with the one signal `S` in the one message `M` (id 1)."""
    rest = f'({layout.scale!r},{layout.offset!r}) [0|0] "u"'
    sign, order = "-" if layout.is_signed else "+", 0 if layout.is_big_endian else 1
    parts = [
        message(1, "M", layout.size, signal("S", layout.start, layout.length, sign, order, rest))
    ]
    if layout.is_float:
        parts.append(f"SIG_VALTYPE_ 1 S : {layout.length // 32};")
    return write(path, *parts)


def without(text, name):
    """The DBC text without one message and everything said about its id."""
    can_id = re.search(rf"^BO_ (\d+) {name}:", text, re.MULTILINE)[1]
    text = re.sub(rf"^BO_ {can_id} .*\n(?: SG_ .*\n)+\n", "", text, flags=re.MULTILINE)
    return "".join(
        line
        for line in text.splitlines(True)
        if not re.search(rf"\b(BO_|SG_|VAL_) {can_id} ", line)
    )


def with_cycles(dbc, path, cycles):
    """A copy of a DBC in which the messages with these identifiers have other cycle times, ms."""
    text = dbc.read_text(encoding="cp1252")
    for can_id, ms in cycles.items():
        text, count = re.subn(rf'(BA_ "GenMsgCycleTime" BO_ {can_id}) \d+;', rf"\g<1> {ms};", text)
        assert count == 1
    path.write_text(text, encoding="cp1252")
    return path
