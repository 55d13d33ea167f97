"""Thermal faults while they happen: N motors, bounded memory, some microseconds a motor and second.

Every motor's heat (`model`) runs open loop beside it, from the currents, the speed and the ambient
temperature on the bus. What its readings differ by is taken together in blocks of seconds (medians:
noise and bursts do not count), less what the other motors differ by (weather and what the model
does not know are the same for all), and goes to one Kalman filter for each explanation, of which
one is true at a time (interacting multiple models, Blom and Bar-Shalom 1988): nothing but
disturbances, which every motor has; a kind of heat, whose size is a state; a sensor that is off. A
fault of heat shows itself by where it comes in and what it goes with: friction with speed, a
winding's resistance with the current squared, lost cooling with the frame's own rise. Steps of
sensors (`step_detector`) and bursts of loose connectors are told apart before.

In place of paper `thermal`, eq. (28)-(31): a filter without the faults among its explanations
follows a fault, and the spread between motors does not tell which motor or what.

The rules are in `monitor.c`, `imm.c` and `peers.c`; here are their constants, and arrays.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any, Final, NamedTuple

import numpy as np
from _traction_core import ffi, lib
from numpy.typing import NDArray

from estimators._core import Addressed, Records, pointer, records
from estimators.thermal import model, step_detector
from estimators.thermal.hypotheses import HEAT, KINDS
from estimators.thermal.record import Record

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
"""Where steps are looked for: how far a sensor may be off at once (more would have been caught),
and how much rarer one is that creeps, for most sensors step."""
OWN_K: Final = 0.02
"""Deviation that a lump takes on by itself, per root of a minute, of a calibration that does not
say."""
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
"""Of each mode: mean and deviation of a fault's size when it begins, how fast it creeps, K/s, and
its share of all faults (`struct imm_fault`).

Of heat: K at the mean duty when settled. What heats a winding or a bearing may be of any power.
"""
LOCAL: Final = [1, 3, 4]
"""Modes whose heat comes into one lump: winding, ends."""
ANY_POWER: Final = 100.0
"""Times those deviations, of the winding and the bearings of a motor that steps are not looked for
in: its sensor's is all that bends too fast for heat, else."""
BENIGN_K: Final = np.array([1.5, 4.0, 1.5, 1.5, 1.5, 1.5, 1.5, 1.5])
"""Smaller ones are dirt, draught, weather and wear."""
SHOWN_K: Final = 0.6
"""What heat has to have made of some reading by now; before, draught does as much in a minute."""
AMBIGUOUS, MISFIT_K = 0.3, 0.06
"""Where lumps deviate by more than `MISFIT_K` by themselves, what a model of five lumps calls a
sensor that creeps may be heat where it has no lump, or, of one that reads low, heat of a motor that
it is compared with: this share of its probability counts for heat, so that neither is named. A
sensor that the step detector has seen step is named all the same."""
RAISE: Final = 0.9
"""Probability above which a fault is reported, where no rate of false alarms is stated."""
LEAST_COVERED: Final = 0.8
"""Of a motor's held-back blocks, in the band of 95 %. One with less has `Reason` Config."""
LOOSE_SHARE, GOOD_SHARE = 0.04, 1e-6
"""Of a loose and of a good connector's readings, that are far off."""
FAR_SIGMA, FAR_K = 6.0, 3.0
"""Standard deviations that are far; K within a block that are not, as heat can do that."""
BURST_LENGTH: Final = 5.0
"""Readings of one burst: they are not independent."""
LOOSE_BEGIN_S, LOOSE_END_S = 30_000.0, 3600.0
LEARNT_S: Final = 7200.0
"""Time constant of a motor's baseline, which is learnt while there is no fault."""
LEAST_NOISE_K: Final = 0.01
STEADY_S: Final = 100.0
"""A motor whose quickest lump has a shorter time constant than this bends so fast that the step
detector would take its heat for a sensor's: nothing is tested, the filters have to tell."""
GAP_S: Final = 60.0
"""After so long without knowing how it was driven, a motor starts again."""
MOST_SAMPLES: Final[int] = lib.THERMAL_BLOCK_MAX
"""Of a block, and of what the step detector looks at."""


class Coverage(NamedTuple):
    """How far the filters' prediction of a fault-free block holds, of M motors: see `coverage`.

    inflation (M,): root mean square of the normalised innovations, at least 1; covered (M, 2):
    share of them within the band of 95 % times that, in the half of the blocks with less copper
    loss and in that with more; lag_one (M,): their correlation from block to block. Of a motor with
    too few blocks 1, NaN, NaN.
    """

    inflation: Array
    covered: Array
    lag_one: Array

    @property
    def unexplained(self) -> NDArray[np.bool_]:
        """(M,) whether even the inflated band leaves out too much, at either duty."""
        return np.asarray((self.covered < LEAST_COVERED).any(axis=1))


