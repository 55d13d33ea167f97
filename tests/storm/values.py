"""Rules of the oracle for wrong values behind right checksums, and for wheels that run away.

- wrong_values: `Adhering` of a drive whose values have been wrong for long enough to matter
- false_loss: `AdhesionLost` comes for a drive whose wheel holds, while its values are wrong or soon
  after
- others: the flag of a drive goes from `Adhering` because the values of another one are wrong
- creep: `Adhering` of a drive whose wheel has been creeping for long enough

Wrong values count while the drive turns and carries something, and the currents (or the measured
speed) that are sent are far enough off the true ones. Other faults of the bus take turns with them:
what is rejected says nothing, so the times begin anew behind them, and who is spoken for by a
second sender is not judged at all (R09). Currents that are late or another drive's since the
gateway began cannot be known from right ones: they have left no place of the current's angle.
"""

from typing import Final, NamedTuple

import numpy as np

from tests.storm.train import LOOP_TICKS
from tests.storm.value_faults import KINDS_OF_CURRENT, VALUE_KINDS, Error

GOOD, BAD = 1, 2
REACTION_TICKS: Final = 20
"""For so long wrong values, or a creeping wheel, may go unnoticed."""
AFTER_TICKS: Final = 300
"""Within so many the drive is itself again, and until then no loss may come of it."""
DISTURBED_TICKS: Final = 110
"""So long after another fault its consequences may last: a second sender is guarded for a second,
and frames may be late."""
HELD_TICKS: Final = 60
"""A wheel that has held for so long cannot be the cause of a loss that is found now."""
CREEP: Final = 0.1
"""Share of the train's speed."""
LEAST_SPEED: Final = 1.5
"""Times the least speed that is observable: from here on flags are known."""
LEAST_LOAD: Final = 0.2
"""Per unit of the rated torque."""
CURRENT_ERROR: Final = 0.15
"""Per unit of the rated current, root mean square."""
SPEED_ERROR_RPM: Final = 10.0
"""Of a speed that stands while the true one does not."""
BY_ANGLE: Final = frozenset({"late", "other_drive"})
LEARN_TICKS: Final = 60
"""These show by a step of the current's angle only, for which its place must have been learnt."""
FEWEST: Final = 2
"""Drives without which the others cannot be compared."""


class Truth(NamedTuple):
    """What is so at a tick, (N,) each: as in `Train`; error: of the values that were sent."""

    speed: np.ndarray
    lost: np.ndarray
    load: np.ndarray
    creep: np.ndarray
    error: Error


def truth_at(train, phase, error):
    """phase: of the train's round, in ticks."""
    k = phase % LOOP_TICKS
    return Truth(train.speed[k], train.lost[k], train.load[k], train.creep[k], error)


