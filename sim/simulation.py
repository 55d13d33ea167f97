"""The simulated train on its bus: `step` takes the gateway's frames and gives the drives'.

Pure in the gateway's sense: time is an argument, everything random comes from the scenario's
seed, and how the time is cut into steps changes nothing (frames for the drives apart, which act
from the start of the step they are given to).

The world advances on a grid of 125 us. Sampling instants are exact multiples of a message's cycle
time; voltages are the mean since the drive's previous sample, currents are those of its end.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtr

from dbc.codec import Codec
from dbc.frame import Frame, Nanos
from sim import plant as columns
from sim import thermal
from sim.ecu import OPERATION, Ecu
from sim.faults import Schedule, WireFaults
from sim.plant import MOTORS, Motor, Plant, QuasiStatic, rail_array
from sim.scenario import Load, Motion, Scenario
from sim.sensors import CurrentSensors, Hold, TemperatureSensors
from sim.thermal import ThermalTrain
from sim.wire import Arbiter

Array = NDArray[np.float64]
Values = dict[str, float | int | None]
PERIOD_NS: Final[Nanos] = 125_000
GRID: Final = 80
"""Periods in 10 ms: the grid of events, heat and truth."""
GRID_NS: Final[Nanos] = GRID * PERIOD_NS
FULL: Final = frozenset({"PhaseCurrents", "StatorVoltages", "Samples"})
SAMPLES_PER_FRAME: Final = 8


class Truth(NamedTuple):
    """What is really so, every 10 ms and drive. Speed is the rotor's (mechanical), angle electrical
    in [0, 2 pi), `load_nm` the torque on the rail. `drive` is the node number.

    `lost`: the adhesion at hand is below what the train demands: an adhesion loss is active with
    depth > 0, or the rail cannot carry the demand within 5 % creep, or the wheel slides beyond the
    peak of its creep curve. It is about the train's demand, before the drive's limiter: a drive that
    was cut and grips again is still `lost` until the rail is back.

    `fault_class` is the contract's number (1 none). `true_effect_k` is what the fault changes at
    the drive's temperature readings, largest of the four, noise aside: against a fault-free twin
    of the motor, sensor bias and stuck value included; 0 for a lost sensor.
    """  # fmt: skip

    t_s: float
    drive: int
    speed_rad_s: float
    angle_rad: float
    load_nm: float
    lost: int
    fault_class: int
    true_effect_k: float

    def text(self) -> tuple[str, ...]:
        """Cells of the truth file."""
        return (
            f"{self.t_s:.3f}", str(self.drive), f"{self.speed_rad_s:.5f}",
            f"{self.angle_rad:.5f}", f"{self.load_nm:.4f}", str(self.lost),
            str(self.fault_class), f"{self.true_effect_k:.4f}",
        )  # fmt: skip


class Simulation:
    """Drives, train, sensors, ECUs and bus of one scenario."""

    def __init__(
        self,
        scenario: Scenario,
        codec: Codec,
        *,
        nodes: Sequence[int] | None = None,
        self_start: bool = True,
        start_ns: Nanos = 0,
    ) -> None:
        """`nodes`: CANopen numbers of drives 1..n, default 1..n. With `self_start` the drives go
        Operational by themselves, else an NMT master has to start them. Time begins at `start_ns`.

        Raises ValueError when there are fewer nodes than drives, or a cycle time of the DBC is
        not a multiple of 125 us.
        """  # fmt: skip
        self.scenario = scenario
        n = scenario.drives
        self.nodes = tuple(range(1, n + 1) if nodes is None else nodes)[:n]
        if len(self.nodes) < n:
            msg = f"{n} drives need as many nodes, got {self.nodes}"
            raise ValueError(msg)
        motor = MOTORS[scenario.motor.name]
        self._motor = motor
        self._start_ns = start_ns
        self._now_ns: Nanos = 0
        self._period = 0  # periods of 125 us done
        self._ready: list[Frame] = []
        self._schedule = Schedule(scenario, motor)
        self._profile = _Profile(scenario, motor)
        seed = scenario.seed
        self._ecus = [
            Ecu(node, k, codec, WireFaults(self._schedule, seed, k), self_start=self_start)
            for k, node in enumerate(self.nodes)
        ]
        self._cycles = _cycles(self._ecus, slow=scenario.traffic == "slow")
        s = scenario.sensors
        self._currents = CurrentSensors(
            seed, n, s.current_noise_var, s.current_offset_a, s.current_gain, s.current_range_a
        )
        self._hold_current = Hold((n,))
        t = scenario.thermal
        self._temperatures = TemperatureSensors(
            seed, t.train_seed, n, s.temperature_noise_k, s.temperature_offset_k
        )
        self._hold_temperature = Hold((n, 4))
        self._thermal = ThermalTrain(motor, n, t.ambient_c, t.train_seed)
        self._build_plant(seed)
        self._settle()
        self._i2_grid: list[Array] = []
        self._i2_status: list[Array] = []
        self._tail: list[Array] = []
        self._rails = self._schedule.rails(0.0)
        self._effect = np.zeros(n)
        self._arbiter = Arbiter(scenario.bus.bitrate, scenario.bus.data_bitrate)
        self._truth: list[Truth] = []

    def _build_plant(self, seed: int) -> None:
        w_ref, _, load = self._profile.at(np.zeros(1))
        fixed = self.scenario.motion.angle_rad
        n = self.scenario.drives
        draws = [np.random.default_rng([seed, 1, d]).uniform(0, 2 * math.pi) for d in range(n)]
        theta = np.array(draws if fixed is None else [fixed] * n)
        rolling = self.scenario.motion.start == "rolling"
        self._plant: Plant | None = None
        self._slow: QuasiStatic | None = None
        if self.scenario.traffic == "slow":
            self._slow = QuasiStatic(self._motor, theta, load[0])
        else:
            self._plant = Plant(
                self._motor,
                theta,
                on_rail=self.scenario.load.kind == "rail",
                w_0=w_ref[0] if rolling else 0.0,
                load_0=load[0],
            )

    def _settle(self) -> None:
        start = self.scenario.thermal.start
        n = self.scenario.drives
        if start == "equilibrium":
            w_ref, _, load = self._profile.at(np.zeros(1))
            m = self._motor
            i_q = load[0] / (m.k_p * m.pole_pairs * m.psi_pm)
            self._thermal.settle(np.full(n, i_q**2), np.full(n, w_ref[0]))
        elif not isinstance(start, str):
            self._thermal.set_uniform(start)

    @property
    def overwritten(self) -> int:
        """Frames that never got the bus because their successor came first."""
        return self._arbiter.overwritten

    def truth_rows(self) -> list[Truth]:
        """Rows since the last call."""
        rows, self._truth = self._truth, []
        return rows

    def step(self, rx_frames: Iterable[Frame], now_ns: Nanos) -> list[Frame]:
        """Advance the world to `now_ns`; frames of the drives with stamps in (last, now], sorted.

        `rx_frames` reach the drives at the start of the step. Going back in time gives nothing.
        """
        now = now_ns - self._start_ns
        rx = tuple(rx_frames)
        if rx:
            for k, ecu in enumerate(self._ecus):
                if not self._schedule.silent(k, self._now_ns * 1e-9):
                    ecu.receive(rx, self._now_ns)
        self._now_ns = max(self._now_ns, now)
        last = self._now_ns // PERIOD_NS
        while self._period < last:
            room = GRID - self._period % GRID
            self._advance(min(room, last - self._period))
        for ecu in self._ecus:
            self._ready += ecu.service_frames(self._now_ns)
        self._arbiter.offer(self._ready)
        self._ready = []
        out = self._arbiter.drain(self._now_ns)
        if self._start_ns:
            out = [f._replace(t_ns=f.t_ns + self._start_ns) for f in out]
        return out

    def _advance(self, count: int) -> None:
        """`count` periods, not beyond the next multiple of 10 ms."""
        if self._slow is not None:
            self._advance_slow(count)
            return
        assert self._plant is not None
        first = self._period
        at_ns = np.arange(first, first + count, dtype=np.int64) * PERIOD_NS
        t_s = at_ns * 1e-9
        if first % GRID == 0:
            self._rails = self._schedule.rails(float(t_s[0]))
        w_ref, w_acc, load = self._profile.at(t_s)
        cut = np.stack([ecu.cut(at_ns) for ecu in self._ecus], axis=1)
        rails = np.broadcast_to(rail_array(self._rails), (count, self.scenario.drives, 6))
        out = self._plant.advance(
            w_ref, w_acc, load, self._schedule.carry(t_s, load), cut, np.ascontiguousarray(rails)
        )
        self._period += count
        i2 = out[:, :, columns.I_ALPHA] ** 2 + out[:, :, columns.I_BETA] ** 2
        self._i2_grid.append(i2)
        if "Status" in self._cycles:
            self._i2_status.append(i2)
        self._ready += self._fast_frames(out)
        if self._period % GRID == 0:
            self._on_grid(out[-1], np.concatenate(self._i2_grid).mean(axis=0))
            self._i2_grid = []
        self._ready += self._slow_frames(out, first)

    def _advance_slow(self, count: int) -> None:
        assert self._slow is not None
        self._period += count
        if self._period % GRID:
            return
        now = self._period * PERIOD_NS
        t_s = np.array([(now - GRID_NS) * 1e-9])
        w_ref, _, load = self._profile.at(t_s)
        self._rails = self._schedule.rails(float(t_s[0]))
        cut = np.array([ecu.cut(np.array([now - GRID_NS]))[0] for ecu in self._ecus])
        carry = self._schedule.carry(t_s, load)[0]
        row = self._slow.advance(w_ref[0], load[0], carry, cut)
        i2 = row[:, columns.I_ALPHA] ** 2 + row[:, columns.I_BETA] ** 2
        if "Status" in self._cycles:
            self._i2_status.append(np.tile(i2, (GRID, 1)))
        self._on_grid(row, i2)
        self._ready += self._slow_frames(np.tile(row, (GRID, 1, 1)), self._period - GRID)

    def _on_grid(self, row: Array, i2: Array) -> None:
        """Every 10 ms: heat, faults the ECUs know of, truth."""
        t_s = self._period * PERIOD_NS * 1e-9
        extra, lost = self._schedule.heat(t_s - 0.5 * GRID_NS * 1e-9)
        self._thermal.advance(i2, row[:, columns.SPEED], extra, lost)
        classes = self._schedule.classes(t_s)
        for ecu, number in zip(self._ecus, classes, strict=True):
            ecu.canopen.bus.run_until(self._period * PERIOD_NS)
            ecu.note_fault(number)
        losing = self._schedule.losing(t_s)
        self._effect = self._fault_effect(t_s)
        t_s = round(t_s, 6)
        for k, node in enumerate(self.nodes):
            slipping = False
            if self._plant is not None and self._plant.on_rail:
                rail = self._rails[k]
                slipping = self._plant.overloaded(rail) or self._plant.beyond_peak(k, rail)
            self._truth.append(
                Truth(
                    t_s,
                    node,
                    float(row[k, columns.SPEED]),
                    float(row[k, columns.ANGLE]),
                    float(row[k, columns.LOAD]),
                    int(bool(losing[k]) or slipping),
                    classes[k],
                    float(self._effect[k]),
                )
            )

    def _true_points(self, temperatures: Array) -> Array:
        """(N, 4) what ideal sensors would read, degC."""
        ambient = np.full((self.scenario.drives, 1), self._thermal.ambient)
        return np.concatenate([temperatures[:, list(thermal.MEASURED)], ambient], axis=1)

    def _fault_effect(self, t_s: float) -> Array:
        real = self._true_points(self._thermal.temperatures)
        twin = self._true_points(self._thermal.healthy)
        bias, stuck, lost = self._schedule.temperature_faults(t_s)
        held = self._hold_temperature.held - self._temperatures.offset
        reading = np.where(stuck & ~np.isnan(held), held, real + bias)
        effect = np.where(lost, 0.0, reading - twin)
        largest = np.abs(effect).argmax(axis=1)
        out: Array = effect[np.arange(len(effect)), largest]
        return out

    def _fast_frames(self, out: Array) -> list[Frame]:
        """Currents and voltages, or samples, of every instant that fell into this block."""
        frames: list[Frame] = []
        kind = next((k for k in ("Samples", "PhaseCurrents") if k in self._cycles), None)
        if kind is None:
            return frames
        per = self._cycles[kind]
        self._tail.append(out)
        block = np.concatenate(self._tail) if len(self._tail) > 1 else out
        done = len(block) // per
        self._tail = [block[done * per :]] if len(block) % per else []
        if not done:
            return frames
        first = (self._period - len(block)) // per + 1
        whole = block[: done * per].reshape(done, per, *block.shape[1:])
        if kind == "Samples":
            return self._sample_frames(whole, first)
        readings = self._read_currents(whole[:, -1], first, per)
        u = whole[..., columns.U_ALPHA : columns.U_BETA + 1].mean(axis=1)
        u_dc = whole[:, -1, :, columns.U_DC]
        for d, ecu in enumerate(self._ecus):
            amps, volts, dc = readings[:, d].tolist(), u[:, d].tolist(), u_dc[:, d].tolist()
            for j in range(done):
                instant = (first + j) * per * PERIOD_NS
                i_a, i_b, i_c = amps[j]
                u_a, u_b = volts[j]
                currents: Values = {"Quality": 1, "Ia": i_a, "Ib": i_b, "Ic": i_c}
                voltages: Values = {"Quality": 1, "Ualpha": u_a, "Ubeta": u_b, "Udc": dc[j]}
                for name, values in (("PhaseCurrents", currents), ("StatorVoltages", voltages)):
                    frame = ecu.message(name, instant, values)
                    if frame is not None:
                        frames.append(frame)
        return frames

    def _sample_frames(self, whole: Array, first: int) -> list[Frame]:
        """FD: eight samples a frame; a sample's index counts periods of 125 us from 0."""
        frames = []
        done, per = whole.shape[:2]
        flat = whole.reshape(done * per, *whole.shape[2:])
        readings = self._read_currents(flat, (first - 1) * per + 1, 1).reshape(done, per, -1, 3)
        for d, ecu in enumerate(self._ecus):
            for j in range(done):
                index = (first - 1 + j) * per
                values: Values = {
                    "Quality": 1,
                    "SampleIndex": index % 65536,
                    "Udc": float(whole[j, -1, d, columns.U_DC]),
                }
                amps = readings[j, :, d].tolist()
                volts = whole[j, :, d, columns.U_ALPHA : columns.U_BETA + 1].tolist()
                for k in range(SAMPLES_PER_FRAME):
                    values[f"Ia_{k}"], values[f"Ib_{k}"], _ = amps[k]
                    values[f"Ualpha_{k}"], values[f"Ubeta_{k}"] = volts[k]
                frame = ecu.message("Samples", (index + per) * PERIOD_NS, values)
                if frame is not None:
                    frames.append(frame)
        return frames

    def _read_currents(self, rows: Array, first: int, per: int) -> Array:
        """(n, N, 3) readings of samples first, first + 1, .. taken every `per` periods.

        Lost readings are NaN, which the codec makes the not-available code of.
        """
        readings = self._currents.read(rows[..., columns.I_ALPHA : columns.I_BETA + 1])
        if self._schedule.has_current_faults:
            for j in range(len(readings)):
                t_s = (first + j) * per * PERIOD_NS * 1e-9
                bias, stuck, lost = self._schedule.current_faults(t_s)
                readings[j, :, 0] = self._hold_current.apply(readings[j, :, 0] + bias, stuck)
                readings[j, lost] = math.nan
        return readings

    def _slow_frames(self, out: Array, first: int) -> list[Frame]:
        """Motion, Status, Temperatures of the instants in this block."""
        frames: list[Frame] = []
        makers = {"Motion": self._motion, "Status": self._status, "Temperatures": self._sensed}
        for kind in makers:
            per = self._cycles.get(kind)
            if per is None:
                continue
            for instant in range((first // per + 1) * per, self._period + 1, per):
                values = makers[kind](out[instant - first - 1], instant)
                for ecu, mine in zip(self._ecus, values, strict=True):
                    frame = ecu.message(kind, instant * PERIOD_NS, mine)
                    if frame is not None:
                        frames.append(frame)
        return frames

    def _motion(self, row: Array, _instant: int) -> list[Values]:
        rpm = row[:, columns.SPEED] * 30.0 / math.pi
        degrees = np.degrees(row[:, columns.ANGLE])
        # 359.996 would round to 360.00, which is 0.
        degrees = np.where(degrees >= 359.995, 0.0, degrees)
        return [
            {"Quality": 1, "Speed": w, "ElectricalAngle": a, "Torque": t}
            for w, a, t in zip(
                rpm.tolist(), degrees.tolist(), row[:, columns.TORQUE].tolist(), strict=True
            )
        ]

    def _status(self, row: Array, instant: int) -> list[Values]:
        """`Irms`: over all periods since the last status, of one phase."""
        history = np.concatenate(self._i2_status)
        later = self._period - instant
        used = history[: len(history) - later]
        self._i2_status = [history[len(history) - later :]] if later else []
        rms = np.sqrt(0.5 * used.mean(axis=0))
        return [
            {
                "Quality": 1,
                "Irms": i,
                "TorqueCommand": c,
                "State": OPERATION,
                "FaultCode": ecu.fault_code,
            }
            for i, c, ecu in zip(
                rms.tolist(), row[:, columns.COMMAND].tolist(), self._ecus, strict=True
            )
        ]

    def _sensed(self, _row: Array, instant: int) -> list[Values]:
        readings = self._temperatures.read(self._true_points(self._thermal.temperatures))
        bias, stuck, lost = self._schedule.temperature_faults(instant * PERIOD_NS * 1e-9)
        readings = self._hold_temperature.apply(readings + bias, stuck)
        names = ("Tstator", "Tde", "Tnde", "Tambient")
        out: list[Values] = []
        for row, gone in zip(readings.tolist(), lost.tolist(), strict=True):
            values: Values = {
                name: None if missing else value
                for name, value, missing in zip(names, row, gone, strict=True)
            }
            out.append({"Quality": 1, **values})
        return out


class _Profile:
    """Rotor speed, its slope and load over time, from the scenario's tables."""

    def __init__(self, scenario: Scenario, motor: Motor) -> None:
        self._motion, self._load = scenario.motion, scenario.load
        self._rpm = scenario.motion.unit == "rpm"
        self._pole_pairs = motor.pole_pairs

    def at(self, t_s: Array) -> tuple[Array, Array, Array]:
        """Rotor rad/s, rad/s2, Nm, each (n,), at times (n,)."""
        points = self._motion.profile or [(0.0, self._motion.speed)]
        factor = math.pi / 30.0 if self._rpm else 1.0 / self._pole_pairs
        times = np.array([t for t, _ in points])
        speeds = factor * np.array([w for _, w in points])
        w_ref = np.interp(t_s, times, speeds)
        w_acc = np.zeros_like(t_s)
        if len(points) > 1:
            slopes = np.concatenate([[0.0], np.diff(speeds) / np.diff(times), [0.0]])
            w_acc = slopes[np.searchsorted(times, t_s, side="right")]
        return w_ref, w_acc, _load_at(self._load, t_s)


def _load_at(load: Load, t_s: Array) -> Array:
    points = load.profile or [(0.0, load.torque_nm)]
    times = np.array([t for t, _ in points])
    values = np.array([v for _, v in points])
    if load.transition == "linear":
        return np.interp(t_s, times, values)
    out = np.full_like(t_s, values[0])
    for at, step in zip(times[1:], np.diff(values), strict=True):
        out += step * ndtr((t_s - at) / load.smooth_s)
    return out


def _cycles(ecus: Sequence[Ecu], *, slow: bool) -> dict[str, int]:
    """Cycle of each kind of message in periods of 125 us."""
    out = {}
    for kind, spec in ecus[0].specs.items():
        if slow and kind in FULL:
            continue
        periods, rest = divmod(spec.cycle_ns, PERIOD_NS)
        if rest or not periods:
            msg = f"{spec.name}: cycle time {spec.cycle_ns} ns is not a multiple of 125 us"
            raise ValueError(msg)
        out[kind] = periods
    return out
