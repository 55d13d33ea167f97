"""Who watches the gateway in the storm: bytes on the wire against what really arrived.

Keeps its own books (stamps of genuine frames, flags as last read from the wire) and uses neither
the gateway's codec nor its counters. What was last read is what a receiver believes, so it is
judged in every tick, whether or not a frame went out in it. Rules, by name:

- stale: no flag says good when the newest genuine frame it rests on is older than its limit;
  no estimate says tracking without fresh samples
- untracked: `Adhering` only from a drive whose estimate says tracking and is near the true speed;
  no `EstimatorFault` only while all say so
- cleared: unknown never clears bad, and good needs its time of good frames
- hasty: the first good after a start needs its time of good frames
- overrun: said in the tick after missed ones and for a second, and only then
- lost: `Adhering` of no drive for five ticks after frames were lost unread
- form: every frame sent is whole: counter, states 0 to 2, nothing but our identifiers; flags have
  their checksum
- masquerade: `Adhering` from no drive that two senders speak for, nor in the second after
- wrong_values, false_loss, others, creep: see `tests.storm.values`

`SensorFault`, `CommFault` and `EstimatorFault` speak for all drives and name none: bad goes when
one drive at least has had its time, good comes when all have.

A second sender that is heard where the drive itself has just been silent is believed, until the
drive speaks again or what it sent is too old: counters and checksums cannot know who it is (see
docs/reliability.md, R09). What a full queue has lost while the process stood tells of no sender.
"""

import math
from collections import Counter
from functools import lru_cache
from typing import NamedTuple

import numpy as np
from crccheck.crc import Crc8Autosar

from dbc.e2e import p02_data_ids
from dbc.frame import ERROR, EXTENDED, MS, REMOTE, SECOND
from gateway.core.codes import Health
from tests.storm.train import TICK
from tests.storm.values import ValueRules

SLOW = ("Motion", "Status", "Temperatures")
ADHESION, FAULTS, ESTIMATE = 0x1A0, 0x2A0, 0x500
SENSOR, COMM, ESTIMATOR, OVERRUN = "SensorFault", "CommFault", "EstimatorFault", "Overrun"
OF_ALL = {SENSOR: 48, COMM: 50, ESTIMATOR: 52, OVERRUN: 54}
"""States in `Gateway_Faults` that speak for all drives, and their first bits."""
COMMON = "CommonMode"
TIMES = {SENSOR: (100, 500), COMM: (10, 10), ESTIMATOR: (0, 20)}
"""Ticks of good evidence before good, and before bad is cleared: the specification's, once more."""
OVERRUN_TICKS = 100
LOST_TICKS = 5
SPEED_STEP_RAD_S = 0.5 * 2.0 * math.pi / 60.0
NO_SPEED = 0x7FFF
UNKNOWN, GOOD, BAD = 0, 1, 2
ODD = EXTENDED | REMOTE | ERROR
SECOND_SENDER_TICKS = 10
"""A second sender has to be noticed in so many."""
APART_TICKS = 20
"""A filter that follows a slip may be off the true speed for so long."""
MOSTLY = 0.9
"""Share of a sender's frames without which it is not heard."""
GUARD_TICKS = 95
"""For so long after a second sender nothing is believed: a second, less what found it."""
SPEED_SHARE, SPEED_RAD_S = 0.2, 6.0


@lru_cache(maxsize=1 << 14)
def _checksum(data):
    """Most flag frames say what those sixteen before them said."""
    return int(Crc8Autosar.calc(data))


@lru_cache(maxsize=1 << 10)
def _two_bits(word):
    return [(word >> 2 * k) & 3 for k in range(16)]


class Violation(NamedTuple):
    """A rule that was broken. drive from 1, 0 for the set."""

    tick: int
    rule: str
    drive: int
    what: str