class Known(NamedTuple):
    """What fault-free runs have shown of a train's motors.

    parameters (M, 18): see `model`; centre (M, 3) K: residual beside the peers'; noise (M, 3) K: of
    single readings; scale: of `DISTURBANCES`; duty (4,): mean speed rad/s, and means of the
    squared current A^2, of the frame's cooling and of the winding's heating K/s, of the fleet;
    own_k: K per root of a minute that lumps deviate by themselves: more where the model is wrong.
    coverage: of the filters with all this; None where it was not measured. raise_probability: of a
    fault, above which it is reported (`promise`).
    """

    parameters: Array
    centre: Array
    noise: Array
    scale: float
    duty: Array
    own_k: float = OWN_K
    coverage: Coverage | None = None
    raise_probability: float = RAISE


class ThermalMonitor(Addressed):
    """State of all motors; `add_sample` per sample, `judge` when a block is complete.

    motors (M,): `struct thermal_motor`; config (1,), known_motors (M,): constants of them; record
    (1,): `struct thermal_monitor`.
    """

    def __init__(self, known: Known, dt_s: float) -> None:
        """Samples come `dt_s` apart.

        Raises ValueError where a block, or what the step detector looks at, is more than
        `MOST_SAMPLES`.
        """
        self.known, self.dt_s = known, dt_s
        self.config = _config(known, dt_s)
        self.block: int = self.config["block"].item()
        """Samples of a block."""
        self.block_s = self.block * dt_s
        self.known_motors = _motors(known, self.block)
        self.motors = np.zeros(len(known.parameters), records.THERMAL_MOTOR)
        self.motors["trusted"] = True
        self.record = np.zeros(1, records.THERMAL_MONITOR)
        self.record["motor_count"] = len(self.motors)
        self._workspace = np.zeros(8 * len(self.motors))
        self.link()
        for motor in pointer("struct thermal_motor", self.motors):
            lib.thermal_motor_reset(pointer("struct thermal_config", self.config),
                                    ffi.addressof(motor))  # fmt: skip

    def link(self) -> None:
        """See `Addressed`."""
        for name, array in (
            ("config", self.config), ("known", self.known_motors), ("motors", self.motors),
            ("workspace", self._workspace),
        ):  # fmt: skip
            self.record[name] = array.ctypes.data
        self.pointer = pointer("struct thermal_monitor", self.record)

    @property
    def position(self) -> int:
        """Samples of the block that is under way."""
        return int(self.record["position"][0])

    @property
    def waiting(self) -> int:
        """Motors of the last block that are not judged yet, the last ones."""
        return int(self.record["waiting"][0])

    def add_sample(self, reading: Array, square: Array, speed: Array, ambient: Array) -> None:
        """One sample, NaN where there is none.

        reading (M, 3) degC; square (M,) A^2 of the current's amplitude; speed (M,) rad/s without
        sign; ambient (M,) degC.
        """
        inputs = np.empty(len(self.motors), records.THERMAL_INPUT)
        inputs["current_square"], inputs["speed"], inputs["ambient"] = square, speed, ambient
        degrees = np.ascontiguousarray(reading, dtype=np.float64)
        lib.thermal_monitor_add_sample(
            self.pointer, pointer("double", degrees), pointer("struct thermal_input", inputs)
        )

    def close_block(self) -> None:
        """A block ends, be it complete or not: compare the motors; they wait to be judged."""
        lib.thermal_monitor_close_block(self.pointer)

    def judge(self, count: int) -> None:
        """Judge so many of the motors that wait: who has little time does not do all at once."""
        lib.thermal_monitor_judge(self.pointer, count)

    @property
    def offsets(self) -> Array:
        """(M, 3) K that sensors have stepped by."""
        return np.asarray(self.motors["step"]["offset_k"])

    @property
    def held(self) -> NDArray[np.bool_]:
        """(M,) whether a fault is reported."""
        return np.asarray(self.motors["held"].astype(np.bool_))

    def kinds(self) -> tuple[Array, Array]:
        """(M, 11) probability of every kind by now, and (M,) K of what is wrong if anything is.

        0 of a motor that its model does not explain.
        A sensor that has stepped is off for certain, whatever else is wrong beside it.
        """
        motors = pointer("struct thermal_motor", self.motors)
        kind = np.empty((len(self.motors), len(KINDS)))
        lib.thermal_kinds(motors, len(kind), pointer("double", kind))
        kind[self.known_motors["unexplained"] != 0] = 0.0
        return kind, np.maximum(self.motors["size_k"], np.abs(self.offsets).max(axis=1))

    def likelihood(self, off: Array, inputs: Records) -> float:
        """Log likelihood of fault-free blocks, faults left out.

        off (B, M, 3) K from the other motors, inputs (B, M) of `struct thermal_sums`.
        """
        return float(sum(lib.thermal_likelihood(*each) for each in self.held_back(off, inputs)))

    def held_back(self, off: Array, inputs: Records) -> Iterator[tuple[Any, ...]]:
        """For every motor what `thermal_likelihood` takes, without faults."""
        config = self.config.copy()
        config["imm"]["modes"] = 1
        given = pointer("struct thermal_config", config)
        known = pointer("struct thermal_motor_config", self.known_motors)
        for m in range(len(self.motors)):
            own, sums = np.ascontiguousarray(off[:, m]), np.ascontiguousarray(inputs[:, m])
            yield (
                given, known + m, pointer("double", own), pointer("struct thermal_sums", sums),
                len(own),
            )  # fmt: skip


