"""The adhesion side: what the loads of all drives say, with what has been learnt of each.

Two views are fused. Drives are compared with one another (the configured detector), each
referred to full command, to the train's direction and to its own learnt ratio. And every drive's
load is held against its own command, which sees what no comparison can: all drives lost at
once, and a drive alone. May know: estimators, estimates, commands. May not know: frames, bits.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from dbc.frame import MS, SECOND, Nanos
from estimators.detect import DETECTORS, WITH_MEMORY, Evidence, Opinion, reference, response
from gateway.bank import DriveEstimate
from gateway.config import Adhesion, Motor
from gateway.decide import FlagState, Timing, advance, from_probability
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
CERTAINLY_GOOD: Final = 0.05
"""Response that no comparison can outvote."""
PROBABLY_GOOD: Final = 0.5
"""A loss more probable than this is not learnt from. Not less: learning only what looks best would
be learning something better than it is."""
SETTLED_NS: Final[Nanos] = 300 * MS
"""A load is learnt from only when it has been known for this long."""
VETOED: Final = 0.4
"""What is left of an accusation that the drive's own response contradicts: not enough to raise."""
SEVERE: Final = 0.35
TRAIN_S: Final = 0.5
"""Time constant of what counts as the train's own acceleration."""
TRAIN_MOST: Final = 0.1
"""Most of the rated torque that a rotor takes to accelerate with its train."""
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
        self.tick_s = tick_ns / SECOND
        self.detector = (DETECTORS | WITH_MEMORY)[config.detector]()
        spread = config.spread_nm / BASE_NM
        self.reference = reference.start(len(self.rated), spread)
        self.response = response.start(len(self.rated), spread)
        self.severe = np.zeros(len(self.rated), dtype=np.bool_)
        """Drives that carry so much less than the others that noise cannot be the cause."""
        self.common = FlagState()
        """Whether all drives have lost adhesion at once."""
        self._slow_speed: list[float | None] = [None] * len(self.rated)
        self._learn_ns: Nanos | None = None
        self._known: list[Nanos | None] = [None] * len(self.rated)
        """Since when each load has been known."""

    def judge(
        self,
        drives: Sequence[DriveInput],
        estimates: Sequence[DriveEstimate],
        flags: Sequence[FlagState],
        now: Nanos,
    ) -> Opinion:
        """Probabilities of lost adhesion; `flags` are the drives' adhesion flags so far."""
        at = self._instant(drives, estimates, flags, now)
        spread = self.reference.sigma(at.load) / at.share
        opinion = self.detector(
            Evidence(self.reference.referred(at.load) / at.share, spread, at.known)
        )
        self._known = [
            (now if since is None else since) if known else None
            for since, known in zip(self._known, at.known.tolist(), strict=True)
        ]
        heard = self._heard(drives, estimates, at.known, now)
        self.response, alone, meant = response.respond(self.response, heard, self.tick_s)
        opinion = _fused(opinion, alone, heard.usable, meant)
        carried = self.reference.referred(at.load) / at.share * np.sign(opinion.common)
        self.severe = at.known & (carried < (1.0 - SEVERE) * abs(opinion.common))
        self._common_mode(alone, heard.usable, at.known, now)
        healthy = self._healthy(opinion, flags, now)
        self.response = response.learn(self.response, heard, healthy, self.tick_s)
        if self._learn_ns is None or now >= self._learn_ns:
            self._learn_ns = now + LEARN_NS
            load = at.load / at.share
            memory = reference.watch(self.reference, load, opinion.common, at.known)
            self.reference = reference.learn(memory, load, opinion.common, healthy)
        return opinion

    def _instant(
        self,
        drives: Sequence[DriveInput],
        estimates: Sequence[DriveEstimate],
        flags: Sequence[FlagState],
        now: Nanos,
    ) -> Instant:
        """Loads in the direction of travel.

        A drive mounted the other way round turns and pulls the other way; its own speed's sign
        brings it to the train's direction.
        """
        load, share, known = [], [], []
        shares = self._shares(drives, flags, now)
        for estimate, part, rated in zip(estimates, shares, self.rated, strict=True):
            known.append(estimate.health is Health.TRACKING and part >= SHARE_UNKNOWN)
            share.append(max(part, SHARE_FLOOR))
            forward = 1.0 if (estimate.speed_rad_s or 0.0) >= 0.0 else -1.0
            load.append(forward * (estimate.load_nm or 0.0) / rated)
        return Instant(np.array(load), np.array(share), np.array(known))

    def _shares(
        self, drives: Sequence[DriveInput], flags: Sequence[FlagState], now: Nanos
    ) -> list[float]:
        """Each drive's torque command over the largest one; 1 where that says nothing.

        The drives' Status frames are up to a cycle apart, so commands that change with the train
        differ by their age alone. They are compared while all are steady; a drive that follows
        its own flag (down to 30 % and back) is compared always.
        """
        command = [
            abs(d.torque_command) / rated
            if d.torque_command is not None and d.channels["Status"].fresh(now)
            else None
            for d, rated in zip(drives, self.rated, strict=True)
        ]
        largest = max((c for c in command if c is not None), default=0.0)
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
        known: Flags,
        now: Nanos,
    ) -> response.Heard:
        """Loads beside the commands that they should answer, in each motor's own direction."""
        rows: list[list[float]] = []
        usable = []
        for k, (drive, estimate) in enumerate(zip(drives, estimates, strict=True)):
            numbers = (estimate.load_nm, drive.torque_command, drive.command_before)
            fresh = drive.torque_command is not None and drive.channels["Status"].fresh(now)
            usable.append(bool(known[k]) and fresh)
            rows.append([(number or 0.0) / self.rated[k] for number in numbers])
            rows[-1][0] += self._accelerating(k, estimate.speed_rad_s)
        load, command, before = np.array(rows).T
        age_s = np.array([(now - drive.command_ns) / SECOND for drive in drives])
        return response.Heard(load, command, before, age_s, np.array(usable))

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

    def _common_mode(self, alone: Array, heard: Flags, known: Flags, now: Nanos) -> None:
        """All drives lost, debounced and latched. One that holds says no; yes needs all known."""
        judged = bool(known.any() and heard[known].all())
        lost = float(alone[known].min()) if judged else 0.0
        judged &= bool(known.all()) or lost <= self.config.clear_probability
        seen = from_probability(
            lost, judged, self.config.raise_probability, self.config.clear_probability
        )
        evidence = self.common.evidence if seen is None else seen
        self.common = advance(self.common, evidence, now, self.timing)

    def _healthy(self, opinion: Opinion, flags: Sequence[FlagState], now: Nanos) -> Flags:
        """(N,) drives that may be learnt from: none while any is lost."""
        good = np.array([state.flag is Flag.GOOD for state in flags])
        settled = np.array(
            [since is not None and now - since >= SETTLED_NS for since in self._known]
        )
        if any(state.flag is Flag.BAD for state in flags):
            return np.zeros_like(good)
        return np.asarray(good & settled & opinion.known & (opinion.lost < PROBABLY_GOOD))


def _fused(opinion: Opinion, alone: Array, heard: Flags, meant: Flags) -> Opinion:
    """Comparison between drives, and each drive's own response to its command.

    Either may accuse a drive; a drive that certainly answers its command is accused by no
    comparison, which may have taken a slipping majority, or one that reads too much, for normal.
    Without a command, or other drives, there is only one of the two.
    """
    vetoed = np.where(alone < CERTAINLY_GOOD, np.minimum(opinion.lost, VETOED), opinion.lost)
    both = np.where(meant, np.maximum(vetoed, alone), opinion.lost)
    return Opinion(np.where(opinion.known, both, alone), opinion.known | heard, opinion.common)
