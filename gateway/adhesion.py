"""The adhesion side: what the loads of all drives say, with what has been learnt of each.

Two views are fused. Drives are compared with one another (the configured detector), each
referred to full command, to the train's direction and to its own learnt ratio. And every drive's
load is held against its own command, which sees what no comparison can: all drives lost at
once, and a drive alone. May know: estimators, estimates, commands. May not know: frames, bits.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from dbc.frame import MS, SECOND, Nanos
from estimators.detect import Evidence, Opinion, make, reference, response
from estimators.detect import _reference_kernels as compiled
from gateway._direct import Direct
from gateway.bank import DriveEstimate
from gateway.config import Adhesion, Motor
from gateway.decide import FlagState, Timing, advance, from_probability, hold
from gateway.health import Flag, Health
from gateway.inbox import DriveInput

COASTING: Final = 0.05
"""Below this share of rated torque the commands say nothing about each other."""
FOLLOWING_NS: Final[Nanos] = 2 * SECOND
"""A drive's torque is back a second after its flag cleared; twice that."""
SHARE_FLOOR: Final = 0.2
SHARE_UNKNOWN: Final = 0.1
"""A drive commanded less than a tenth of the others carries too little to be judged."""
LEARN_NS: Final[Nanos] = round(reference.EVERY_S * SECOND)
PROBABLY_GOOD: Final = 0.5
"""A loss more probable than this is not learnt from. Not less: learning only what looks best would
be learning something better than it is."""
SETTLED_NS: Final[Nanos] = 300 * MS
"""A load is learnt from only when it has been known for this long."""
SEVERE: Final = 0.35
SEVERE_SPREADS: Final = 6.0
"""Share of the load that is missing, and in spreads, from which on noise is not the cause."""
TRAIN_S: Final = 0.5
"""Time constant of what counts as the train's own acceleration."""
TRAIN_MOST: Final = 0.15
"""Most of the rated torque that a rotor takes to accelerate with its train: an emergency brake of
1.5 m/s^2 for the 350 kW motor, the rotor behind its gear included."""
PASSING: Final = 0.035
"""Loads differ by this much, standard deviation, for some seconds: curves, load steps. Too short to
be learnt."""
ENOUGH_TO_COMPARE: Final = 2
"""Drives. With fewer a sudden loss is told by the rotor; with more, all of whose loads fall, it may
be the train's, and the next commands decide."""
BASE_NM: Final = 30.0
"""Rated torque of the motor that `spread_nm` is stated for."""

Array = NDArray[np.float64]
Flags = NDArray[np.bool_]


class Instant(NamedTuple):
    """Loads of N drives at one tick, per unit of rated torque.

    load: (N,) in the train's direction, as estimated; share: (N,) of full command; known: (N,).
    """

    load: Array
    share: Array
    known: Flags


