"""Thermal faults while they happen: N motors, bounded memory, microseconds per motor and second.

A thermal model (`model`) of each motor runs open loop, from the currents, the speed and the ambient
temperature on the bus. The residuals of the readings are combined in blocks of seconds (by medians,
which ignore noise and bursts), less the residuals of the other motors (weather and what the model
does not know are the same for all). They go to one Kalman filter for each explanation, of which one
is true at a time (interacting multiple models, Blom and Bar-Shalom 1988): disturbances alone, which
every motor has; a kind of heat, whose size is a state; a sensor that is off. Kinds of heat differ
in where the heat enters and in what it grows with: friction with speed, heat of a winding's
resistance with the squared current, lost cooling with the frame's own rise. Steps of sensors
(`step_detector`) and bursts of loose connectors are separated before.

It replaces paper `thermal`, eq. (28)-(31): a filter without the faults among its explanations
follows a fault, and the spread between motors shows neither the motor nor the fault.

The rules are in `monitor.c`, `imm.c` and `peers.c`; this module has their constants and arrays.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any, Final, NamedTuple

import numpy as np
from _traction_core import ffi, lib
from numpy.typing import NDArray

from dbc import records
from dbc.arrays import Array
from dbc.records import Addressed, Records, pointer
from estimators.thermal import model, step_detector
from estimators.thermal.hypotheses import HEAT, KINDS
from estimators.thermal.record import CUT_OUT, Record

BLOCK_SHARE: Final = 0.08
"""Length of a block of readings, as a share of the quickest lump's time constant."""
LONGEST_BLOCK_S: Final = 60.0
DISTURBANCES: Final = np.array([0.01, 0.7, 0.02, 0.05, 0.05])
"""Standard deviations of each motor's slow disturbances: share of its copper loss, K of its air,
shares of its cooling air and of the friction in each end. Constant parts are in its parameters."""
MEMORY_S: Final = 900.0
"""Time constant of the disturbances and of a sensor's creep."""
BEGIN_S, END_S = 36_000.0, 3600.0
"""Mean time until a fault begins, and until it ends."""
UNSURE: Final = 0.6
"""Share of a lump's own exchange of heat that the model may be wrong by, because five lumps stand
for a continuum."""
WALK_K, WALK_SHARE = 0.2, 0.03
"""Standard deviation of a fault size's change per block: of heat, K, and as a share of any size."""
CREEP_K_PER_S: Final = 0.003
"""Rate at which a sensor may creep away, for about `MEMORY_S`."""
WALK_SENSOR_K: Final = 0.3
"""The same for a sensor's error, K. A larger value takes heat for a creeping sensor less often, but
a creeping sensor for heat more often: 0.2 misnames 2 % of overheating."""
CAUGHT_K, RARER = 1.5, 0.1
"""With the step detector: standard deviation of a sensor's first error (it finds larger ones), and
factor on the share of creeping sensors, which are rarer because most sensors step."""
OWN_K: Final = 0.02
"""Random deviation of a lump, K per root of a minute, for a calibration that does not state it."""
UNSTEADY: Final = 0.3
"""Share of a block's heat that is uncertain, because a fault begins somewhere within a block."""
WIDE_K: Final = 5.0
"""How far off the readings of an outlying block may be."""
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
"""For each mode: mean and standard deviation of a fault's size when it begins, its rate of creep,
K/s, and its share of all faults (`struct imm_fault`).

The size of heat is K at the mean duty when settled. Heat in a winding or bearing: any power.
"""
LOCAL: Final = [1, 3, 4]
"""Modes whose heat enters a single lump: winding, ends."""
ANY_POWER: Final = 100.0
"""Factor on the standard deviations of `LOCAL` for a motor too quick for the step detector (see
`STEADY_S`): otherwise all that bends too fast for heat would count as a sensor fault."""
BENIGN_K: Final = np.array([1.5, 4.0, 1.5, 1.5, 1.5, 1.5, 1.5, 1.5])
"""Smaller sizes are dirt, draught, weather and wear."""
SHOWN_K: Final = 0.6
"""Rise that heat must have caused in some reading by now: draught causes less within a minute."""
AMBIGUOUS, MISFIT_K = 0.3, 0.06
"""If the random deviation of lumps exceeds `MISFIT_K`, an apparently creeping sensor may be heat
where the model has no lump or, if it reads low, heat of a motor that it is compared with. Then this
share of its probability counts for heat, so that neither is named. A sensor whose step the step
detector has found is named all the same."""
FEW: Final = 3
"""Up to so many motors, one that is hot moves the median of the others, beside which a motor then
reads low; with more, a sensor that reads low is off."""
RAISE: Final = 0.9
"""Probability above which a fault is reported, where no rate of false alarms is stated."""
LEAST_COVERED: Final = 0.8
"""Least share of held-back blocks in the 95 % band; a motor with less gets `Reason` Config."""
MOST_FALSE: Final = 0.03
"""A motor that is reported as faulty for a larger share of its own calibration gets it as well."""
LOOSE_SHARE, GOOD_SHARE = 0.04, 1e-6
"""Share of readings that are far off, from a loose and from a good connector."""
FAR_SIGMA, FAR_K = 6.0, 3.0
"""A reading is far off beyond both: standard deviations, and K that heat can cause in a block."""
BURST_LENGTH: Final = 5.0
"""Readings of one burst, which are not independent."""
LOOSE_BEGIN_S, LOOSE_END_S = 30_000.0, 3600.0
LEARNT_S: Final = 7200.0
"""Time constant of a motor's baseline, which is learnt while there is no fault."""
LEAST_NOISE_K: Final = 0.01
STEADY_S: Final = 100.0
"""If a motor's quickest lump has a shorter time constant, its readings bend so fast that the step
detector would take heat for a step. It is off then, and the filters decide alone."""
GAP_S: Final = 60.0
"""Longest time without inputs: after it, a motor starts anew."""
CUT_OUT_S: Final = 30.0
"""Time over which a motor's current is averaged to find whether it is cut out."""
DRIVEN: Final = 0.01
"""Motors are driven from this share of the calibration's mean I^2: a tenth of its current."""
MOST_SAMPLES: Final[int] = lib.THERMAL_BLOCK_MAX
"""Most samples of a block, and of the step detector's window."""


