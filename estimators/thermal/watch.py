"""Thermal faults while they happen: N motors, bounded memory, some microseconds a motor and second.

Every motor's heat (`heat`) runs open loop beside it, from the currents, the speed and the ambient
temperature on the bus. What its readings differ by is taken together in blocks of seconds (medians:
noise and bursts do not count), less what the other motors differ by (weather and what the model
does not know are the same for all), and goes to one Kalman filter for each explanation, of which
one is true at a time (interacting multiple models, Blom and Bar-Shalom 1988): nothing but
disturbances, which every motor has; a kind of heat, whose size is a state; a sensor that is off. A
fault of heat shows itself by where it comes in and what it goes with: friction with speed, a
winding's resistance with the current squared, lost cooling with the frame's own rise. Steps of
sensors (`steps`) and bursts of loose connectors are told apart before.

In place of paper `thermal`, eq. (28)-(31): a filter without the faults among its explanations
follows a fault, and the spread between motors does not tell which motor or what.
"""

from __future__ import annotations

from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from estimators.thermal import _models_kernels as models
from estimators.thermal import _steps_kernels, _watch_kernels, heat, steps
from estimators.thermal.hypotheses import HEAT, KINDS, SENSORS

Array = NDArray[np.float64]

BLOCK_SHARE: Final = 0.08
"""Of the quickest lump's time constant, that readings are taken together."""
LONGEST_BLOCK_S: Final = 60.0
DISTURBANCES: Final = np.array([0.01, 0.7, 0.02, 0.05, 0.05])
"""Of a motor's own: share of its copper loss, K of its air, share of its cooling air, of the
friction in its ends; standard deviations of what wanders. What is constant is in its parameters."""
MEMORY_S: Final = 900.0
"""Of what wanders."""
BEGIN_S, END_S = 36_000.0, 3600.0
"""A fault is expected once in so long, and to last so long."""
UNSURE: Final = 0.6
"""Share of a lump's own exchange of heat that the model may be wrong by: five lumps stand for what
has no number."""
WALK_K, WALK_SHARE = 0.2, 0.03
"""A size changes by this from block to block."""
CREEP_K_PER_S: Final = 0.003
"""A sensor may creep away by so much, for as long as `MEMORY_S`."""
WALK_SENSOR_K: Final = 0.3
"""A sensor's error changes by this, besides. With more of it heat is less taken for a creeping
sensor, and a creeping sensor more for heat: 0.2 misnames 2 % of overheating."""
CAUGHT_K, RARER = 1.5, 0.1
"""Where `steps` are looked for: how far a sensor may be off at once (more would have been caught),
and how much rarer one is that creeps, for most sensors step."""
OWN_K: Final = 0.02
"""Deviation that a lump takes on by itself, per root of a minute."""
UNSTEADY: Final = 0.3
"""Share of a block's heat: a fault begins somewhere in a block."""
WIDE_K: Final = 5.0
"""How far off a block may be that is not what it seems."""
SIZES_K: Final = np.array(
    [
        [0.0, 0.0, 0.0, 0.0],
        [15.0, 25.0, 0.0, 0.125],
        [12.0, 8.0, 0.0, 0.125],
        *[[8.0, 10.0, 0.0, 0.125]] * 2,
        [8.0, 6.0, 0.0, 0.125],
        *[[0.0, 6.0, CREEP_K_PER_S, 0.125]] * 3,
    ]
)
"""Mean and deviation of a fault's size when it begins, how fast it creeps, K/s, and its share.

Of heat: K at the mean duty when settled. What heats a winding or a bearing may be of any power.
"""
ANY_POWER: Final = 100.0
"""Times those deviations, of the winding and the bearings of a motor that steps are not looked for
in: its sensor's is all that bends too fast for heat, else."""
BENIGN_K: Final = np.array([1.5, 4.0, 1.5, 1.5, 1.5, 1.5, 1.5, 1.5])
"""Smaller ones are dirt, draught, weather and wear."""
SHOWN_K: Final = 0.6
"""What heat has to have made of some reading by now; before, draught does as much in a minute."""
BURSTS: Final = np.array([0.04, 1e-6, 6.0, 5.0, 3.0])
"""Share of a loose and of a good connector's readings that are far off, standard deviations that
are far, readings of one burst: they are not independent; K within a block that heat can do."""
LOOSE_BEGIN_S, LOOSE_END_S = 30_000.0, 3600.0
LEARNT_S: Final = 7200.0
"""Time constant of a motor's baseline, which is learnt while there is no fault."""
SURE: Final = 1.0 - 1e-6
LEAST_NOISE_K: Final = 0.01
RETURNED_K: Final = 2.0
"""A sensor that has crept and stepped is off by no more."""
STEADY_S: Final = 100.0
"""A motor whose quickest lump has a shorter time constant than this bends so fast that `steps`
would take its heat for a sensor's: nothing is tested, the filters have to tell."""
HOLE_S: Final = 60.0
"""After so long without knowing how it was driven, a motor begins anew."""