class AdhesionSide:
    """Memory of the drives' healthy loads; `judge` per tick is the only mutator."""

    def __init__(
        self, config: Adhesion, motors: Sequence[Motor], timing: Timing, tick_ns: Nanos
    ) -> None:
        """timing: of the common-mode flag; motors: per drive."""
        self.config = config
        self.rated = tuple(motor.T_rated for motor in motors)
        self.inertia = tuple(motor.J for motor in motors)
        self.timing = timing
        self.tick_ns = tick_ns
        self.tick_s = tick_ns / SECOND
        self.detector = make(config.detector, config.observe)
        spread = config.spread_nm / BASE_NM
        self.reference = reference.start(len(self.rated), spread)
        self.response = response.start(len(self.rated), spread)
        self._refer, self._severely = Direct(compiled.refer), Direct(compiled.severely)
        self._answer, self._fuse = Direct(compiled.respond), Direct(compiled.fuse)
        self._watch, self._learn_loads = Direct(compiled.watch), Direct(compiled.learn)
        self._learn_response = Direct(compiled.learn_response)
        self.severe: list[bool] = [False] * len(self.rated)
        """Drives that carry so much less than the others that noise cannot be the cause."""
        self.common = FlagState()
        """Whether all drives have lost adhesion at once."""
        self._slow_speed: list[float | None] = [None] * len(self.rated)
        self._run_away: list[tuple[float, float] | None] = [None] * len(self.rated)
        """Speed and gain of the tick before."""
        self._learn_ns: Nanos | None = None
        self._known: list[Nanos | None] = [None] * len(self.rated)
        """Since when each load has been known."""
        self._bad_ns: Nanos | None = None
        """When last any wheel was lost."""

    def judge(
        self,
        drives: Sequence[DriveInput],
        estimates: Sequence[DriveEstimate],
        flags: Sequence[FlagState],
        now: Nanos,
    ) -> Opinion:
        """Probabilities of lost adhesion; `flags` are the drives' adhesion flags so far."""
        fresh = [drive.commanded(now) for drive in drives]
        at = self._instant(drives, estimates, flags, fresh, now)
        known = at.known.tolist()
        heard = self._heard(drives, estimates, fresh, known, now)
        referred, spread = np.empty_like(at.load), np.empty_like(at.load)
        self._refer(self.reference, at.load, at.share, PASSING, referred, spread)
        compared = self.detector(Evidence(referred, spread, at.known, self._speeds(estimates)))
        self._known = [
            (now if since is None else since) if sure else None
            for since, sure in zip(self._known, known, strict=True)
        ]
        opinion, alone = self._respond(compared, heard)
        # Of what the others carry, or with nobody to compare with, of the command.
        severe = np.empty_like(at.known)
        self._severely(
            opinion.common, heard, referred, spread, at.known, SEVERE, SEVERE_SPREADS, severe
        )
        self.severe = severe.tolist()
        self._common_mode(alone.tolist(), heard.usable.tolist(), known, now)
        self._learn(at, heard, opinion, flags, now)
        return opinion

    def _respond(self, compared: Opinion, heard: response.Heard) -> tuple[Opinion, Array]:
        """The opinion with every drive's own response, and the response alone."""
        n = len(self.rated)
        alone, lost = np.empty(n), np.empty(n)
        meant, known = np.empty(n, dtype=np.bool_), np.empty(n, dtype=np.bool_)
        self._answer(self.response, heard, self.tick_s, alone, meant)
        self._fuse(compared.lost, compared.known, alone, heard.usable, meant, lost, known)
        return Opinion(lost, known, compared.common), alone

    def _learn(
        self,
        at: Instant,
        heard: response.Heard,
        opinion: Opinion,
        flags: Sequence[FlagState],
        now: Nanos,
    ) -> None:
        """Responses from every new command, differences between drives every LEARN_NS."""
        answered = min(heard.age_s.tolist()) < self.tick_s
        due = self._learn_ns is None or now >= self._learn_ns
        if not (answered or due):
            return
        healthy = self._healthy(opinion, flags, now)
        if answered:
            own = self.response.reference
            spread = self._learn_response(self.response, heard, healthy, self.tick_s)
            self.response = self.response._replace(reference=own._replace(spread=spread))
        if due:
            self._learn_ns = now + LEARN_NS
            load, common = at.load / at.share, np.full(len(healthy), opinion.common)
            spread = self._watch(self.reference, load, common, at.known, True)
            self.reference = self.reference._replace(spread=spread)
            self._learn_loads(self.reference, load, common, healthy, True)

    def _instant(
        self,
        drives: Sequence[DriveInput],
        estimates: Sequence[DriveEstimate],
        flags: Sequence[FlagState],
        fresh: Sequence[bool],
        now: Nanos,
    ) -> Instant:
        """Loads in the direction of travel; fresh: whether each command is known.

        A drive mounted the other way round turns and pulls the other way; its own speed's sign
        brings it to the train's direction.
        """
        load, share, known = [], [], []
        shares = self._shares(drives, flags, fresh, now)
        for estimate, part, rated in zip(estimates, shares, self.rated, strict=True):
            known.append(estimate.health is Health.TRACKING and part >= SHARE_UNKNOWN)
            share.append(max(part, SHARE_FLOOR))
            forward = 1.0 if (estimate.speed_rad_s or 0.0) >= 0.0 else -1.0
            load.append(forward * (estimate.load_nm or 0.0) / rated)
        return Instant(np.array(load), np.array(share), np.array(known))

    def _speeds(self, estimates: Sequence[DriveEstimate]) -> Array | None:
        """Rotor speeds in the direction of travel, where the detector observes them."""
        if self.config.observe == "torque":
            return None
        return np.abs([math.nan if e.speed_rad_s is None else e.speed_rad_s for e in estimates])

    def _shares(
        self,
        drives: Sequence[DriveInput],
        flags: Sequence[FlagState],
        fresh: Sequence[bool],
        now: Nanos,
    ) -> list[float]:
        """Each drive's torque command over the largest one; 1 where that says nothing.

        The drives' Status frames are up to a cycle apart, so commands that change with the train
        differ by their age alone. They are compared while all are steady; a drive that follows
        its own flag (down to 30 % and back) is compared always.
        """
        command = [
            abs(d.torque_command or 0.0) / rated if known else None
            for d, rated, known in zip(drives, self.rated, fresh, strict=True)
        ]
        largest = max([c for c in command if c is not None], default=0.0)
        if largest <= COASTING:
            return [1.0] * len(drives)
        follows = [f.flag is Flag.BAD or now < f.since_ns + FOLLOWING_NS for f in flags]
        calm = all(d.command_steady or follows[k] for k, d in enumerate(drives))
        return [
            c / largest if c is not None and (calm or follows[k]) else 1.0
            for k, c in enumerate(command)
        ]

    def _heard(
        self,
        drives: Sequence[DriveInput],
        estimates: Sequence[DriveEstimate],
        fresh: Sequence[bool],
        known: Sequence[bool],
        now: Nanos,
    ) -> response.Heard:
        """Loads beside the commands that they should answer, in each motor's own direction."""
        load, excess, command, before, age_s = [], [], [], [], []
        alone = sum(known) < ENOUGH_TO_COMPARE
        for k, (drive, estimate) in enumerate(zip(drives, estimates, strict=True)):
            rated = self.rated[k]
            taken = self._accelerating(k, estimate.speed_rad_s)
            load.append((estimate.load_nm or 0.0) / rated + taken)
            excess.append(self._excess(k, estimate.speed_rad_s if alone else None))
            command.append((drive.torque_command or 0.0) / rated)
            before.append((drive.command_before or 0.0) / rated)
            age_s.append((now - drive.command_ns) / SECOND)
        usable = [a and b for a, b in zip(fresh, known, strict=True)]
        rows = np.array([load, excess, command, before, age_s])
        return response.Heard(rows[0], rows[1], rows[2], rows[3], rows[4], np.array(usable))

    def _accelerating(self, k: int, speed: float | None) -> float:
        """Part of the command that speeds up the drive's own rotor with the train, per unit.

        Slow and bounded, because what a wheel takes that runs away is what is looked for.
        """
        if speed is None:
            self._slow_speed[k] = None
            return 0.0
        slow = self._slow_speed[k]
        slow = speed if slow is None else slow
        self._slow_speed[k] = slow + self.tick_s / TRAIN_S * (speed - slow)
        torque = self.inertia[k] * (speed - slow) / TRAIN_S / self.rated[k]
        return min(max(torque, -TRAIN_MOST), TRAIN_MOST)

    def _excess(self, k: int, speed: float | None) -> float:
        """Torque that accelerated a rotor, per unit, on the average of a tick: largest of two.

        A quick speed control takes the torque back within a tick; the speed that it could not hold
        shows for longer. speed: None where it is not known, or not asked for.
        """
        last, self._run_away[k] = self._run_away[k], None
        if speed is None:
            return 0.0
        before, gained_before = last or (speed, 0.0)
        gained = self.inertia[k] * (speed - before) / self.tick_s / self.rated[k]
        self._run_away[k] = speed, gained
        return max(gained, gained_before, key=abs)

    def _common_mode(
        self, alone: Sequence[float], heard: Sequence[bool], known: Sequence[bool], now: Nanos
    ) -> None:
        """All drives lost, debounced and latched. One that holds says no; yes needs all known."""
        judged = any(known) and all(h for h, sure in zip(heard, known, strict=True) if sure)
        lost = min((p for p, sure in zip(alone, known, strict=True) if sure), default=0.0)
        judged &= all(known) or lost <= self.config.clear_probability
        seen = from_probability(
            lost, judged, self.config.raise_probability, self.config.clear_probability
        )
        if seen is None:
            self.common = hold(self.common, self.tick_ns)
        else:
            self.common = advance(self.common, seen, now, self.timing)

    def _healthy(self, opinion: Opinion, flags: Sequence[FlagState], now: Nanos) -> Flags:
        """(N,) drives that may be learnt from: none while any is lost, or finds its grip again."""
        if any(state.flag is Flag.BAD for state in flags):
            self._bad_ns = now
        if self._bad_ns is not None and now < self._bad_ns + FOLLOWING_NS:
            return np.zeros(len(flags), dtype=np.bool_)
        settled = [
            since is not None and now - since >= SETTLED_NS and state.flag is Flag.GOOD
            for since, state in zip(self._known, flags, strict=True)
        ]
        return np.array(settled) & opinion.known & (opinion.lost < PROBABLY_GOOD)
