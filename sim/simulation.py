"""The simulated train on its bus: `step` takes the gateway's frames and returns the drives'.

Pure in the gateway's sense: time is an argument, everything random comes from the scenario's
seed, and how the time is divided into steps changes nothing, except that frames for the drives
act from the start of the step that they are given to.

The world advances on a grid of 125 us. Sampling instants are exact multiples of a message's cycle
time; voltages are the mean since the drive's previous sample, currents those at the instant.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Sequence
from typing import TYPE_CHECKING, Final

import numpy as np

from dbc.arrays import Array, Flags, Ints
from dbc.codec import Codec
from dbc.frame import Frame, Nanos
from sim.bus_arbiter import Arbiter
from sim.drive_spread import Variety
from sim.ecu import FAST, Ecu
from sim.faults import Schedule, WireFaults
from sim.ground_truth import Truth
from sim.measurements import SAMPLES_PER_FRAME, VALID, Readings, Values
from sim.physics import plant as columns
from sim.physics.plant import TRAIN, TRAINS, Motor, Plant, QuasiStatic, rail_array
from sim.physics.thermal import ThermalTrain
from sim.profile import Profile
from sim.scenario import NEEDS_RAIL, Event, Scenario, ScenarioError

if TYPE_CHECKING:
    from dbc.secoc_receiver import Verifier

PERIOD_NS: Final[Nanos] = 125_000
BEYOND_ANY: Final = 1e9
"""A, V, Nm, rad: far above any drive's values."""
TOO_QUICK: Final = (
    "the simulator cannot follow it: its currents grow without bound. With psi_pm, pole_pairs, L_s "
    "and J as they are, rotor and current swing faster than the simulator's steps of 125 us; "
    "check these"
)
GRID: Final = 80
"""Periods in 10 ms: the grid of events, heat and truth."""
GRID_NS: Final[Nanos] = GRID * PERIOD_NS
ANGLE_STREAM: Final = 1
"""Purpose of the random stream of initial angles."""


