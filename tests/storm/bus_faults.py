"""What a bus does to frames between the drives and the gateway, on purpose and by seed.

`HostileBus.carry` takes the frames that the drives sent in a tick and gives those that arrive. Like
everything in `sim` it is pure: faults come from a plan, chance from the seed, time from the caller.
Besides the frames it tells which of them are genuine: sent by a drive, whole, and not a copy; a
copy that is whole, of a frame that was spoilt, is as good as that. A frame with wrong values
(`value_faults`) is genuine, too.
"""

from collections.abc import Callable
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from dbc.frame import ERROR, EXTENDED, FD, MS, REMOTE, SECOND, Nanos
from dbc.frames import EMPTY, Block, blank, join
from tests.storm.value_faults import VALUE_KINDS

Flags = NDArray[np.bool_]

BUS_KINDS: Final = (
    "drop", "duplicate", "reorder", "delay", "corrupt", "second_sender", "flood", "bus_off",
    "link_loss", "clock_step", "process_stop", "restart",
)  # fmt: skip
"""`process_stop` and `restart` happen to the gateway; who runs it has to do them."""
KINDS: Final = (*BUS_KINDS, *VALUE_KINDS)
"""What a bus does to frames, and what a drive does to the values in them."""
WHOLE_BUS: Final = ("flood", "bus_off", "link_loss", "clock_step", "process_stop", "restart")
"""Kinds that hit every drive."""
_PLAN, _CHANCE = 1, 2
"""Purposes of the random streams."""
HOUR_NS: Final[Nanos] = 3600 * SECOND
LONGEST_REORDER_NS: Final[Nanos] = 20 * MS
LONGEST_DELAY_NS: Final[Nanos] = 200 * MS
HIGHEST_SHORT: Final = 0x7FF
COPY_NS: Final[Nanos] = 100_000
"""A duplicate comes so much later."""
FLOOD_FRAMES: Final = 200
"""In a tick of 10 ms: nearly all that 1 Mbit/s carries."""
BURST_ERRORS: Final = 5
"""Error frames that a link says before it goes."""


class Fault(NamedTuple):
    """One fault in the ticks first .. last - 1. drive: from 0, None for all; amount: 0..1."""

    kind: str
    first: int
    last: int
    drive: int | None
    amount: float


class Arrived(NamedTuple):
    """The frames that arrive in a tick, in order of time, and which of them are genuine."""

    block: Block
    genuine: Flags


NOTHING: Final = Arrived(EMPTY, np.zeros(0, dtype=np.bool_))


def plan(seed, ticks, drives, between=350.0, kinds=BUS_KINDS):
    """Random faults of these kinds, in order of time; `between`: mean ticks from one to the next.

    They last 1 to 1000 ticks, short ones as often as long ones, and may overlap. A kind that is
    added to `kinds` changes what a seed brings. Wrong values are always one drive's.
    """
    rng = np.random.default_rng([seed, _PLAN])
    out = []
    at = 0.0
    while (at := at + rng.exponential(between)) < ticks:
        kind = kinds[int(rng.integers(len(kinds)))]
        last = round(at + 10.0 ** rng.uniform(0.0, 3.0)) + 1
        drive = int(rng.integers(drives)) if rng.random() < 0.8 and kind not in WHOLE_BUS else None
        if kind in VALUE_KINDS and drive is None:
            drive = int(rng.integers(drives))
        # The edges matter as much as what lies between them.
        amount = float(rng.choice([0.02, 0.5, 1.0, rng.random()]))
        out.append(Fault(kind, int(at), last, drive, amount))
    return out


class HostileBus:
    """Carries the frames of one tick after the other; what is late is kept for later ticks."""

    def __init__(self, faults, ids, seed, values=None):
        """faults: in order of time; ids: identifiers of each drive's frames.

        values: who makes values wrong; without, faults of these kinds do nothing.
        """
        self._values = values
        self._coming = list(faults)[::-1]
        self._active = []
        self._ids = [np.array(sorted(each), dtype=np.uint32) for each in ids]
        self._all = np.concatenate(self._ids)
        self._rng = np.random.default_rng([seed, _CHANCE])
        self._late = NOTHING

    def active(self, tick):
        """Faults of this tick; to be asked of every tick in turn."""
        while self._coming and self._coming[-1].first <= tick:
            self._active.append(self._coming.pop())
        if self._active:
            self._active = [fault for fault in self._active if fault.last > tick]
        return self._active

    def carry(self, sent, other, tick, now):
        """What arrives by `now` of what the drives have sent since the tick before.

        other: gives frames of the same drives at some other time, for a second sender.
        """
        faults = self.active(tick)
        if self._values is not None:
            wrong = [(f.kind, f.drive) for f in faults if f.drive is not None]
            sent = self._values.apply(wrong, sent)
        came = Arrived(sent, np.ones(sent.size, dtype=np.bool_))
        if not faults and not self._late.block.size:
            return came
        stepped = False
        for fault in sorted(faults, key=lambda fault: _ORDER[fault.kind]):
            if stepped:
                break  # there is one clock
            ids = self._all if fault.drive is None else self._ids[fault.drive]
            if fault.kind == "second_sender":
                came = _both(came, _second(other(), ids, fault, now))
            elif fault.kind in _ACTS:
                mine = _among(came.block.can_id, ids)
                came = _ACTS[fault.kind](self._rng, came, Hit(fault, mine, ids, tick, now))
            stepped |= fault.kind == "clock_step"
        came = _both(self._late, came)
        due = came.block.t_ns <= now
        # Nobody waits for the time that a wrong clock tells.
        due |= stepped
        self._late = NOTHING
        if not due.all():
            self._late, came = _pick(came, ~due), _pick(came, due)
        return _pick(came, np.lexsort((came.block.can_id, came.block.t_ns)))