class ValueRules:
    """Judges the flags as last read, in every tick."""

    def __init__(self, config, tick):
        """tick: the gateway's first."""
        motors = [config.motors[d.motor] for d in config.drive]
        self.n = n = len(motors)
        least = LEAST_SPEED * config.estimator.min_speed_rad_s
        self.least_rad_s = np.array([least / m.pole_pairs for m in motors])
        self.least_nm = np.array([LEAST_LOAD * m.T_rated for m in motors])
        rms = [CURRENT_ERROR * m.I_rated / 2.0**0.5 for m in motors]
        self.least_a = np.array(rms)
        never = tick - max(AFTER_TICKS, DISTURBED_TICKS, HELD_TICKS) - 1
        self.before = [0] * n
        self.looked = tick - 1
        self.wrong = [0] * n
        """Ticks in a row that values have been wrong, and mattered."""
        self.creeping = [0] * n
        self.last_wrong = [never] * n
        """Last tick with a value fault, whether it mattered or not."""
        self.right = [0] * n
        """Ticks with right values of a drive that turns and carries something."""
        self.blind = [never] * n
        """Last tick with a fault that nobody can know, for it came before the right values."""
        self.doubled = [never] * n
        """Last tick with a second sender."""
        self.disturbed = tick
        """Last tick with another fault than wrong values, or first of the gateway."""
        self.slid, self.idle = [never] * n, [tick] * n
        """Last ticks in which the wheel did not hold, and in which the flag need not be known."""

    def look(
        self, tick, flags, sensor, truth, faults,
        broken,
    ):  # fmt: skip
        """One tick. flags, sensor: as last read from the wire."""
        self._note(tick, truth, faults)
        for d, flag in enumerate(flags):
            apart = tick - self.doubled[d] > DISTURBED_TICKS
            if flag == GOOD and self.creeping[d] > REACTION_TICKS and apart:
                what = f"Adhering, creep {100 * truth.creep[d]:.0f} % for {self.creeping[d]} ticks"
                broken(tick, "creep", d + 1, what)
            knowable = apart and tick - self.blind[d] > AFTER_TICKS
            if flag == GOOD and self.wrong[d] > REACTION_TICKS and sensor != BAD and knowable:
                broken(tick, "wrong_values", d + 1, f"Adhering after {self._of(d, faults)}")
            before = self.before[d]
            if before != BAD and flag == BAD and knowable and self._innocent(tick, d):
                broken(tick, "false_loss", d + 1, f"AdhesionLost of {self._of(d, faults)}")
            if before == GOOD and flag != GOOD and self._untouched(tick, d):
                broken(tick, "others", d + 1, f"from Adhering to {flag}, and its values are right")
        self.before = list(flags)

    @staticmethod
    def _of(drive, faults):
        kinds = [f.kind for f in faults if f.kind in VALUE_KINDS and f.drive == drive]
        return ", ".join(kinds) or "a fault that has ended"

    def _note(self, tick, truth, faults):
        gone = tick - self.looked > 1
        self.looked = tick
        if gone or any(f.kind not in VALUE_KINDS for f in faults):
            self.disturbed = tick
        of_current = {f.drive for f in faults if f.kind in KINDS_OF_CURRENT}
        any_wrong = {f.drive for f in faults if f.kind in VALUE_KINDS}
        turns = np.abs(truth.speed) > self.least_rad_s
        carries = np.abs(truth.load) > self.least_nm
        far = truth.error.current_a > self.least_a
        apart = truth.error.speed_rpm > SPEED_ERROR_RPM
        for d in range(self.n):
            if d in any_wrong:
                self.last_wrong[d] = tick
            by_angle = any(f.kind in BY_ANGLE and f.drive == d for f in faults)
            if by_angle and self.right[d] < LEARN_TICKS:
                self.blind[d] = tick
            self.right[d] += bool(turns[d] and carries[d] and d not in any_wrong)
            if any(f.kind == "second_sender" and f.drive in (None, d) for f in faults):
                self.doubled[d] = tick
            matters = (d in of_current and far[d]) or (d in any_wrong and apart[d])
            seen = turns[d] and carries[d] and self.disturbed != tick
            self.wrong[d] = self.wrong[d] + 1 if matters and seen else 0
            self.creeping[d] = self.creeping[d] + 1 if truth.creep[d] > CREEP and not gone else 0
            if truth.lost[d] or truth.creep[d] > CREEP:
                self.slid[d] = tick
            if not (turns[d] and carries[d]):
                self.idle[d] = tick

    def _innocent(self, tick, d):
        """The wheel holds and has held; the drive's values are wrong or were so of late."""
        held = tick - self.slid[d] > HELD_TICKS
        return held and tick - self.last_wrong[d] <= AFTER_TICKS

    def _untouched(self, tick, d):
        """Only another drive's values are wrong, and enough drives are left to compare."""
        recent = [tick - last <= AFTER_TICKS for last in self.last_wrong]
        if recent[d] or not any(recent) or self.n - sum(recent) < FEWEST:
            return False
        quiet = tick - self.disturbed > DISTURBED_TICKS
        held = all(tick - slid > HELD_TICKS for slid in self.slid)
        return quiet and held and all(tick - idle > HELD_TICKS for idle in self.idle)