class Simulation:
    """Drives, train, sensors, ECUs and bus of one scenario."""

    def __init__(
        self,
        scenario: Scenario,
        codec: Codec,
        *,
        self_start: bool = True,
        start_ns: Nanos = 0,
        verifier: Callable[[], Verifier] | None = None,
        motor: Motor | None = None,
    ) -> None:
        """Build the world at time `start_ns`.

        With `self_start` the drives go Operational by themselves, else an NMT master has to start
        them. `verifier` makes each drive's receiver of authenticated flags; None: flags need no
        authentication. `motor`: of all drives, in place of the scenario's.

        Raises ValueError when the DBC lacks messages of a drive, or when a cycle time is not a
        multiple of 125 us.
        """
        self.scenario = scenario
        self.codec = codec
        n = scenario.drives
        self.nodes = tuple(scenario.nodes)
        motor = motor or scenario.motor.machine
        self._schedule = Schedule(scenario, motor)
        self._profile = Profile(scenario, motor.pole_pairs)
        self._wires = [WireFaults(self._schedule, scenario.seed, k) for k in range(n)]
        verifiers = [verifier() if verifier else None for _ in range(n)]
        parts = enumerate(zip(self.nodes, self._wires, verifiers, strict=True))
        self._ecus = [
            Ecu(node, k, codec, wire, self_start=self_start, verifier=own)
            for k, (node, wire, own) in parts
        ]
        self._cycles = _cycles(self._ecus, slow=scenario.traffic == "slow")
        self._variety = Variety(scenario, motor)
        self._plant, self._slow = _plant(scenario, motor, self._profile, self._variety)
        self._heat = _heat(scenario, motor, self._profile)
        self._readings = Readings(scenario, self._schedule, self._heat, self._variety)
        self._arbiter = Arbiter(scenario.bus.bitrate, scenario.bus.data_bitrate)
        self._start_ns = start_ns
        self._now_ns: Nanos = 0
        self._period = 0  # periods of 125 us done
        self._rails = self._schedule.rails(0.0)
        self._tail: list[Array] = []  # plant rows since the last fast sample
        self._i2_grid: list[Array] = []  # |i|^2 since the last 10 ms
        self._i2_status: list[Array] = []  # |i|^2 since the last Status
        self._ready: list[Frame] = []
        self._truth: list[Truth] = []

    def inject(self, event: Event) -> None:
        """Add an event while the world runs; the part of it that lies in the past has no effect.

        Raises ValueError for a drive that does not exist, or an event this plant cannot simulate.
        """
        if event.kind == "phase_open" and self._plant is None:
            raise ValueError("traffic = 'slow' does not support phase_open")
        if event.kind == "friction_brake" and (self._plant is None or not self._plant.on_rail):
            raise ValueError(NEEDS_RAIL)
        self._schedule.insert(event)
        for wire in self._wires:
            wire.look_again()

    @property
    def verifiers(self) -> dict[int, Verifier]:
        """Each drive's receiver of authenticated flags, by node; empty without authentication."""
        return {e.node: e.verifier for e in self._ecus if e.verifier is not None}

    def truth_rows(self) -> list[Truth]:
        """Rows since the last call."""
        rows, self._truth = self._truth, []
        return rows

    @property
    def fastest_cycle_ns(self) -> Nanos:
        """Cycle time of the most frequent message, ns."""
        return min(self._cycles.values()) * PERIOD_NS

    def step(self, rx_frames: Iterable[Frame], now_ns: Nanos) -> list[Frame]:
        """Advance the world to `now_ns`; frames of the drives with stamps in (last, now], sorted.

        `rx_frames` reach the drives at the start of the step. A step back in time returns nothing.
        """
        rx = tuple(rx_frames)
        if rx:
            for k, ecu in enumerate(self._ecus):
                if not self._schedule.silent(k, self._now_ns * 1e-9):
                    ecu.receive(rx, self._now_ns)
        self._now_ns = max(self._now_ns, now_ns - self._start_ns)
        last = self._now_ns // PERIOD_NS
        while self._period < last:
            self._advance(min(GRID - self._period % GRID, last - self._period))
        for ecu in self._ecus:
            self._ready += ecu.service_frames(self._now_ns)
        self._arbiter.offer(self._ready)
        self._ready = []
        out = self._arbiter.drain(self._now_ns)
        if self._start_ns:
            out = [f._replace(t_ns=f.t_ns + self._start_ns) for f in out]
        return out

    def _advance(self, count: int) -> None:
        """Advance by `count` periods, not beyond the next multiple of 10 ms."""
        if self._plant is None:
            self._advance_slow(count)
            return
        first = self._period
        at_ns = np.arange(first, first + count, dtype=np.int64) * PERIOD_NS
        t_s = _seconds(at_ns)
        if first % GRID == 0:
            self._rails = self._schedule.rails(float(t_s[0]))
            self._plant.p.share = self._variety.share(float(t_s[0]))
            self._plant.p.phase_a_open = self._schedule.open_phase(float(t_s[0]))
            self._plant.p.brake_nm = self._schedule.brake(float(t_s[0]))
        w_ref, w_acc, load = self._profile.at(t_s)
        cut = np.stack([ecu.cut(at_ns) for ecu in self._ecus], axis=1)
        rails = np.repeat(rail_array(self._rails)[None], count, axis=0)
        carry = self._schedule.carry(t_s, load)
        out = self._plant.advance(w_ref, w_acc, load, carry, cut, rails)
        if not (np.abs(out) < BEYOND_ANY).all():  # false for NaN, too
            raise ScenarioError("motor", [TOO_QUICK])
        self._period += count
        i2 = out[:, :, columns.I_ALPHA] ** 2 + out[:, :, columns.I_BETA] ** 2
        self._i2_grid.append(i2)
        self._remember(i2)
        self._ready += self._fast_frames(out)
        if self._period % GRID == 0:
            self._on_grid(out[-1], np.concatenate(self._i2_grid).mean(axis=0))
            self._i2_grid = []
        self._ready += self._slow_frames(out, first)

    def _advance_slow(self, count: int) -> None:
        """The quasi-static plant moves in whole steps of 10 ms."""
        assert self._slow is not None
        self._period += count
        if self._period % GRID:
            return
        begin_ns = self._period * PERIOD_NS - GRID_NS
        t_s = np.array([begin_ns * 1e-9])
        w_ref, _, load = self._profile.at(t_s)
        cut = np.array([ecu.cut(np.array([begin_ns]))[0] for ecu in self._ecus])
        row = self._slow.advance(w_ref[0], load[0], self._schedule.carry(t_s, load)[0], cut)
        i2 = row[:, columns.I_ALPHA] ** 2 + row[:, columns.I_BETA] ** 2
        self._remember(np.repeat(i2[None], GRID, axis=0))
        self._on_grid(row, i2)
        rows = np.repeat(row[None], GRID, axis=0)
        self._ready += self._slow_frames(rows, self._period - GRID)

    def _remember(self, i2: Array) -> None:
        """Keep |i|^2 of (n, N) periods, for `Irms`."""
        if "Status" in self._cycles:
            self._i2_status.append(i2)

    def _on_grid(self, row: Array, i2: Array) -> None:
        """Every 10 ms: heat, faults that the ECUs detect, truth."""
        now_ns = self._period * PERIOD_NS
        t_s = now_ns * 1e-9
        self._air(t_s)
        extra, lost = self._schedule.heat((now_ns - GRID_NS // 2) * 1e-9)
        self._heat.advance(i2, row[:, columns.SPEED], extra, lost)
        classes = self._schedule.classes(t_s)
        for ecu, fault in zip(self._ecus, classes, strict=True):
            ecu.note_fault(fault, now_ns)
        losing = self._schedule.losing(t_s)
        depth = self._depth(losing, t_s)
        effect = self._readings.fault_effect(t_s).tolist()
        plant = self._plant
        for k, node in enumerate(self.nodes):
            speed, angle, load = row[k, [columns.SPEED, columns.ANGLE, columns.LOAD]].tolist()
            slides, deep = bool(losing[k]), depth[k]
            if plant and plant.slips(k, self._rails[k]):
                slides, deep = True, max(deep, plant.shortage(k, self._rails[k], load))
            own = (plant.given(k, row.item(k, columns.TORQUE)), *plant.creep(k)) if plant else ()
            moves = round(t_s, 6), node, speed, angle, load, int(slides)
            self._truth.append(Truth(*moves, classes[k], effect[k], deep, *own))

    def _air(self, t_s: float) -> None:
        """Set the ambient temperature, if it changes."""
        points = self.scenario.thermal.ambient_profile
        if points:
            times, values = zip(*points, strict=True)
            self._heat.set_ambient(float(np.interp(t_s, times, values)))

    def _depth(self, losing: Flags, t_s: float) -> list[float]:
        """(N,) share of the demand that losses and disturbances take away now."""
        if not losing.any():
            return [0.0] * len(self.nodes)
        at = np.array([t_s])
        carry = self._schedule.carry(at, self._profile.at(at)[2])[0]
        depth: list[float] = np.where(losing, np.clip(1.0 - carry, 0.0, 1.0), 0.0).tolist()
        return depth

    def _fast_frames(self, out: Array) -> list[Frame]:
        """Currents and voltages, or samples, of every instant that fell into this block."""
        per = self._cycles.get("Samples") or self._cycles.get("PhaseCurrents")
        if per is None:
            return []
        self._tail.append(out)
        block = np.concatenate(self._tail)
        done = len(block) // per
        self._tail = [block[done * per :]]
        if not done:
            return []
        first = (self._period - len(block)) // per + 1  # number of the first instant
        whole = block[: done * per].reshape(done, per, *block.shape[1:])
        if "Samples" in self._cycles:
            return self._sample_frames(whole, first)
        instants_ns = np.arange(first, first + done, dtype=np.int64) * (per * PERIOD_NS)
        amps = self._readings.currents(whole[:, -1], _seconds(instants_ns))
        volts = whole[..., columns.U_ALPHA : columns.U_BETA + 1].mean(axis=1)
        u_dc = whole[:, -1, :, columns.U_DC]
        quality = np.full(done, float(VALID))
        frames: list[Frame] = []
        for d, ecu in enumerate(self._ecus):
            currents = np.column_stack([quality, amps[:, d]])
            voltages = np.column_stack([quality, volts[:, d], u_dc[:, d]])
            frames += ecu.block("PhaseCurrents", instants_ns, currents)
            frames += ecu.block("StatorVoltages", instants_ns, voltages)
        return frames

    def _sample_frames(self, whole: Array, first: int) -> list[Frame]:
        """FD: eight samples a frame; a sample's index counts periods of 125 us from 0."""
        done, per = whole.shape[:2]
        start = (first - 1) * per
        flat = whole.reshape(done * per, *whole.shape[2:])
        instants_ns = np.arange(start + 1, start + 1 + len(flat), dtype=np.int64) * PERIOD_NS
        amps = self._readings.currents(flat, _seconds(instants_ns)).reshape(done, per, -1, 3)
        volts = whole[..., columns.U_ALPHA : columns.U_BETA + 1]
        u_dc = whole[:, -1, :, columns.U_DC]
        frames: list[Frame] = []
        for d, ecu in enumerate(self._ecus):
            rows = self._readings.samples(start, amps[:, :, d], volts[:, :, d], u_dc[:, d])
            frames += ecu.block("Samples", instants_ns[per - 1 :: per], rows)
        return frames

    def _slow_frames(self, out: Array, first: int) -> list[Frame]:
        """Motion, Status, Temperatures of the instants in this block of rows from `first` on."""
        frames: list[Frame] = []
        for kind, per in self._cycles.items():
            if kind in FAST:
                continue
            for instant in range((first // per + 1) * per, self._period + 1, per):
                drives = self._slow_values(kind, out[instant - first - 1], instant)
                for ecu, values in zip(self._ecus, drives, strict=True):
                    frame = ecu.message(kind, instant * PERIOD_NS, values)
                    if frame is not None:
                        frames.append(frame)
        return frames

    def _slow_values(self, kind: str, row: Array, instant: int) -> list[Values]:
        if kind == "Motion":
            return self._readings.motion(row)
        if kind == "Temperatures":
            return self._readings.temperatures(instant * PERIOD_NS * 1e-9)
        history = np.concatenate(self._i2_status)
        used = len(history) - (self._period - instant)
        self._i2_status = [history[used:]]
        codes = [ecu.fault_code for ecu in self._ecus]
        return self._readings.status(row, history[:used].mean(axis=0), codes)


def _seconds(t_ns: Ints) -> Array:
    return np.asarray(t_ns * 1e-9, dtype=np.float64)


def start_angles(scenario: Scenario) -> Array:
    """(N,) electrical angles of the rotors at the start, rad, drawn by the scenario's seed."""
    streams = ([scenario.seed, ANGLE_STREAM, d] for d in range(scenario.drives))
    return np.array([np.random.default_rng(s).uniform(0.0, 2.0 * math.pi) for s in streams])


def _plant(
    scenario: Scenario, motor: Motor, profile: Profile, variety: Variety
) -> tuple[Plant | None, QuasiStatic | None]:
    """The plant in full, or the quasi-static one for slow traffic."""
    n = scenario.drives
    w_ref, _, load = profile.at(np.zeros(1))
    fixed = scenario.motion.angle_rad
    theta = start_angles(scenario) if fixed is None else np.full(n, fixed)
    if scenario.traffic == "slow":
        return None, QuasiStatic(motor, theta, load[0])
    rolling = scenario.motion.start == "rolling"
    full = Plant(
        motor, theta, on_rail=scenario.load.kind == "rail", w_0=w_ref[0] if rolling else 0.0,
        load_0=load[0], p=variety.p,
        train=TRAIN if scenario.motor.own else TRAINS.get(scenario.motor.name, TRAIN),
    )  # fmt: skip
    return full, None


def _heat(scenario: Scenario, motor: Motor, profile: Profile) -> ThermalTrain:
    """The thermal networks at their start temperatures."""
    n = scenario.drives
    start = scenario.thermal.start
    heat = ThermalTrain(motor, n, scenario.thermal.ambient_c, scenario.thermal.train_seed)
    if start == "equilibrium":
        w_ref, _, load = profile.at(np.zeros(1))
        i_q = load[0] / (motor.k_p * motor.pole_pairs * motor.psi_pm)
        heat.settle(np.full(n, i_q**2), np.full(n, w_ref[0]))
    elif not isinstance(start, str):
        heat.set_uniform(start)
    return heat


def _cycles(ecus: Sequence[Ecu], *, slow: bool) -> dict[str, int]:
    """Cycle of each kind of message in periods of 125 us; the fast ones first."""
    out = {}
    for ecu in ecus:
        if not ecu.specs:
            msg = f"{ecu.codec.path}: no messages of drive {ecu.node}"
            raise ValueError(msg)
    for kind, spec in ecus[0].specs.items():
        if slow and kind in FAST:
            continue
        periods, rest = divmod(spec.cycle_ns, PERIOD_NS)
        if rest or not periods:
            msg = f"{spec.name}: cycle time {spec.cycle_ns} ns is not a multiple of 125 us"
            raise ValueError(msg)
        if kind == "Samples" and periods != SAMPLES_PER_FRAME:
            msg = f"{spec.name}: eight samples of 125 us need a cycle of 1 ms"
            raise ValueError(msg)
        out[kind] = periods
    return out
