"""All Hypothesis strategies of the project, by area."""

from typing import NamedTuple

from hypothesis import strategies as st

from dbc.frame import BRS, ERROR, ESI, EXTENDED, FD, FD_LENGTHS, REMOTE, Frame

# ---- dbc: frames and log lines -----------------------------------------------------------------

MAX_NS = 9_000_000_000 * 1_000_000_000 - 1


def stamps():
    """Nanoseconds a candump line can hold, whole microseconds included on purpose."""
    micros = st.integers(0, MAX_NS // 1000).map(lambda us: 1000 * us)
    return micros | st.integers(0, MAX_NS)


def channels():
    """Interface names as candump writes them."""
    usual = st.sampled_from(["can0", "vcan0", "can1", "slcan0"])
    odd = st.text(
        st.characters(min_codepoint=0x21, exclude_characters="\x7f", exclude_categories=["Cs"]),
        min_size=1,
        max_size=8,
    )
    return usual | odd.filter(lambda name: 1 <= len(name.encode()) <= 21)


@st.composite
def frames(draw):
    """Any frame a candump log can say."""
    kind = draw(st.sampled_from(["classic", "raw", "fd", "remote", "error"]))
    extended = kind != "error" and draw(st.booleans())
    can_id = draw(st.integers(0, 0x1FFFFFFF if extended or kind == "error" else 0x7FF))
    flags = EXTENDED if extended else 0
    data, dlc = b"", -1
    if kind == "remote":
        flags |= REMOTE
        dlc = draw(st.sampled_from([-1, *range(1, 16)]))
    elif kind == "fd":
        flags |= FD | draw(st.sampled_from([0, BRS, ESI, BRS | ESI]))
        size = draw(st.sampled_from(sorted(FD_LENGTHS)))
        data = draw(st.binary(min_size=size, max_size=size))
    elif kind == "raw":
        data = draw(st.binary(min_size=8, max_size=8))
        dlc = draw(st.integers(9, 15))
    else:
        flags |= ERROR if kind == "error" else 0
        data = draw(st.binary(max_size=8))
    return Frame(draw(stamps()), can_id, data, flags, draw(channels()), dlc)


def log_lines():
    """Bytes of all kinds, with pieces of the grammar thrown in so that deep branches are met."""
    words = b"( ) . # ## _ R8 123 20000040 0 (1.000000) (1.000000000) DROPCOUNT: 45123#81:00:"
    piece = st.sampled_from([*words.split(), b" can0 ", b" ", b"\r", b"\0", b"\n"])
    return st.lists(piece | st.binary(max_size=4), max_size=12).map(b"".join)


# ---- dbc: signals ------------------------------------------------------------------------------


class Layout(NamedTuple):
    """One signal in one message of `size` bytes, as a DBC writes it."""

    size: int
    start: int
    length: int
    is_signed: bool
    is_big_endian: bool
    is_float: bool
    scale: float
    offset: float


@st.composite
def layouts(draw):
    """A signal anywhere in a message, any byte order and width."""
    size = draw(st.sampled_from(sorted(FD_LENGTHS - {0})))
    is_float = size >= 4 and draw(st.integers(0, 4)) == 0
    widest = min(64, 8 * size)
    length = draw(
        st.sampled_from([32, 64][: 1 + (size >= 8)]) if is_float else st.integers(1, widest)
    )
    first = draw(st.integers(0, 8 * size - length))
    big = draw(st.booleans())
    # `first` counts along the signal's own order; a DBC names the bit where it begins.
    start = 8 * (first >> 3) + 7 - (first & 7) if big else first
    scale = draw(st.sampled_from([1, 0.1, 0.5, 2, -0.01, 0.001, 3.7e-3]))
    offset = draw(st.sampled_from([0, -60, 250, 0.125]))
    signed = is_float or draw(st.booleans())
    return Layout(size, start, length, signed, big, is_float, scale, offset)


# ---- dbc: protection ---------------------------------------------------------------------------


# ---- estimators: motors, filter states, samples ------------------------------------------------


# ---- sim: wheel and rail -----------------------------------------------------------------------


def contacts():
    """Rail condition, train speed m/s, sliding speed m/s, wheel load times radius Nm."""
    return st.tuples(
        st.sampled_from(["dry", "wet", "leaves"]),
        st.floats(-30.0, 30.0),
        st.floats(-20.0, 20.0),
        st.floats(1.0, 500.0),
    )