class Hit(NamedTuple):
    """A fault in one tick. mine: which of the frames are its drives'; ids: identifiers of these."""

    fault: Fault
    mine: Flags
    ids: NDArray[np.uint32]
    tick: int
    now: Nanos

    def some(self, rng):
        """Of its drives' frames those that chance picks."""
        return self.mine & (rng.random(len(self.mine)) < self.fault.amount)


def _drop(rng, came, hit):
    return _pick(came, ~hit.some(rng))


def _duplicate(rng, came, hit):
    copies = came.block.pick(hit.some(rng))
    copies = copies._replace(t_ns=np.minimum(copies.t_ns + COPY_NS, hit.now))
    return _both(came, _forged(copies))


def _reorder(rng, came, hit):
    by = rng.integers(0, LONGEST_REORDER_NS, len(hit.mine))
    return _later(came, np.where(hit.some(rng), by, 0))


def _delay(_rng, came, hit):
    return _later(came, np.where(hit.mine, round(2 * MS + hit.fault.amount * LONGEST_DELAY_NS), 0))


def _corrupt(rng, came, hit):
    some = hit.some(rng)
    block = came.block.pick(np.arange(came.block.size))
    for k in np.flatnonzero(some).tolist():
        _damage(rng, block, k)
    return Arrived(block, (came.genuine | _instead(came, some)) & ~some)


def _instead(came, spoilt):
    """The copies of genuine frames that are spoilt."""
    block, out = came.block, np.zeros(len(spoilt), dtype=np.bool_)
    for k in np.flatnonzero(spoilt & came.genuine).tolist():
        same = (block.can_id == block.can_id[k]) & (block.flags == block.flags[k])
        out |= same & (block.data == block.data[k]).all(axis=1) & ~came.genuine
    return out


def _damage(rng, block, k):
    """Flip one to three bits, or else make it a frame of another length or kind."""
    length, how = int(block.length[k]), rng.integers(10)
    if how < 8 and length:
        count = min(int(rng.integers(1, 4)), 8 * length)
        for bit in rng.choice(8 * length, size=count, replace=False).tolist():
            block.data[k, bit >> 3] ^= 1 << (bit & 7)
    elif how == 8 and length:
        block.length[k] = length - 1
        block.data[k, length - 1] = 0
    else:
        block.flags[k] ^= int(rng.choice([EXTENDED, REMOTE, ERROR, FD]))


def _flood(rng, came, hit):
    many = blank(FLOOD_FRAMES, ["flood"])
    many.t_ns[:] = np.sort(rng.integers(hit.now - 10 * MS + 1, hit.now + 1, FLOOD_FRAMES))
    anything = rng.integers(0, 1 << 29, FLOOD_FRAMES)
    many.can_id[:] = np.where(rng.random(FLOOD_FRAMES) < 0.5, 0, anything)
    many.flags[:] = np.where(many.can_id > HIGHEST_SHORT, EXTENDED, 0)
    many.length[:] = rng.integers(0, 9, FLOOD_FRAMES)
    many.data[:] = 0
    # A short identifier of a drive would be a second sender.
    foreign = ~_among(many.can_id, hit.ids) | (many.flags == EXTENDED)
    return _both(came, _forged(many.pick(foreign)))


def _gone(rng, _came, hit):
    if hit.fault.kind == "bus_off" or hit.tick > hit.fault.first:
        return NOTHING
    errors = blank(BURST_ERRORS, ["error"])
    errors.t_ns[:] = hit.now
    errors.can_id[:] = rng.integers(1, 0x200, BURST_ERRORS)
    errors.flags[:] = ERROR
    errors.length[:] = 8
    errors.data[:] = 0
    errors.data[:, :8] = rng.integers(0, 256, (BURST_ERRORS, 8))
    return _forged(errors)


def _stepped(_rng, came, hit):
    by = HOUR_NS if hit.fault.amount >= 0.5 else -HOUR_NS
    return _forged(came.block._replace(t_ns=came.block.t_ns + by))


def _second(other, ids, fault, now):
    """The same drives once more, with counters of their own, between the genuine frames."""
    others = other.pick(_among(other.can_id, ids))
    shift = round(fault.amount * MS)
    return _forged(others._replace(t_ns=np.minimum(others.t_ns + shift, now)))


Act = Callable[[np.random.Generator, Arrived, Hit], Arrived]
_ACTS: Final[dict[str, Act]] = {
    "drop": _drop, "duplicate": _duplicate, "reorder": _reorder, "delay": _delay,
    "corrupt": _corrupt, "flood": _flood, "bus_off": _gone, "link_loss": _gone,
    "clock_step": _stepped,
}  # fmt: skip
_ORDER: Final = {kind: k for k, kind in enumerate(("second_sender", *_ACTS))} | dict.fromkeys(
    ("process_stop", "restart", *VALUE_KINDS), 0
)
"""Who speaks, what becomes of it on the way, and what the receiver's clock says of it."""


def _forged(block):
    return Arrived(block, np.zeros(block.size, dtype=np.bool_))


def _among(can_id, ids):
    """`numpy.isin` for a few: it sorts, which is a quarter of the cost of a storm."""
    return (can_id[:, None] == ids).any(axis=1)


def _pick(came, which):
    return Arrived(came.block.pick(which), came.genuine[which])


def _both(first, second):
    return Arrived(join(first.block, second.block), np.concatenate([first.genuine, second.genuine]))


def _later(came, by_ns):
    return came._replace(block=came.block._replace(t_ns=came.block.t_ns + by_ns))