def followed(monitor: ThermalMonitor, record: Record) -> Iterator[bool]:
    """A record sample by sample through a monitor; whether a block has been judged with it."""
    ones = np.ones(record.motors)
    before = -1
    for k, at in enumerate(record.at.tolist()):
        steps_ = slice(before + 1, at + 1)
        before = at
        monitor.add_sample(
            record.temperature[k], record.current_square[steps_].mean(axis=0),
            ones * np.abs(record.speed[steps_]).mean(), ones * record.ambient[steps_].mean(),
        )  # fmt: skip
        judged = monitor.waiting > 0
        monitor.judge(monitor.waiting)
        yield judged


def imm_config(scale: float, block_s: float, faults: Array) -> Records:
    """(1,) of `struct imm_config`; scale: of `DISTURBANCES`; faults (9, 4): as `SIZES_K`."""
    out = np.zeros(1, records.IMM_CONFIG)
    out["block_s"], out["memory_s"] = block_s, MEMORY_S
    out["begin_per_s"], out["end_per_s"] = 1.0 / BEGIN_S, 1.0 / END_S
    out["unsure"], out["unsteady"], out["own_k"], out["wide_k"] = UNSURE, UNSTEADY, OWN_K, WIDE_K
    out["walk_k"], out["walk_share"], out["walk_sensor_k"] = WALK_K, WALK_SHARE, WALK_SENSOR_K
    out["sigma"], out["benign_k"], out["shown_k"] = scale * DISTURBANCES, BENIGN_K, SHOWN_K
    for name, column in zip(("mean_k", "sigma_k", "creep_k_s", "share"), faults.T, strict=True):
        out["fault"][name] = column
    out["modes"] = len(faults)
    return out


def _config(known: Known, dt_s: float) -> Records:
    """(1,) of `struct thermal_config`. Raises ValueError for samples too close together."""
    # A median: one motor that could not be identified has any rate.
    rates = known.parameters[:, [model.K_W, model.K_D, model.K_N]]
    quickest = float(np.median(rates, axis=0).max())
    block = max(round(min(BLOCK_SHARE / quickest, LONGEST_BLOCK_S) / dt_s), 1)
    steady = quickest * STEADY_S < 1.0
    tested = dt_s <= step_detector.SLOWEST_S and steady
    faults = SIZES_K.copy()
    if not steady:
        faults[LOCAL, 1] *= ANY_POWER
    if tested or not steady:
        faults[1 + len(HEAT) :, 1] = CAUGHT_K
    if tested:
        faults[1 + len(HEAT) :, 3] *= RARER
        faults[:, 3] /= faults[:, 3].sum()
    out = np.zeros(1, records.THERMAL_CONFIG)
    out["imm"] = imm_config(known.scale, block * dt_s, faults)
    out["imm"]["own_k"] = known.own_k
    out["imm"]["ambiguous"] = AMBIGUOUS if known.own_k > MISFIT_K else 0.0
    out["steps"] = step_detector.config(dt_s, tested=tested)
    seen = step_detector.window(out["steps"]) if tested else 0
    if max(block, seen) > MOST_SAMPLES:
        raise ValueError(f"samples {dt_s} s apart are too close together: average some of them")
    out["dt_s"], out["gap_s"], out["block"] = dt_s, GAP_S, block
    speed, square, cooling, copper = known.duty
    out["duty_speed"], out["duty_cooling"], out["duty_copper"] = speed, cooling, copper
    settles = -np.linalg.inv(model.system_matrix(known.parameters.mean(axis=0), square, speed))
    out["settles_k"] = settles[list(model.MEASURED)].max(axis=0)
    out["loose_share"], out["good_share"] = LOOSE_SHARE, GOOD_SHARE
    out["far_sigma"], out["far_k"], out["burst_length"] = FAR_SIGMA, FAR_K, BURST_LENGTH
    out["loose_begin_per_s"], out["loose_end_per_s"] = 1.0 / LOOSE_BEGIN_S, 1.0 / LOOSE_END_S
    out["learn_per_s"] = 1.0 / LEARNT_S
    out["raise_probability"] = known.raise_probability
    return out


def _motors(known: Known, block: int) -> Records:
    """(M,) of `struct thermal_motor_config`."""
    out = np.zeros(len(known.parameters), records.THERMAL_MOTOR_CONFIG)
    out["model"] = model.parameter_records(known.parameters)
    out["centre_k"], out["noise_k"] = known.centre, known.noise
    out["block_noise_k"] = reading_noise(known.noise, block)
    out["inflation"] = 1.0
    if known.coverage is not None:
        out["inflation"], out["unexplained"] = known.coverage.inflation, known.coverage.unexplained
    return out


def reading_noise(noise: Array, together: int) -> Array:
    """(M,) K: of a motor's block medians, from single readings' noise (M, 3) K."""
    return np.asarray(1.5 * noise.max(axis=1) / np.sqrt(together) + LEAST_NOISE_K)


assert len(KINDS) == lib.THERMAL_KINDS
