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
from _traction_core import lib
from numpy.typing import NDArray

from dbc.frame import MS, SECOND, Nanos
from dbc.records import Records
from estimators.detect import Evidence, Opinion, make
from gateway import flags, loads, train
from gateway._adhesion_kernels import compare, conclude, teach
from gateway._direct import Direct
from gateway._train_kernels import assess_train
from gateway.config import Adhesion, Motor
from gateway.health import NEVER
from gateway.inputs import Inputs
from gateway.slow import SlowState
from gateway.tracks import Told

LEARN_NS: Final[Nanos] = round(lib.LEARN_PERIOD_S * SECOND)
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
        self, config: Adhesion, motors: Sequence[Motor], rules: Records, tick_ns: Nanos
    ) -> None:
        """rules: of the flags; motors: per drive."""
        self.config = config
        self.rated = tuple(motor.T_rated for motor in motors)
        n = len(motors)
        self.rotors, self.at = loads.rotors(motors), loads.instant(n)
        self.responses = loads.responses(n)
        self.train = train.start(motors)
        self.rotors = self.rotors._replace(
            taken=self.train.rotors["acceleration_torque"],
            load=self.train.rotors["load"],
            above=self.train.rotors["above"],
            rank=self.train.rank,
        )
        self.rules = rules
        self.tick_s = tick_ns / SECOND
        self.detector = make(config.detector, config.observe)
        spread = config.spread_nm / BASE_NM
        self.reference = loads.load_reference(n, spread)
        """Of drives that are compared with one another."""
        self.own = loads.load_reference(n, spread)
        """Of each drive's load over its own command."""
        self.common_mode = flags.flag(0)
        """One flag: whether all drives have lost adhesion at once."""
        self.trust, self.room = loads.trust(n), loads.room(n)
        self.severe = self.room.severe
        """(N,) drives that carry so much less than the others that noise cannot be the cause."""
        self._compare, self._conclude = Direct(compare), Direct(conclude)
        self._teach, self._assess = Direct(teach), Direct(assess_train)
        self.learn_ns: Nanos = NEVER

    def judge(
        self, told: Told, slow: SlowState, inputs: Inputs, flag: Ints, since_ns: Ints, now: Nanos
    ) -> Opinion:
        """Probabilities of lost adhesion.

        inputs: speeds as measured, and which drives' commands are known, changed here where one
        cannot be right; flag, since_ns (N,): their adhesion flags so far, and since when the
        evidence of each is the same.
        """
        at, responses, room = self.at, self.responses, self.room
        fresh = inputs.commanded
        self._assess(inputs.speed, fresh, slow, flag, now, self.tick_s, told, self.train)
        self._compare(
            told, slow, fresh, flag, since_ns, now, self.tick_s, self.rotors, self.reference,
            PASSING, at, responses, room,
        )  # fmt: skip
        speeds = None if self.config.observe == "torque" else np.abs(told.speed)
        lost, known, common = self.detector(
            Evidence(room.referred, room.spread, at.known, speeds)
        )  # fmt: skip
        answered = self._conclude(
            lost, known, common, now, self.tick_s, self.own, at, responses, self.train,
            SEVERE, SEVERE_SPREADS, self.rules, self.common_mode, self.trust, room,
        )  # fmt: skip
        return self.learn(answered, common, flag, slow.operating, now)

    def learn(
        self, answered: bool, common: float, flag: Ints, operating: Flags, now: Nanos
    ) -> Opinion:
        """Responses from every new command, differences between drives every LEARN_NS.

        Gives this tick's opinion.
        """
        if answered or now >= self.learn_ns:
            self._learn(answered, common, flag, operating, now)
        return Opinion(self.room.lost, self.room.known, common)

    def _learn(
        self, answered: bool, common: float, flag: Ints, operating: Flags, now: Nanos
    ) -> None:
        due = now >= self.learn_ns
        if due:
            self.learn_ns = now + LEARN_NS
        self._teach(
            answered, due, now, self.tick_s, common, flag, operating, self.reference, self.own,
            self.at, self.responses, SETTLED_NS, PROBABLY_GOOD, self.trust, self.room,
        )  # fmt: skip
