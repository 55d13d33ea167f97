"""Who watches the gateway in the storm: bytes on the wire against what really arrived.

Keeps its own books (stamps of genuine frames, flags as last read from the wire) and uses neither
the gateway's codec nor its counters. Rules, by name:

- stale: no flag says good when the newest genuine frame it rests on is older than its limit
- untracked: `Adhering` only from a drive whose filter says tracking and is near the true speed
- cleared: unknown never clears bad, and good needs its time of good frames
- hasty: the first good after a start needs its time of good frames
- form: every frame sent is whole: counter, states 0 to 2, nothing but our identifiers; flags have
  their checksum
- masquerade: `Adhering` from no drive that two senders speak for, nor in the second after

A second sender that is heard where the drive itself has just been silent is believed, until the
drive speaks again or what it sent is too old: counters and checksums cannot know who it is (see
docs/reliability.md, R09). What a full queue has lost while the process stood tells of no sender.
"""

from __future__ import annotations

import math
from collections import Counter
from typing import NamedTuple

import numpy as np
from crccheck.crc import Crc8Autosar

from dbc.codec import Codec
from dbc.dataids import p02_data_ids
from dbc.frame import ERROR, EXTENDED, MS, REMOTE, Frame
from gateway.config import Config
from gateway.health import Flag, Health
from gateway.said import Said
from sim.hostile import Arrived, Fault
from tests.storm.train import TICK

SLOW = ("Motion", "Status", "Temperatures")
ADHESION, FAULTS, ESTIMATE = 0x1A0, 0x2A0, 0x500
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


class Violation(NamedTuple):
    """A rule that was broken. drive from 1, 0 for the set."""

    tick: int
    rule: str
    drive: int
    what: str


