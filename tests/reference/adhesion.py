"""Adhesion in Python, which `loads.c` and `adhesion.c` in `gateway/core` are compared with.

What they call is that of the core, each compared with a reference of its own: the train, load
ratios, responses, variational Bayes, and the debouncing of one flag.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from statistics import median_low
from types import SimpleNamespace
from typing import Any, Final

import numpy as np
from _traction_core import ffi, lib
from numpy.typing import NDArray

from dbc.records import (
    COMMAND_RESPONSE,
    FLAG,
    LOAD_OBSERVATION,
    LOAD_RATIO,
    LOAD_SPREAD,
    ROTOR,
    ROTOR_INPUTS,
    Records,
    pointer,
)
from estimators.detect import Evidence
from estimators.detect.switching import Switching
from estimators.detect.variational import VariationalDetector
from gateway.core.codes import NEVER, Flag, Health
from gateway.settings.config import Motor
from tests.columns import SlowState, Told
from tests.reference import common_loss, regrip
from tests.reference.train import (
    LEAST_SPEED_RAD_S,
    MOST_CREEP,
    UNCOMMANDED,
    UNCOMMANDED_RELATIVE,
)

DERATING_NS: Final = 2_000_000_000
COASTING: Final = 0.05
RATIO_FLOOR: Final = 0.2
RATIO_UNKNOWN: Final = 0.1
ENOUGH_TO_COMPARE: Final = 2
LEAST_LOAD: Final = 0.07
MORE_LOAD: Final = 0.10
ACCUSING_LOAD: Final = 0.2
LOAD_TAU_S: Final = 0.2
LEARN_NS: Final = 50_000_000
PROBABLY_GOOD: Final = 0.5
SETTLED_NS: Final = 300_000_000
SEVERE_SHARE: Final = 0.35
SEVERE_SIGMA: Final = 6.0
TRANSIENT_SPREAD: Final = 0.035

Array = NDArray[np.float64]
Ints = NDArray[np.int64]
Flags = NDArray[np.bool_]


class Adhesion:
    """N drives; one `tick` after the other."""

    def __init__(
        self, motors: Sequence[Motor], rules: Records, tick_ns: int, spread: float,
        model: Switching | None = None,
    ) -> None:  # fmt: skip
        """model: of the detector `switching`, for itself alone; None: variational Bayes."""
        n, self.model = len(motors), model
        self.n, self.tick_s, self.tick_ns = n, tick_ns / 1e9, tick_ns
        self.rules = ffi.from_buffer("struct flag_rules *", rules)
        self.detector = VariationalDetector()
        self.rotors, self.inputs = np.zeros(n, ROTOR), np.zeros(n, ROTOR_INPUTS)
        self.rotors["rated_nm"] = [m.T_rated for m in motors]
        self.rotors["inertia_kg_m2"] = [m.J for m in motors]
        rated = [motor.T_rated for motor in motors]
        self.rotors["motor"] = [rated.index(mine) for mine in rated]
        lib.train_reset(pointer("struct rotor", self.rotors), n)
        self.responses = np.zeros(n, COMMAND_RESPONSE)
        self.differences, self.own = self._learnt(spread), self._learnt(spread)
        self.flag = np.zeros(1, FLAG)
        self.ratio, self.load, self.asked = np.ones(n), np.zeros(n), np.ones(n)
        self.flagged_ns, self.known_ns, self.held_s = [NEVER] * n, [NEVER] * n, [0.0] * n
        self.unknown_s, self.most_asked, self.carried = [0.0] * n, np.zeros(n), np.zeros(n, bool)
        self.common = 0.0
        self.speed, self.gain = [math.nan] * n, [0.0] * n
        self.any_flagged_ns = self.learn_ns = NEVER
        self.smoothed, self.comparable = math.nan, False
        self.together = common_loss.CommonLoss()

    def _learnt(self, spread: float) -> Any:
        made = SimpleNamespace(all=np.zeros(1, LOAD_SPREAD), drives=np.zeros(self.n, LOAD_RATIO))
        made.spread = pointer("struct load_spread", made.all)
        made.each = pointer("struct load_ratio", made.drives)
        lib.load_reference_reset(made.spread, made.each, self.n, spread)
        return made

    def tick(
        self, told: Told, slow: SlowState, measured: Array, commanded: Flags, flag: Ints,
        since_ns: Ints, now: int,
    ) -> None:  # fmt: skip
        """measured (N,): rad/s; commanded (N,); flag, since_ns (N,): adhesion flags so far."""
        self._train(told, slow, measured, commanded, flag, now)
        self._relate(told, slow, flag, since_ns, now)
        spread, each = self.differences.spread, self.differences.each
        given = list(zip(self.load.tolist(), self.ratio.tolist(), strict=True))
        self.normalised = np.array([
            lib.normalise_load(each + k, *one) for k, one in enumerate(given)
        ])  # fmt: skip
        self.sigma = np.array([
            lib.normalised_sigma(spread, each + k, *one, TRANSIENT_SPREAD)
            for k, one in enumerate(given)
        ])  # fmt: skip
        if self.model is not None:
            self._judge(self.model, flag, now)
        else:
            along = math.copysign(1.0, sum(self.normalised[self.known].tolist())) * self.normalised
            compared = self.known & (self.rotors["sliding"] == 0) & ~(along < -MORE_LOAD)
            evidence = Evidence(self.normalised, self.sigma, compared)
            lost, known, self.common = self.detector(evidence)
            self._fuse(lost.tolist(), known.tolist(), now)
        self._end(now)
        answered = bool((self.responses["command_age_s"] < self.tick_s).any())
        self._learn(answered, slow, flag, now)

    def _train(
        self, told: Told, slow: SlowState, measured: Array, commanded: Flags, flag: Ints, now: int
    ) -> None:
        one = self.inputs
        one["measured_rad_s"], one["speed_rad_s"], one["load_nm"] = measured, told.speed, told.load
        one["health"], one["command_nm"] = told.health, slow.command
        one["previous_command_nm"], one["operating"] = slow.before, slow.operating
        one["command_valid"], one["adhesion"], one["not_judged"] = commanded, flag, 0
        emergency = slow.emergency_ns
        waits = (now < emergency + 300_000_000) & (slow.command_ns < emergency + 10_000_000)
        one["may_be_off"], one["withdrawn"] = (emergency >= 0) & waits, 0
        lib.assess_train(
            pointer("struct rotor", self.rotors), pointer("struct rotor_inputs", one), self.n, now,
            self.tick_s, pointer("double", np.zeros(2 * self.n)),
        )  # fmt: skip
        gone = one["not_judged"] == 1
        told.health[gone], told.reason[gone] = one["health"][gone], one["health_reason"][gone]
        for column in (told.speed, told.load, told.sigma, told.nis):
            column[gone] = math.nan

    def _relate(self, told: Told, slow: SlowState, flag: Ints, since_ns: Ints, now: int) -> None:
        fresh, rated = self.inputs["command_valid"] == 1, self.rotors["rated_nm"]
        bad = flag == Flag.BAD
        self.derating = bad | (now < since_ns + DERATING_NS)
        self.flagged_ns = [now if b else t for b, t in zip(bad, self.flagged_ns, strict=True)]
        asked = np.abs(slow.command) / rated
        forgotten = self.most_asked * (1.0 - min(self.tick_s / 10.0, 1.0))
        self.most_asked = np.maximum(np.where(fresh, asked, 0.0), forgotten)
        largest = max([0.0, *asked[fresh].tolist()])
        self.ratio[:] = self.asked[:] = 1.0
        if largest > COASTING:
            steady = bool((slow.steady | self.derating).all())
            self._compare_commands(asked / largest, fresh & (steady | self.derating), now)
        health = told.health == Health.TRACKING
        self.known = health & (self.rotors["above"] == 0) & (self.ratio >= RATIO_UNKNOWN)
        self.ratio = np.maximum(self.ratio, RATIO_FLOOR)
        load = np.where(np.isnan(told.load), 0.0, told.load)
        turned = self.rotors["forward"]
        self.load = np.where(turned != 0, turned, np.where(load < 0.0, -1, 1)) * load / rated
        self.estimated = np.where(np.isnan(told.sigma), 0.0, told.sigma) / rated
        self.source = told.estimates["by_observer"].copy()
        alone = np.count_nonzero(self.known) < ENOUGH_TO_COMPARE
        mine = self.responses
        mine["load"] = load / rated + self.rotors["acceleration_torque"]
        mine["braked_load"] = mine["load"] + self.rotors["brake_torque"]
        mine["acceleration_torque"] = [
            self._spin_up(k, told.speed.item(k) if alone else math.nan) for k in range(self.n)
        ]
        for name, command in (("command", slow.command), ("previous_command", slow.before)):
            mine[name] = np.where(np.isnan(command), 0.0, command) / rated
        mine["command_age_s"] = (now - slow.command_ns) / 1e9
        mine["usable"] = fresh & self.known

    def _compare_commands(self, shares: Array, compared: Flags, now: int) -> None:
        loads = self.rotors["load"].tolist()
        counted = [
            load for load, then in zip(loads, self.flagged_ns, strict=True)
            if not math.isnan(load) and not (then != NEVER and now < then + DERATING_NS)
        ]  # fmt: skip
        common = median_low(counted) if counted else math.nan
        for k in np.flatnonzero(compared).tolist():
            share = shares.item(k)
            self.asked[k] = max(share, RATIO_FLOOR)
            off = abs(loads[k] / share - common) if share > 0.0 else math.inf
            if not abs(loads[k] - common) < off:
                self.ratio[k] = share

    def _spin_up(self, k: int, speed: float) -> float:
        before, last = self.speed[k], self.gain[k]
        if math.isnan(before):
            before, last = speed, 0.0
        self.speed[k] = speed
        if math.isnan(speed):
            return 0.0
        rotor = self.rotors[k]
        self.gain[k] = float(
            rotor["inertia_kg_m2"] * (speed - before) / self.tick_s / rotor["rated_nm"]
        )
        return self.gain[k] if abs(self.gain[k]) >= abs(last) else last

    def _judge(self, model: Switching, flag: Ints, now: int) -> None:
        """As `switching_loss.c`."""
        load = self.load / self.ratio
        model.loads["known"] = known = self.known & np.isfinite(load)
        model.loads["apart"] = regrip.apart(self.known, self.rotors["away"] != 0, self.held_s)
        model.loads["unsure"] = self.rotors["away"] | self.rotors["uncertain"]
        model.loads["load"] = np.clip(np.where(known, load, 0.0), -2.0, 2.0)
        model.loads["gain"] = 1.0 / self.ratio - 1.0
        moved = np.where(self.ratio < 1.0, self.responses["command_age_s"], 1.0 - self.asked)
        error = np.abs(model.loads["load"]) * np.clip(moved / self.asked, 0.0, 0.3)
        model.loads["error"] = np.where(self.derating & (self.asked < 1.0), error, 0.0)
        model.loads["sigma"], model.loads["source"] = self.estimated, self.source
        full = np.abs(self.responses["command"]) >= 0.9 * self.most_asked
        # More than any drive was ever asked for: what one that grips again carries.
        most = (1.0 + UNCOMMANDED_RELATIVE) * self.most_asked + UNCOMMANDED
        beyond = (self.inputs["command_valid"] == 1) & (abs(self.common) > most)
        model.loads["answers"] = (full & self.carried) | beyond
        if self.n > 1:
            lib.switching_tick(model.pointer)
            self.common = model.record["demand"].item()
        else:
            model.adhering[:], model.lost[:] = 1.0, 0.0
            self.common = model.record["demand"] = model.loads["load"].item()
        adhering, lost = model.adhering.copy(), model.lost.copy()
        model_p = list(zip(adhering, lost, strict=True))
        two = np.count_nonzero(self.known) >= 2
        alone, valid, each = self._alone()
        self.carried = np.array([bool(valid[k]) and alone[k] <= 0.1 for k in range(self.n)])
        compared = self._limited([0.0] * self.n, (self.known & two).tolist())
        usable = self.responses["usable"] == 1
        counts = np.flatnonzero(self.known & (adhering > 0.5)).tolist()
        meant = usable[self.known].all() and all(valid[k] for k in counts)
        everyone = self.together.follow(self, alone, counts if meant else [])
        self.lost, self.lost_known, self.severe = [], [], []
        asked = np.array([bool(lib.is_asked(each + k)) for k in range(self.n)])
        holding = self.known & (adhering >= 0.5) & (self.rotors["far"] == 0)
        pulls = bool(np.any(holding & asked & (self.rotors["away"] == 0)))
        for k in range(self.n):
            rotor, is_asked = self.rotors[k], asked[k]
            rolls = self._rolls(k, pulls if asked.any() else None)
            own = load[k], self.common, *(model_p[k] if self.known[k] else (math.nan, math.nan))
            grips = (flag[k] == Flag.BAD or self.held_s[k] > 0.0) and regrip.grips(
                rotor, *own, alone[k] if valid[k] else math.nan
            )
            if rolls or grips:
                if not rolls:
                    self._regrip(k, True, adhering[k] * self.known[k], flag[k] == Flag.BAD)
                self.lost.append(0.0)
                self.lost_known.append(True)
                self.severe.append(False)
                continue
            uncertain = int(rotor["uncertain"])
            p = lost[k] + adhering[k] * everyone
            beside = np.flatnonzero(holding & self.carried & full)
            seems_lost = alone[k] >= lib.UNDECIDED and np.any(beside != k)
            if valid[k] and (rotor["away"] or seems_lost):
                p = max(p, alone[k])
            behind = valid[k] and alone[k] >= self.rules.raise_probability
            if self.carried[k] and full[k] and not holding.any():
                p = alone[k]
            elif p >= self.rules.raise_probability and not holding.any() and not behind:
                rotor["uncertain"] = 1
                p = lib.UNDECIDED
            elif p < self.rules.raise_probability:
                if everyone and adhering[k] >= 0.5:
                    p = lib.UNDECIDED
                elif not (adhering[k] >= 0.5 and (flag[k] == Flag.BAD or lost[k] <= 0.1)):
                    rotor["uncertain"] = 1
            elif is_asked and not valid[k] and not rotor["away"]:
                p = lib.UNDECIDED
            holds, low = adhering[k] * self.known[k], p <= self.rules.clear_probability
            self._regrip(k, low and holds >= 0.5, holds, flag[k] == Flag.BAD)
            p = self._held_back(k, p, flag[k] == Flag.BAD, uncertain)
            said = self.known[k] and (compared[k] or is_asked)
            slow = not (valid[k] and alone[k] > 0.5) and not abs(self.smoothed) >= ACCUSING_LOAD
            bare = (usable[k] and not is_asked) or (slow and everyone == 0.0)
            self.lost_known.append(bool(said and not (bare and lost[k] >= 0.7)))
            p = self._doubted(k, p, now)
            self.lost.append(p)
            self.severe.append(bool(self.known[k] and p >= 0.99))
        self.alone, self.each = alone, each

    def _rolls(self, k: int, pulls: bool | None) -> bool:
        """pulls: a wheel that adheres drives the train; None: no drive is asked for anything."""
        if pulls is None:
            return bool(self.responses["usable"][k]) and regrip.rolls(self.rotors[k])
        commands = self.responses["command"][k], self.responses["previous_command"][k]
        cut_out = regrip.is_cut_out(*commands, self.most_asked[k])
        valid = bool(self.inputs["command_valid"][k])
        return pulls and valid and cut_out and regrip.turns_freely(self.rotors[k])

    def _regrip(self, k: int, grips: bool, holds: float, bad: bool) -> None:
        """For how long what drive k lacks may be its own slip control's."""
        gap = self.known[k] and self.unknown_s[k] >= 0.1 and not bad
        self.held_s[k] = regrip.held_back_s(
            self.rotors[k], self.held_s[k], self.common, gap, grips, holds, bad, self.tick_s
        )

    def _held_back(self, k: int, p: float, bad: bool, uncertain: int) -> float:
        """What a drive lacks after a regrip, or when it is known again, accuses nobody."""
        rotor, low = self.rotors[k], self.rules.clear_probability
        if self.held_s[k] == 0.0 or rotor["away"] or p <= low:
            return p
        clears = bad and rotor["apart"]
        rotor["uncertain"] = uncertain if clears else 1
        return 0.0 if clears else float(lib.UNDECIDED)

    def _doubted(self, k: int, p: float, now: int) -> float:
        rotor = self.rotors[k]
        doubt = now < rotor["unreliable_until_ns"] or rotor["uncommanded_s"] > 0.0
        doubt = doubt or self.inputs["may_be_off"][k]
        if not (doubt and p > lib.UNDECIDED):
            return p
        rotor["uncertain"] = 1
        return float(lib.UNDECIDED)

    def _follow_brakes(self) -> None:
        """Creep that each wheel has if not brakes but a loss of all slows its rotor."""
        r = self.rotors
        slow = np.fmax(np.abs(r["quick_speed"]), LEAST_SPEED_RAD_S)
        torque = np.abs(r["acceleration_torque"] + r["brake_torque"]) * r["rated_nm"]
        gained = torque / (r["inertia_kg_m2"] * slow)
        braked = self.responses["braked"] == 1
        creep = r["braked_creep"] + np.where(braked, gained, -MOST_CREEP / 1.0) * self.tick_s
        r["braked_creep"] = np.clip(creep, 0.0, MOST_CREEP)
        r["uncertain"][creep > MOST_CREEP] = 1

    def _alone(self) -> tuple[list[float], Any, Any]:
        """What every drive says by itself, which of that means something."""
        each, n = pointer("struct command_response", self.responses), self.n
        valid = pointer("uint8_t", np.zeros(n, dtype=np.uint8))
        alone = [
            lib.respond(each + k, self.own.spread, self.own.each + k, self.tick_s, valid + k)
            for k in range(n)
        ]
        self._follow_brakes()
        odd = self.rotors["odd_s"] > 0.0
        return [min(p, lib.UNDECIDED) if odd[k] else p for k, p in enumerate(alone)], valid, each

    def _fuse(self, lost: list[float], known: list[bool], now: int) -> None:
        n = self.n
        alone, valid, each = self._alone()
        known = self._limited(lost, known)
        self.lost, self.lost_known, self.severe = [], [], []
        for k in range(n):
            rotor = self.rotors[k]
            p = lib.fuse_loss(each + k, lost[k], known[k], alone[k], valid[k], rotor["away"])
            self.lost.append(self._doubted(k, p, now))
            self.lost_known.append(known[k] or bool(lib.is_asked(each + k)))
            severe = lib.is_severe_loss(
                each + k, self.common, self.normalised[k], self.sigma[k], SEVERE_SHARE,
                SEVERE_SIGMA,
            )  # fmt: skip
            self.severe.append(bool(self.known[k] and severe))
        self.alone, self.each = alone, each

    def _end(self, now: int) -> None:
        """Since when loads are known; all drives at once."""
        alone, each = self.alone, self.each
        for k in np.flatnonzero(self.rotors["sliding"]):
            self.lost[k], self.lost_known[k], self.severe[k] = 1.0, True, True
        for k in range(self.n):
            since = now if self.known_ns[k] == NEVER else self.known_ns[k]
            self.known_ns[k] = since if self.known[k] else NEVER
            self.unknown_s[k] = 0.0 if self.known[k] else self.unknown_s[k] + self.tick_s
        lib.debounce(
            pointer("struct flag", self.flag), self._of_all(alone, each),
            self.rules.timing + lib.FLAG_ADHESION, self.rules.tick_ns, now,
        )  # fmt: skip

    def _limited(self, lost: list[float], known: list[bool]) -> list[bool]:
        if not any(known):
            self.smoothed = math.nan
            return known
        if math.isnan(self.smoothed):
            self.smoothed = self.common
        self.smoothed += min(self.tick_s / LOAD_TAU_S, 1.0) * (self.common - self.smoothed)
        self.comparable = abs(self.smoothed) >= (LEAST_LOAD if self.comparable else MORE_LOAD)
        little = min(abs(self.smoothed), abs(self.common)) < MORE_LOAD
        return [
            yes and self.comparable and not (little and p > lib.UNDECIDED)
            for yes, p in zip(known, lost, strict=True)
        ]

    def _of_all(self, alone: list[float], each: Any) -> int:
        mine = np.flatnonzero(self.known).tolist()
        if not any(not lib.is_coasting(each + k) for k in mine):
            return int(Flag.UNKNOWN)
        lost = min(alone[k] for k in mine)
        if not all(self.responses[k]["usable"] for k in mine):
            return int(Flag.UNKNOWN)
        if not (len(mine) == self.n or lost <= self.rules.clear_probability):
            return int(Flag.UNKNOWN)
        return int(lib.loss_evidence(self.rules, lost))

    def _learn(self, answered: bool, slow: SlowState, flag: Ints, now: int) -> None:
        due = now >= self.learn_ns
        if not (answered or due):
            return
        if bool(((flag == Flag.BAD) & slow.operating).any()):
            self.any_flagged_ns = now
        shaken = self.any_flagged_ns != NEVER and now < self.any_flagged_ns + DERATING_NS
        healthy = np.array([
            since != NEVER and now - since >= SETTLED_NS and flag[k] == Flag.GOOD
            and self.lost_known[k] and self.lost[k] < PROBABLY_GOOD and not shaken
            for k, since in enumerate(self.known_ns)
        ], dtype=np.uint8)  # fmt: skip
        observed = np.zeros(self.n, LOAD_OBSERVATION)
        seen = pointer("struct load_observation", observed)
        if answered:
            lib.learn_responses(
                pointer("struct command_response", self.responses), self.own.spread, self.own.each,
                pointer("uint8_t", healthy), self.n, self.tick_s, seen,
            )  # fmt: skip
        if due:
            self.learn_ns = now + LEARN_NS
            observed["load"], observed["common"] = self.load / self.ratio, self.common
            observed["known"], observed["healthy"] = self.known, healthy
            mine = self.differences
            lib.update_spread(mine.spread, mine.each, seen, self.n, 1)
            lib.update_ratios(mine.spread, mine.each, seen, self.n, 1)
