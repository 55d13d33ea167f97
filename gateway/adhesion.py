"""The adhesion side: what the loads of all drives say, with what has been learnt of each.

Two views are fused. Drives are compared with one another (the configured detector), each
referred to full command, to the train's direction and to its own learnt ratio. And every drive's
load is held against its own command, which sees what no comparison can: all drives lost at
once, and a drive alone. May know: estimators, estimates, commands. May not know: frames, bits.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

import numpy as np
from numpy.typing import NDArray

from dbc.frame import MS, SECOND, Nanos
from estimators.detect import Evidence, Opinion, make, reference, response
from estimators.detect import _reference_kernels as compiled
from gateway import loads
from gateway._direct import Direct
from gateway._loads_kernels import prepare
from gateway.config import Adhesion, Motor
from gateway.decide import FlagState, Timing, advance, from_probability, hold
from gateway.health import Flag
from gateway.loads import FOLLOWING_NS, Instant
from gateway.slow import SlowState
from gateway.tracks import Told

LEARN_NS: Final[Nanos] = round(reference.EVERY_S * SECOND)
PROBABLY_GOOD: Final = 0.5
"""A loss more probable than this is not learnt from. Not less: learning only what looks best would
be learning something better than it is."""
SETTLED_NS: Final[Nanos] = 300 * MS
"""A load is learnt from only when it has been known for this long."""
SEVERE: Final = 0.35
SEVERE_SPREADS: Final = 6.0
"""Share of the load that is missing, and in spreads, from which on noise is not the cause."""
PASSING: Final = 0.035
"""Loads differ by this much, standard deviation, for some seconds: curves, load steps. Too short to
be learnt."""
BASE_NM: Final = 30.0
"""Rated torque of the motor that `spread_nm` is stated for."""

Array = NDArray[np.float64]
Flags = NDArray[np.bool_]
Ints = NDArray[np.int64]


class AdhesionSide:
    """Memory of the drives' healthy loads; `judge` per tick is the only mutator."""

    def __init__(
        self, config: Adhesion, motors: Sequence[Motor], timing: Timing, tick_ns: Nanos
    ) -> None:
        """timing: of the common-mode flag; motors: per drive."""
        self.config = config
        self.rated = tuple(motor.T_rated for motor in motors)
        n = len(motors)
        self._rotors, self._at, self._heard = loads.rotors(motors), loads.instant(n), loads.heard(n)
        self.timing = timing
        self.tick_ns = tick_ns
        self.tick_s = tick_ns / SECOND
        self.detector = make(config.detector, config.observe)
        spread = config.spread_nm / BASE_NM
        self.reference = reference.start(n, spread)
        self.response = response.start(n, spread)
        self._prepare = Direct(prepare)
        self._refer, self._severely = Direct(compiled.refer), Direct(compiled.severely)
        self._answer, self._fuse = Direct(compiled.respond), Direct(compiled.fuse)
        self._watch, self._learn_loads = Direct(compiled.watch), Direct(compiled.learn)
        self._learn_response = Direct(compiled.learn_response)
        self.severe = np.zeros(n, dtype=np.bool_)
        """Drives that carry so much less than the others that noise cannot be the cause."""
        self.common = FlagState()
        """Whether all drives have lost adhesion at once."""
        self._learn_ns: Nanos | None = None
        self._known: list[Nanos | None] = [None] * n
        """Since when each load has been known."""
        self._bad_ns: Nanos | None = None
        """When last any wheel was lost."""

    def judge(
        self,
        told: Told,
        slow: SlowState,
        fresh: Flags,
        flag: Ints,
        since_ns: Ints,
        now: Nanos,
    ) -> Opinion:
        """Probabilities of lost adhesion.

        fresh (N,): which drives' commands are known; flag, since_ns (N,): their adhesion flags so
        far, and since when the evidence of each is the same.
        """
        at, heard = self._at, self._heard
        self._prepare(told, slow, fresh, flag, since_ns, now, self.tick_s, self._rotors, at, heard)
        known = at.known.tolist()
        referred, spread = np.empty_like(at.load), np.empty_like(at.load)
        self._refer(self.reference, at.load, at.share, PASSING, referred, spread)
        compared = self.detector(Evidence(referred, spread, at.known, self._speeds(told)))
        self._known = [
            (now if since is None else since) if sure else None
            for since, sure in zip(self._known, known, strict=True)
        ]
        opinion, alone = self._respond(compared, heard)
        # Of what the others carry, or with nobody to compare with, of the command.
        self._severely(
            opinion.common, heard, referred, spread, at.known, SEVERE, SEVERE_SPREADS,
            self.severe,
        )  # fmt: skip
        self._common_mode(alone.tolist(), heard.usable.tolist(), known, now)
        self._learn(at, heard, opinion, flag, now)
        return opinion

    def _respond(self, compared: Opinion, heard: response.Heard) -> tuple[Opinion, Array]:
        """The opinion with every drive's own response, and the response alone."""
        n = len(self._known)
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
        flag: Ints,
        now: Nanos,
    ) -> None:
        """Responses from every new command, differences between drives every LEARN_NS."""
        answered = min(heard.age_s.tolist()) < self.tick_s
        due = self._learn_ns is None or now >= self._learn_ns
        if not (answered or due):
            return
        healthy = self._healthy(opinion, flag.tolist(), now)
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

    def _speeds(self, told: Told) -> Array | None:
        """Rotor speeds in the direction of travel, where the detector observes them."""
        return None if self.config.observe == "torque" else np.abs(told.speed)

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

    def _healthy(self, opinion: Opinion, flags: Sequence[int], now: Nanos) -> Flags:
        """(N,) drives that may be learnt from: none while any is lost, or finds its grip again."""
        if Flag.BAD in flags:
            self._bad_ns = now
        if self._bad_ns is not None and now < self._bad_ns + FOLLOWING_NS:
            return np.zeros(len(flags), dtype=np.bool_)
        settled = [
            since is not None and now - since >= SETTLED_NS and flag == Flag.GOOD
            for since, flag in zip(self._known, flags, strict=True)
        ]
        return np.array(settled) & opinion.known & (opinion.lost < PROBABLY_GOOD)