class Oracle:
    """Looks at every tick of one gateway from its start on."""

    def __init__(self, codec: Codec, config: Config, tick: int) -> None:
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
        self.counters: dict[int, int] = {}
        self.adhesion = [UNKNOWN] * self.n
        self.thermal = [UNKNOWN] * self.n
        self.since = [tick] * self.n
        """First tick of the run of ticks with fresh currents and voltages, up to now."""
        self.good = -(-config.adhesion.good_ms * MS // TICK)
        self.clear = -(-config.adhesion.clear_ms * MS // TICK)
        self.apart = [0] * self.n
        self.doubled = [0] * self.n
        self.shared = [tick - GUARD_TICKS - 1] * self.n
        """Last tick in which a second sender had been there for long enough."""
        self.found: list[Violation] = []
        self.said: Counter[tuple[str, int]] = Counter()
        """Ticks by flag and state, over all drives."""

    def look(
        self, tick: int, arrived: Arrived, out: list[Frame], said: Said,
        speed: np.ndarray, faults: list[Fault],
    ) -> None:  # fmt: skip
        """One tick. speed (N,): true, rad/s."""
        now = tick * TICK
        mine = arrived.genuine
        slots = self.slot[arrived.block.can_id[mine]]
        self.last[slots] = arrived.block.t_ns[mine]
        self.heard[slots] = True
        fresh = (now - self.last <= self.limit).reshape(self.n, self.kinds)
        sampled = fresh[:, : len(self.electrical)].all(axis=1).tolist()
        self._second_senders(faults)
        self._note_lent(arrived, now)
        block = arrived.block
        # Behind the tick where the process has stood: the newest are lost then.
        until = -(-int(block.t_ns.max()) // TICK) if block.size else tick
        for d in range(self.n):
            if not sampled[d]:
                self.since[d] = tick + 1
        for frame in out:
            self._form(tick, frame)
            if frame.can_id == ADHESION:
                self._adhesion(tick, frame.data, sampled, min(until, tick))
            elif frame.can_id == FAULTS:
                self._faults(tick, frame.data, fresh, said)
        self._tracking(tick, said, speed.tolist())
        for name, states in (("adhesion", self.adhesion), ("thermal", self.thermal)):
            for state in states:
                self.said[name, state] += 1

    def _broken(self, tick: int, rule: str, drive: int, what: str) -> None:
        self.found.append(Violation(tick, rule, drive, what))

    def _form(self, tick: int, frame: Frame) -> None:
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
            and Crc8Autosar.calc(data[1:] + bytes([ids[counter]])) != data[0]
        ):
            self._broken(tick, "form", 0, f"{frame.can_id:X}: checksum")

    def _states(self, tick: int, data: bytes) -> list[int]:
        word = int.from_bytes(data, "little") >> 16
        states = [(word >> 2 * k) & 3 for k in range(16)]
        mine = [states[node - 1] for node in self.nodes]
        if 3 in states or sum(states) != sum(mine):
            self._broken(tick, "form", 0, f"states {states}")
        return mine

    def _note_lent(self, arrived: Arrived, now: int) -> None:
        """What came in the name of drives that two senders speak for."""
        if not any(self.doubled):
            return
        block = arrived.block
        theirs = ~arrived.genuine & (block.flags & ODD == 0) & (block.can_id < len(self.slot))
        theirs &= block.t_ns <= now
        slots = self.slot[block.can_id[theirs]]
        doubled = (slots >= 0) & np.array(self.doubled, dtype=bool)[slots // self.kinds]
        self.lent[slots[doubled]] = block.t_ns[theirs][doubled]

    def _adhesion(self, tick: int, data: bytes, sampled: list[bool], until: int) -> None:
        """until: tick up to which the gateway has heard the bus."""
        if (data[6] >> 4) & 3 == GOOD and not any(sampled) and not any(self.doubled):
            self._broken(tick, "stale", 0, "CommonMode says good without fresh samples")
        for d, state in enumerate(self._states(tick, data)):
            before = self.adhesion[d]
            fine = tick - self.since[d]  # ticks since the first of the fresh ones
            if self.doubled[d] > SECOND_SENDER_TICKS:
                self.shared[d] = until
            if state == GOOD and tick - self.shared[d] <= GUARD_TICKS:
                self._broken(tick, "masquerade", d + 1, "Adhering, and two senders speak or spoke")
            if state == GOOD and not sampled[d] and not self.doubled[d]:
                self._broken(tick, "stale", d + 1, "Adhering without fresh samples")
            if before == BAD and state == UNKNOWN:
                self._broken(tick, "cleared", d + 1, "AdhesionLost went to Unknown")
            if before == BAD and state == GOOD and fine < self.clear:
                self._broken(tick, "cleared", d + 1, f"after {fine} ticks of fresh samples")
            if before == UNKNOWN and state == GOOD and fine < self.good:
                self._broken(tick, "hasty", d + 1, f"after {fine} ticks of fresh samples")
            self.adhesion[d] = state

    def _faults(self, tick: int, data: bytes, fresh: np.ndarray, said: Said) -> None:
        lent = (tick * TICK - self.lent <= self.limit).reshape(fresh.shape)
        for d, state in enumerate(self._states(tick, data)):
            aged = not fresh[d, -1] and not lent[d, -1] and not self.doubled[d]
            if state == GOOD and aged:
                self._broken(tick, "stale", d + 1, "NoFault without fresh temperatures")
            if self.thermal[d] == BAD and state == UNKNOWN:
                self._broken(tick, "cleared", d + 1, "thermal Fault went to Unknown")
            self.thermal[d] = state
        comm, estimator = (data[6] >> 2) & 3, (data[6] >> 4) & 3
        if comm == GOOD and not (fresh.ravel() | ~self.heard).all():
            self._broken(tick, "stale", 0, "CommFault says good")
        if estimator == GOOD and (said.health != Health.TRACKING).any():
            self._broken(tick, "untracked", 0, "EstimatorFault says good")

    def _tracking(self, tick: int, said: Said, speed: list[float]) -> None:
        rows = zip(said.adhesion.tolist(), said.health.tolist(), said.speed.tolist(), strict=True)
        for d, (flag, health, told) in enumerate(rows):
            if self.adhesion[d] != GOOD:
                self.apart[d] = 0
                continue
            if flag != Flag.GOOD or health != Health.TRACKING:
                self._broken(tick, "untracked", d + 1, f"Adhering while {Health(health).name}")
            off = abs((0.0 if math.isnan(told) else told) - speed[d])
            far = off > max(SPEED_RAD_S, SPEED_SHARE * abs(speed[d]))
            self.apart[d] = self.apart[d] + 1 if far else 0
            if self.apart[d] > APART_TICKS:
                self._broken(tick, "untracked", d + 1, f"Adhering, {off:.1f} rad/s off the truth")

    def _second_senders(self, faults: list[Fault]) -> None:
        """Ticks that each drive has shared its identifiers, both of them heard."""
        both = [f.drive for f in faults if f.kind == "second_sender"]
        hidden = ("bus_off", "link_loss", "drop", "delay", "clock_step")
        held = any(f.kind in hidden for f in faults)
        # Two of whom no frame arrives whole are one that is disturbed.
        spoilt = [f.drive for f in faults if f.kind == "corrupt" and f.amount > MOSTLY]
        for d in range(self.n):
            twice = d in both or None in both
            alone = held or d in spoilt or None in spoilt
            self.doubled[d] = twice * (1 if alone else self.doubled[d] + 1)