class Oracle:
    """Looks at every tick of one gateway from its start on."""

    def __init__(self, codec, config, tick):
        """tick: the gateway's first."""
        self.nodes = config.nodes
        self.n = len(self.nodes)
        fd = f"Drive{self.nodes[0]}_Samples" in codec.by_name
        self.electrical = ("Samples",) if fd else ("PhaseCurrents", "StatorVoltages")
        kinds = (*self.electrical, *SLOW)
        self.kinds = len(kinds)
        self.slot = np.full(0x800, -1)
        self.limit = np.zeros(self.n * len(kinds), dtype=np.int64)
        for d, node in enumerate(self.nodes):
            for k, kind in enumerate(kinds):
                spec = codec.by_name[f"Drive{node}_{kind}"]
                self.slot[spec.can_id] = d * len(kinds) + k
                self.limit[d * len(kinds) + k] = 3 * spec.cycle_ns + TICK
        self.last = np.full(len(self.limit), -(1 << 60), dtype=np.int64)
        self.heard = np.zeros(len(self.limit), dtype=bool)
        self.lent = self.last.copy()
        """Stamps of the newest frames that were not the drive's own, of drives with two senders."""
        self.ids = {
            spec.can_id: p02_data_ids(spec.can_id) for spec in codec.messages if spec.is_gateway
        }
        self.counters = {}
        self.adhesion = [UNKNOWN] * self.n
        self.thermal = [UNKNOWN] * self.n
        self.since = [tick] * self.n
        """First tick of the run of ticks with fresh currents and voltages, up to now."""
        self.good = -(-config.adhesion.good_ms * MS // TICK)
        self.clear = -(-config.adhesion.clear_ms * MS // TICK)
        self.cool = math.ceil(config.thermal.clear_s * SECOND / TICK)
        """Ticks of good evidence before a thermal fault is cleared."""
        self.warm, self.linked, self.tracked = [tick] * self.n, [tick] * self.n, [tick] * self.n
        """The same with temperatures, with all that was ever heard, and tracking."""
        self.any_sampled = tick
        """And with fresh currents and voltages of any drive."""
        self.whole = dict.fromkeys((*OF_ALL, COMMON), UNKNOWN)
        self.health = [None] * self.n
        """As told in this tick; None where it was not."""
        self.told = [math.nan] * self.n
        """Speed as last estimated, rad/s."""
        self.looked = tick - 1
        self.missed, self.lost = tick - OVERRUN_TICKS - 1, tick - LOST_TICKS
        """Ticks before which there were missed ones, and in which the loss of frames was known."""
        self.dropped = False
        self.apart = [0] * self.n
        self.doubled = [0] * self.n
        self.shared = [tick - GUARD_TICKS - 1] * self.n
        """Last tick in which a second sender had been there for long enough."""
        self._values = ValueRules(config, tick)
        self.found = []
        self._read = Counter()
        """Ticks by all that was said in them: a few dozen different ones."""

    def look(
        self, tick, arrived, out, status,
        truth, faults,
    ):  # fmt: skip
        """One tick. status: where the gateway was stepped singly."""
        now = tick * TICK
        mine = arrived.genuine
        slots = self.slot[arrived.block.can_id[mine]]
        self.last[slots] = arrived.block.t_ns[mine]
        self.heard[slots] = True
        fresh = (now - self.last <= self.limit).reshape(self.n, self.kinds)
        sampled = fresh[:, : len(self.electrical)].all(axis=1).tolist()
        self._second_senders(faults)
        self._note_lent(arrived, now)
        believable = self._believable(now, sampled)
        self._note_gateway(tick)
        block = arrived.block
        # Behind the tick where the process has stood: the newest are lost then.
        until = -(-int(block.t_ns.max()) // TICK) if block.size else tick
        self._runs(tick, fresh, sampled)
        self._estimates(tick, out, status)
        for frame in out:
            self._form(tick, frame)
            if frame.can_id == ADHESION:
                self._adhesion(tick, frame.data, believable, min(until, tick))
            elif frame.can_id == FAULTS:
                self._faults(tick, frame.data)
        self._stand(tick, believable)
        self._tracking(tick, truth.speed.tolist())
        self._values.look(tick, self.adhesion, self.whole[SENSOR], truth, faults, self._broken)
        self._read[(*self.adhesion, *self.thermal, *self.whole.values())] += 1

    @property
    def said(self):
        """Ticks by flag and state, over all drives."""
        names = ["adhesion"] * self.n + ["thermal"] * self.n + list(self.whole)
        out = Counter()
        for states, ticks in self._read.items():
            for name, state in zip(names, states, strict=True):
                out[name, state] += ticks
        return out

    def note_lost(self, frames):
        """So many were dropped unread since the last tick."""
        self.dropped |= frames > 0

    def _note_gateway(self, tick):
        """Ticks that the gateway has missed, frames that it knows are lost."""
        if tick - self.looked > 1:
            self.missed = tick
        if self.dropped:
            self.lost = tick
        self.looked, self.dropped = tick, False

    def _runs(self, tick, fresh, sampled):
        """For how long what each drive's flags rest on has been fresh: what is not begins anew."""
        known = self.heard.reshape(fresh.shape)
        linked = fresh.all(axis=1)
        if not known.all():
            electrical = known[:, : len(self.electrical)].all(axis=1)
            linked = (fresh | ~known).all(axis=1) & electrical
        warm = fresh[:, -1].tolist()
        for d, link in enumerate(linked.tolist()):
            if not sampled[d]:
                self.since[d] = tick + 1
            if not link:
                self.linked[d] = tick + 1
            if not (warm[d] or self.doubled[d] or self._lent_warmth(tick, d)):
                self.warm[d] = tick + 1
        if not (any(sampled) or any(self.doubled)):
            self.any_sampled = tick + 1

    def _believable(self, now, sampled):
        """By drive: fresh currents and voltages, its own or, while two speak for it, anybody's."""
        newest = np.maximum(self.last, self.lent).reshape(self.n, self.kinds)
        fresh = now - newest <= self.limit.reshape(newest.shape)
        heard = fresh[:, : len(self.electrical)].all(axis=1).tolist()
        return [own or (twice > 0 and any_of) for own, twice, any_of in
                zip(sampled, self.doubled, heard, strict=True)]  # fmt: skip

    def _lent_warmth(self, tick, drive):
        """Whether temperatures that were another sender's are still fresh."""
        slot = (drive + 1) * self.kinds - 1
        return tick * TICK - self.lent.item(slot) <= self.limit.item(slot)

    def _broken(self, tick, rule, drive, what):
        self.found.append(Violation(tick, rule, drive, what))

    def _form(self, tick, frame):
        data, ids = frame.data, self.ids.get(frame.can_id)
        if ids is None or len(data) != 8 or frame.flags or frame.t_ns != tick * TICK:
            self._broken(tick, "form", 0, f"strange frame {frame}")
            return
        counter = data[1] & 0x0F
        before = self.counters.get(frame.can_id)
        if counter != (0 if before is None else (before + 1) % 16):
            self._broken(tick, "form", 0, f"{frame.can_id:X}: counter {counter} after {before}")
        self.counters[frame.can_id] = counter
        if (
            frame.can_id in (ADHESION, FAULTS)
            and _checksum(data[1:] + bytes([ids[counter]])) != data[0]
        ):
            self._broken(tick, "form", 0, f"{frame.can_id:X}: checksum")

    def _states(self, tick, data):
        word = int.from_bytes(data, "little") >> 16
        states = _two_bits(word & 0xFFFFFFFF)
        mine = [states[node - 1] for node in self.nodes]
        if 3 in states or sum(states) != sum(mine):
            self._broken(tick, "form", 0, f"states {states}")
        return mine

    def _note_lent(self, arrived, now):
        """What came in the name of drives that two senders speak for."""
        if not any(self.doubled):
            return
        block = arrived.block
        theirs = ~arrived.genuine & (block.flags & ODD == 0) & (block.can_id < len(self.slot))
        theirs &= block.t_ns <= now
        slots = self.slot[block.can_id[theirs]]
        doubled = (slots >= 0) & np.array(self.doubled, dtype=bool)[slots // self.kinds]
        self.lent[slots[doubled]] = block.t_ns[theirs][doubled]

    def _adhesion(self, tick, data, believable, until):
        """until: tick up to which the gateway has heard the bus."""
        alone, common = tick - self.any_sampled, (data[6] >> 4) & 3
        self._whole(tick, COMMON, common, [alone], (self.good, self.clear))
        if common == GOOD and tick - self.lost < LOST_TICKS:
            self._broken(tick, "lost", 0, "CommonMode says good after lost frames")
        for d, state in enumerate(self._states(tick, data)):
            before = self.adhesion[d]
            fine = tick - self.since[d]  # ticks since the first of the fresh ones
            if self.doubled[d] > SECOND_SENDER_TICKS:
                self.shared[d] = until
            if state == GOOD and tick - self.shared[d] <= GUARD_TICKS:
                self._broken(tick, "masquerade", d + 1, "Adhering, and two senders speak or spoke")
            if state == GOOD and not believable[d]:
                self._broken(tick, "stale", d + 1, "Adhering without fresh samples")
            if state == GOOD and tick - self.lost < LOST_TICKS:
                self._broken(tick, "lost", d + 1, "Adhering after lost frames")
            if before == BAD and state == UNKNOWN:
                self._broken(tick, "cleared", d + 1, "AdhesionLost went to Unknown")
            if before == BAD and state == GOOD and fine < self.clear:
                self._broken(tick, "cleared", d + 1, f"after {fine} ticks of fresh samples")
            if before == UNKNOWN and state == GOOD and fine < self.good:
                self._broken(tick, "hasty", d + 1, f"after {fine} ticks of fresh samples")
            self.adhesion[d] = state

    def _faults(self, tick, data):
        for d, state in enumerate(self._states(tick, data)):
            before, fine = self.thermal[d], tick - self.warm[d]
            if before == BAD and state == UNKNOWN:
                self._broken(tick, "cleared", d + 1, "thermal Fault went to Unknown")
            if before == BAD and state == GOOD and fine < self.cool:
                self._broken(tick, "cleared", d + 1, f"after {fine} ticks of fresh temperatures")
            self.thermal[d] = state
        word = int.from_bytes(data, "little")
        for name, began in ((SENSOR, self.warm), (COMM, self.linked), (ESTIMATOR, self.tracked)):
            state = (word >> OF_ALL[name]) & 3
            self._whole(tick, name, state, [tick - since for since in began], TIMES[name])
        self.whole[OVERRUN] = (word >> OF_ALL[OVERRUN]) & 3

    def _whole(self, tick, name, state, fine, times):
        """A state of all drives is read. fine: ticks since the first good one, by drive."""
        before, (good, clear) = self.whole[name], times
        if state > BAD:
            self._broken(tick, "form", 0, f"{name} is {state}")
        if before == BAD and state != BAD and max(fine) < clear:
            self._broken(tick, "cleared", 0, f"{name} to {state} after {max(fine)} good ticks")
        if name == COMMON and before == BAD and state == UNKNOWN:
            self._broken(tick, "cleared", 0, f"{name} went to Unknown")
        if before != GOOD and state == GOOD and 0 <= min(fine) < good:
            rule = "hasty" if before == UNKNOWN else "cleared"
            self._broken(tick, rule, 0, f"{name} says good after {min(fine)} good ticks")
        self.whole[name] = state

    def _stand(self, tick, believable):
        """What was last read, against what there is now."""
        for d, state in enumerate(self.thermal):
            if state == GOOD and self.warm[d] > tick:
                self._broken(tick, "stale", d + 1, "NoFault without fresh temperatures")
        if self.whole[SENSOR] == GOOD and max(self.warm) > tick:
            self._broken(tick, "stale", 0, "SensorFault says good without fresh temperatures")
        if self.whole[COMM] == GOOD and max(self.linked) > tick:
            self._broken(tick, "stale", 0, "CommFault says good")
        if self.whole[COMMON] == GOOD and self.any_sampled > tick:
            self._broken(tick, "stale", 0, "CommonMode says good without fresh samples")
        if self.whole[ESTIMATOR] == GOOD and max(self.tracked) > tick:
            self._broken(tick, "untracked", 0, "EstimatorFault says good")
        for d, health in enumerate(self.health):
            if health == Health.TRACKING and not believable[d]:
                self._broken(tick, "stale", d + 1, "Health says tracking without fresh samples")
        wanted = BAD if tick - self.missed <= OVERRUN_TICKS else GOOD
        if self.whole[OVERRUN] != wanted:
            self._broken(tick, "overrun", 0, f"says {self.whole[OVERRUN]}, {wanted} is right")

    def _estimates(self, tick, out, status):
        """Health and speed: from the wire, and in ticks that send none what would be sent.

        That is known of single steps. Else nothing is, and a drive counts as tracking from its last
        estimate that says otherwise on.
        """
        sent = {frame.can_id: frame.data for frame in out}
        health = [None] * self.n if status is None else status.drives["health"].tolist()
        speed = self.told if status is None else status.drives["speed_rad_s"].tolist()
        for d, node in enumerate(self.nodes):
            data = sent.get(ESTIMATE + node)
            if data is not None:
                health[d] = data[1] >> 4
                raw = int.from_bytes(data[2:4], "little", signed=True)
                speed[d] = math.nan if raw == NO_SPEED else raw * SPEED_STEP_RAD_S
            if health[d] is not None and health[d] != Health.TRACKING:
                self.tracked[d] = tick + 1
        self.health, self.told = health, speed

    def _tracking(self, tick, speed):
        for d, (health, told) in enumerate(zip(self.health, self.told, strict=True)):
            if self.adhesion[d] != GOOD:
                self.apart[d] = 0
                continue
            if health is not None and health != Health.TRACKING:
                self._broken(tick, "untracked", d + 1, f"Adhering while Health is {health}")
            off = abs((0.0 if math.isnan(told) else told) - speed[d])
            far = off > max(SPEED_RAD_S, SPEED_SHARE * abs(speed[d]))
            self.apart[d] = self.apart[d] + 1 if far else 0
            if self.apart[d] > APART_TICKS:
                self._broken(tick, "untracked", d + 1, f"Adhering, {off:.1f} rad/s off the truth")

    def _second_senders(self, faults):
        """Ticks that each drive has shared its identifiers, both of them heard."""
        both = [f.drive for f in faults if f.kind == "second_sender"]
        if not both:
            self.doubled = [0] * self.n
            return
        hidden = ("bus_off", "link_loss", "drop", "delay", "clock_step")
        held = any(f.kind in hidden for f in faults)
        # Two of whom no frame arrives whole are one that is disturbed.
        spoilt = [f.drive for f in faults if f.kind == "corrupt" and f.amount > MOSTLY]
        for d in range(self.n):
            twice = d in both or None in both
            alone = held or d in spoilt or None in spoilt
            self.doubled[d] = twice * (1 if alone else self.doubled[d] + 1)
