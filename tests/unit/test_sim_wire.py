from itertools import pairwise

import pytest

from dbc.frame import BRS, FD, Frame
from sim.bus_arbiter import Arbiter, bits, duration_ns

MBIT = (1_000_000, 5_000_000)


def frame(t_ns, can_id, length=8, flags=0):
    return Frame(t_ns, can_id, bytes(length), flags)


def test_frame_times_lie_between_no_stuffing_and_the_worst_case():
    for length in range(9):
        plain = 47 + 8 * length
        assert plain <= bits(length) <= plain + (33 + 8 * length) // 4
    assert duration_ns(8, 0, *MBIT) == bits(8) * 1000
    assert 100_000 < duration_ns(64, FD | BRS, *MBIT) < 220_000


def test_lowest_identifier_first_and_stamps_at_the_end():
    bus = Arbiter(*MBIT)
    bus.offer([frame(0, 0x300), frame(0, 0x100), frame(0, 0x200)])
    out = bus.drain(10_000_000)
    assert [f.can_id for f in out] == [0x100, 0x200, 0x300]
    took = bits(8) * 1000
    assert [f.t_ns for f in out] == [took, 2 * took, 3 * took]


def test_a_frame_on_the_wire_is_not_pre_empted():
    bus = Arbiter(*MBIT)
    bus.offer([frame(0, 0x300), frame(1000, 0x100)])
    assert [f.can_id for f in bus.drain(10_000_000)] == [0x300, 0x100]


def test_an_identifier_has_one_mailbox():
    bus = Arbiter(*MBIT)
    bus.offer([frame(0, 0x001), frame(10, 0x200, 1), frame(20, 0x200, 2)])
    out = bus.drain(10_000_000)
    assert [(f.can_id, len(f.data)) for f in out] == [(0x001, 8), (0x200, 2)]
    assert bus.overwritten == 1


@pytest.mark.parametrize("step", [7_000, 50_000, 1_000_000, 30_000_000])
def test_how_time_is_cut_changes_nothing(step):
    offers = [
        frame(k * 37_000 % 900_000 + (k // 25) * 1_000_000, 0x100 + k % 13) for k in range(90)
    ]
    whole = Arbiter(*MBIT)
    whole.offer(offers)
    expected = whole.drain(40_000_000)
    cut, out, done = Arbiter(*MBIT), [], 0
    for now in range(step, 40_000_000 + step, step):
        cut.offer([f for f in offers if done < f.t_ns + 1 <= now + 1])
        done = now + 1
        got = cut.drain(now)
        assert all(f.t_ns <= now for f in got)
        out += got
    assert out == expected
    assert all(a.t_ns < b.t_ns for a, b in pairwise(out))


def test_a_bus_without_bit_rate_delivers_at_once():
    bus = Arbiter(0, 1)
    bus.offer([frame(5, 0x300), frame(5, 0x100), frame(9, 0x050)])
    assert [(f.t_ns, f.can_id) for f in bus.drain(8)] == [(5, 0x100), (5, 0x300)]
    assert [f.can_id for f in bus.drain(9)] == [0x050]