class Coverage(NamedTuple):
    """Coverage of fault-free blocks by the filters' prediction, of M motors: see `coverage`.

    inflation (M,): root mean square of the normalised innovations, at least 1; covered (M, 2):
    share of them within the 95 % band times the inflation, in the half of the blocks with less
    copper loss and in the half with more; lag_one (M,): their correlation from block to block. A
    motor with too few blocks has 1, NaN, NaN. false_share (M,): share of the fault-free runs in
    which a fault is reported.
    """

    inflation: Array
    covered: Array
    lag_one: Array
    false_share: Array

    @property
    def uncovered(self) -> NDArray[np.bool_]:
        """(M,) whether even the inflated band covers too few blocks, at either duty."""
        return np.asarray((self.covered < LEAST_COVERED).any(axis=1))

    @property
    def unexplained(self) -> NDArray[np.bool_]:
        """(M,) whether a motor is not judged: it is not covered, or seems faulty in health."""
        return np.asarray(self.uncovered | (self.false_share > MOST_FALSE))


class Known(NamedTuple):
    """Calibration of a train's motors from fault-free runs.

    parameters (M, 18): see `model`; centre (M, 3) K: residual less the peers'; noise (M, 3) K: of
    single readings; scale: factor on `DISTURBANCES`; duty (4,): the fleet's mean speed rad/s, and
    means of the squared current A^2, of the frame's cooling and of the winding's heating K/s;
    own_k: random deviation of lumps, K per root of a minute, larger where the model is wrong.
    coverage: of the filters with all this; None if it was not measured. raise_probability:
    probability of a fault above which it is reported (`promise`).
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

        Raises ValueError if a block, or the step detector's window, would have more than
        `MOST_SAMPLES` samples.
        """
        self.known, self.dt_s = known, dt_s
        self.config = _config(known, dt_s)
        self.block: int = self.config["block"].item()
        """Samples of a block."""
        self.known_motors = _motors(known, self.block)
        self.motors = np.zeros(len(known.parameters), records.THERMAL_MOTOR)
        self.motors["trusted"] = True
        self.motors["compared_k"] = self.motors["peers_k"] = np.nan
        self.currents = np.zeros(len(self.motors), records.MOTOR_CURRENT)
        """(M,) of `struct motor_current`."""
        self.record = np.zeros(1, records.THERMAL_MONITOR)
        self.record["motor_count"] = len(self.motors)
        self._workspace = np.zeros(11 * len(self.motors))
        self.link()
        for motor in pointer("struct thermal_motor", self.motors):
            lib.thermal_motor_reset(pointer("struct thermal_config", self.config),
                                    ffi.addressof(motor))  # fmt: skip

    def link(self) -> None:
        """See `Addressed`."""
        for name, array in (
            ("config", self.config), ("known", self.known_motors), ("motors", self.motors),
            ("currents", self.currents), ("workspace", self._workspace),
        ):  # fmt: skip
            self.record[name] = array.ctypes.data
        self.pointer = pointer("struct thermal_monitor", self.record)

    @property
    def waiting(self) -> int:
        """Number of motors that still wait to be judged for the last block: the last ones."""
        return int(self.record["waiting"][0])

    def add_sample(self, reading: Array, square: Array, speed: Array, ambient: Array) -> None:
        """Add one sample; NaN: no value.

        reading (M, 3) degC; square (M,) A^2 of the current's amplitude; speed (M,) rad/s without
        sign; ambient (M,) degC.
        """
        inputs = np.empty(len(self.motors), records.THERMAL_INPUT)
        inputs["current_square"], inputs["speed"], inputs["ambient"] = square, speed, ambient
        degrees = np.ascontiguousarray(reading, dtype=np.float64)
        lib.thermal_monitor_add_sample(
            self.pointer, pointer("double", degrees), pointer("struct thermal_input", inputs)
        )

    def judge(self, count: int) -> None:
        """Judge up to `count` of the waiting motors, so that a tick need not judge all at once."""
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
        """(M, 11) probability of every kind of fault by now, and (M,) K: its size if there is one.

        The probabilities of a motor that its model does not explain, or that is cut out, are 0. A
        sensor that has stepped is off for certain, whatever other fault the motor has.
        """
        motors = pointer("struct thermal_motor", self.motors)
        kind = np.empty((len(self.motors), len(KINDS)))
        lib.thermal_kinds(motors, len(kind), pointer("double", kind))
        kind[self.known_motors["unexplained"] != 0] = 0.0
        return kind, np.maximum(self.motors["size_k"], np.abs(self.offsets).max(axis=1))

    def likelihood(self, off: Array, inputs: Records) -> float:
        """Log likelihood of fault-free blocks under the filter without faults.

        off (B, M, 3): deviation from the other motors, K; inputs (B, M) of `struct thermal_sums`.
        """
        return float(sum(lib.thermal_likelihood(*each) for each in self.held_back(off, inputs)))

    def held_back(self, off: Array, inputs: Records) -> Iterator[tuple[Any, ...]]:
        """Arguments of `thermal_likelihood` for each motor, for the filter without faults."""
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
    """Run a record through a monitor; yields after each sample whether a block was judged."""
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
    # A median, because a motor whose identification failed may have any rate.
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
    few = len(known.parameters) <= FEW
    out["imm"]["ambiguous_low"] = out["imm"]["ambiguous"] if few else 0.0
    noise_k = float(np.median(known.noise, axis=0).max())
    out["steps"] = step_detector.config(dt_s, noise_k=noise_k, tested=tested)
    seen = step_detector.window(out["steps"]) if tested else 0
    if max(block, seen) > MOST_SAMPLES:
        raise ValueError(f"samples {dt_s} s apart are too close together: average some of them")
    out["dt_s"], out["gap_s"], out["block"] = dt_s, GAP_S, block
    speed, square, cooling, copper = known.duty
    out["duty_speed"], out["duty_cooling"], out["duty_copper"] = speed, cooling, copper
    set_cut_out(out["cut_out"], DRIVEN * square, dt_s)
    settles = -np.linalg.inv(model.system_matrix(known.parameters.mean(axis=0), square, speed))
    out["settles_k"] = settles[list(model.MEASURED)].max(axis=0)
    out["loose_share"], out["good_share"] = LOOSE_SHARE, GOOD_SHARE
    out["far_sigma"], out["far_k"], out["burst_length"] = FAR_SIGMA, FAR_K, BURST_LENGTH
    out["loose_begin_per_s"], out["loose_end_per_s"] = 1.0 / LOOSE_BEGIN_S, 1.0 / LOOSE_END_S
    out["learn_per_s"] = 1.0 / LEARNT_S
    out["raise_probability"] = known.raise_probability
    return out


def set_cut_out(out: Records, driven_square: float, dt_s: float) -> None:
    """Set a `struct cut_out_config`: motors are driven from a mean I^2 of `driven_square` A^2.

    dt_s: time from one sample of the currents to the next.
    """
    out["share"], out["driven_square"] = CUT_OUT, driven_square
    out["weight"] = min(dt_s / CUT_OUT_S, 1.0)


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
    """Noise (M,) K of a motor's block medians, from that of single readings (M, 3) K."""
    return np.asarray(1.5 * noise.max(axis=1) / np.sqrt(together) + LEAST_NOISE_K)


assert len(KINDS) == lib.THERMAL_KINDS