class Known(NamedTuple):
    """What fault-free runs have shown of a train's motors.

    parameters (M, 18): see `heat`; centre (M, 3) K: residual beside the peers'; noise (M, 3) K: of
    single readings; scale: of `DISTURBANCES`; duty (4,): mean speed rad/s, and means of the
    squared current A^2, of the frame's cooling and of the winding's heating K/s, of the fleet.
    """

    parameters: Array
    centre: Array
    noise: Array
    scale: float
    duty: Array


class Watch:
    """State of all motors; `take` per sample, `work` when a block is complete."""

    def __init__(self, known: Known, dt_s: float) -> None:
        """Samples come `dt_s` apart."""
        self.known, self.dt_s = known, dt_s
        motors = len(known.parameters)
        rates = known.parameters[:, [heat.K_W, heat.K_D, heat.K_N]]
        quickest = float(rates.mean(axis=0).max())
        wanted = min(BLOCK_SHARE / quickest, LONGEST_BLOCK_S)
        self.together = max(round(wanted / dt_s), 1)
        self.block_s = self.together * dt_s
        self.unit = _unit(known)
        self.odds = np.array(
            [
                1 / BEGIN_S, 1 / END_S, MEMORY_S, UNSURE, WALK_K, WALK_SHARE, OWN_K, WIDE_K,
                UNSTEADY, WALK_SENSOR_K,
            ]
        )  # fmt: skip
        self.loose_odds = np.array([1 / LOOSE_BEGIN_S, 1 / LOOSE_END_S, 1 / LEARNT_S])
        self.sigma = known.scale * DISTURBANCES
        self.counts = np.array([round(s / dt_s) for s in (steps.BEFORE_S, steps.AFTER_S)])
        steady = quickest * STEADY_S < 1.0
        tested = dt_s <= steps.SLOWEST_S and steady
        self.sizes = SIZES_K.copy()
        if not steady:
            self.sizes[models.LOCAL, models.SPREAD] *= ANY_POWER
        if tested or not steady:
            self.sizes[1 + len(HEAT) :, models.SPREAD] = CAUGHT_K
        if tested:
            self.sizes[1 + len(HEAT) :, models.SHARE] *= RARER
            self.sizes[:, models.SHARE] /= self.sizes[:, models.SHARE].sum()
        self.how = np.array([
            steps.STEP_K if tested else 0.0, steps.BACK_K, steps.HEAT_K_PER_S * dt_s
        ])  # fmt: skip
        ring = int(self.counts.sum()) + round(steps.SETTLED_S / dt_s)
        self.noise_k = reading_noise(known.noise, self.together)
        self.begun = np.zeros(motors, dtype=np.bool_)
        self.unknown_s = np.zeros(motors)
        self.lumps = np.zeros((motors, heat.LUMPS))
        self.ring = np.full((motors, 3, ring), np.nan)
        self.jumps = np.empty((motors, 3, _steps_kernels.STATE))
        self.block = np.full((motors, 3, self.together), np.nan)
        self.raw = np.full_like(self.block, np.nan)
        self.sums = np.zeros((2, motors, _watch_kernels.INPUTS))
        self.inputs = np.zeros((motors, _watch_kernels.INPUTS))
        self.at = 0
        self.middle = np.full((motors, 3), np.nan)
        self.bursts = np.zeros((motors, 3))
        self.off = np.full((motors, 3), np.nan)
        self.trusted = np.ones(motors, dtype=np.bool_)
        self.shift = np.zeros((motors, 3))
        self.burst = np.empty((motors, 3, 2))
        self.mode = np.empty((motors, models.MODES))
        self.mean = np.empty((motors, models.MODES, models.STATES))
        self.cov = np.empty((motors, models.MODES, models.STATES, models.STATES))
        self.base = np.zeros((motors, 3))
        self.loose = np.zeros((motors, 3))
        self.kind = np.zeros((motors, len(KINDS)))
        self.size_k = np.zeros(motors)
        self.says = np.zeros(motors)
        self.ill = np.zeros(motors)
        """How probably something is wrong, before hysteresis."""
        self.held = np.zeros(motors, dtype=np.bool_)
        self.lost = np.zeros(motors, dtype=np.bool_)
        self.judged = np.zeros(motors, dtype=np.int64)
        """Blocks that a motor has been judged by."""
        self.waiting = 0
        """Motors of the last block that are not judged yet, the last ones."""
        self.late = np.zeros((motors, _watch_kernels.INPUTS))
        for m in range(motors):
            self._clear(m)

    def _clear(self, m: int) -> None:
        """Motor m begins anew."""
        self.begun[m], self.held[m] = False, False
        self.judged[m], self.size_k[m], self.ill[m] = 0, 0.0, 0.0
        self.late[m] = 0.0
        _watch_kernels.clear(
            m, self.sigma, self.sizes, self.ring, self.jumps, self.block, self.raw, self.sums,
            self.mode, self.mean, self.cov, self.base, self.burst, self.loose, self.kind,
        )  # fmt: skip

    def take(self, reading: Array, square: Array, speed: Array, ambient: Array) -> None:
        """One sample, NaN where there is none.

        reading (M, 3) degC; square (M,) A^2 of the current's amplitude; speed (M,) rad/s without
        sign; ambient (M,) degC.
        """
        known, before = self.known, self.begun.copy()
        # A view has another layout, so another kernel, which would be loaded in mid-run.
        reading, square, speed, ambient = (
            np.ascontiguousarray(part) for part in (reading, square, speed, ambient)
        )
        _watch_kernels.samples(
            known.parameters, known.centre, reading, square, speed, ambient, self.dt_s, HOLE_S,
            self.begun, self.unknown_s, self.lumps, self.sums[2 * self.at // self.together],
            self.ring, self.jumps, self.block, self.raw, self.at, self.counts, self.how, self.lost,
        )  # fmt: skip
        # Nobody sees the core: it may be as warm as the winding, or as the frame.
        new = self.begun & ~before
        span = self.lumps[new, heat.WINDING] - self.lumps[new, heat.FRAME]
        self.cov[new, :, heat.CORE, heat.CORE] += (0.5 * span[:, None]) ** 2
        for m in np.flatnonzero(self.lost).tolist():
            self._clear(m)
        self.at += 1
        if self.at == self.together:
            self._close()

    def _close(self) -> None:
        """A block is complete: compare the motors; they wait to be judged."""
        self.work(self.waiting)
        _watch_kernels.close(
            self.block, self.raw, self.known.noise, BURSTS, self.base, self.held, self.burst,
            self.bursts, self.middle, self.off, self.trusted, self.shift,
        )  # fmt: skip
        # Who is compared with others than before may stand as much elsewhere as they do.
        seen = list(heat.MEASURED)
        self.cov[:, :, seen, seen] += (self.shift**2)[:, None, :]
        # A sensor that had crept away and steps back is where it was.
        stepped, crept = self.offsets, self.mean[:, 1 + models.HEATS :, models.SIZE]
        likely = self.mode[:, 1 + models.HEATS :] > 0.5
        stepped[likely & (stepped != 0.0) & (np.abs(stepped + crept) < RETURNED_K)] = 0.0
        # From the middle of the last block to that of this one.
        self.inputs = self.late + self.sums[0]
        self.late = self.sums[1].copy()
        self.sums[:] = 0.0
        self.at = 0
        self.waiting = len(self.begun)

    def work(self, count: int) -> None:
        """Judge so many of the motors that wait: who has little time does not do all at once."""
        motors = len(self.begun)
        for m in range(motors - self.waiting, min(motors - self.waiting + count, motors)):
            self.waiting -= 1
            if not self.begun[m]:
                continue
            found = _watch_kernels.judge(
                self.known.parameters[m], self.inputs[m], self.unit, self.off[m], self.bursts[m],
                self.block_s, self.sigma, self.odds, self.sizes, self.noise_k[m], BENIGN_K,
                SHOWN_K, self.loose_odds, self.mode[m], self.mean[m], self.cov[m], self.base[m],
                self.loose[m], self.kind[m], self.held[m],
            )  # fmt: skip
            self.size_k[m], self.says[m], self.ill[m], self.held[m] = found
            self.judged[m] += 1

    @property
    def offsets(self) -> Array:
        """(M, 3) K that sensors have stepped by."""
        return self.jumps[:, :, _steps_kernels.OFF]

    def told(self) -> tuple[Array, Array]:
        """(M, 11) probability of every kind by now, and (M,) K of what is wrong if anything is.

        A sensor that has stepped is off for certain, whatever else is wrong beside it.
        """
        kind, off = self.kind.copy(), self.offsets
        kind[:, len(HEAT) : len(HEAT) + len(SENSORS)][off != 0.0] = SURE
        kind /= np.maximum(kind.sum(axis=1, keepdims=True) / SURE, 1.0)
        return kind, np.maximum(self.size_k, np.abs(off).max(axis=1))


def reading_noise(noise: Array, together: int) -> Array:
    """(M,) K: of a motor's block medians, from single readings' noise (M, 3) K."""
    return np.asarray(1.5 * noise.max(axis=1) / np.sqrt(together) + LEAST_NOISE_K)


def _unit(known: Known) -> Array:
    """(7,): see `_watch_kernels.directions`."""
    p, (speed, square, cooling, heating) = known.parameters.mean(axis=0), known.duty
    settles = -np.linalg.inv(heat.coupling(p, square, speed))
    seen = settles[list(heat.MEASURED)].max(axis=0)
    into = [heat.WINDING, heat.FRAME, heat.DRIVE_END, heat.OTHER_END]
    return np.array([speed, cooling, heating, *seen[into]])
