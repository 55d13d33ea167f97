"""Forecast of the time to detect a loss, from DBC, data sheet and noise, without a simulator.

The load estimate's error and its response to a lost load follow from the filter's steady gain
(`estimators.load_response`). Loads with this error go through the configuration's own detector,
debounce and transmission. Each drive stops the spin-up within some ms (`CATCH_RAD_S`), and all turn
at one steady speed. May know: the core's records. May not know: frames.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from itertools import pairwise
from typing import TYPE_CHECKING, Any, Final, NamedTuple

import numpy as np
from _traction_core import lib

from dbc.frame import MS, SECOND, Nanos
from estimators import load_response
from estimators.load_response import Answer
from gateway.core import start_record
from gateway.core.channel import RPM
from gateway.core.codes import Flag, Health, Reason
from gateway.core.flags import FlagKind
from gateway.core.gateway import Gateway
from gateway.reports.record import camel
from gateway.settings.config import BENCH_MOTOR

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from dbc.codec import Codec
    from dbc.spec import SignalSpec
    from gateway.core.channel import Channel
    from gateway.settings.config import Config

    Array = NDArray[np.float64]

RUNS: Final = 20
"""Cases, each with its own random load errors and its own phase of the loss in the bus cycles."""
WARM_NS: Final[Nanos] = 2500 * MS
"""Time before the loss, in which the detector learns the noise."""
LIMIT_NS: Final[Nanos] = 300 * MS
"""A loss that is not found within this time counts as not found."""
OBSERVER_STEPS: Final = 16
"""Steps into which a cycle of `Motion` is divided."""
CURRENT, VOLTAGE = ("Ia", "Ia_0"), ("Ualpha", "Ualpha_0")
CATCH_RAD_S: Final = 60.0
"""Bandwidth of a drive's own slip or speed control, critically damped as in the simulator."""


class Source(NamedTuple):
    """Source of a drive's load. every_ns: measurement interval; cycle_ns: message cycle time."""

    answer: Answer
    every_ns: Nanos
    cycle_ns: Nanos
    by_observer: bool

    def newest(self, now: Nanos) -> Nanos:
        """Time of the newest measurement that is available to a tick at `now`."""
        return (-(-now // self.cycle_ns) - 1) * self.cycle_ns

    def answered(self, passed: Nanos, inertia: float) -> tuple[float, float]:
        """Changes of estimated load and speed, per Nm lost, `passed` after the loss."""
        if passed <= 0:
            return 0.0, 0.0
        a, steps = self.answer, len(self.answer.within)
        count, rest = divmod(passed, self.every_ns)
        e = -a.within[min(steps - 1, round(steps * (1.0 - rest / self.every_ns)))]
        times = [(rest + k * self.every_ns) / SECOND for k in range(-1, count + 1)]
        for k, (t, after) in enumerate(pairwise(times)):
            e = a.A @ e if k else e
            if self.by_observer:
                e = e + a.rest[:, 0] * _torque_error(t, after) / inertia
        load, speed = (a.out @ e).tolist()
        return -1.0 - load, _spin_up(times[-1]) / inertia - speed

    def errors(self, period_ns: Nanos, ticks: int, rng: np.random.Generator) -> Array:
        """Random estimation errors (ticks, RUNS, 2) of load, Nm, and speed, rad/s, at each tick."""
        a = self.answer
        stride = max(1, period_ns // self.every_ns)
        A, noise = a.A, a.noise
        A, noise = np.linalg.matrix_power(A, stride), _summed(A, noise, stride)
        e = _root(a.P) @ rng.standard_normal((len(A), RUNS))
        root, out = _root(noise), [(a.out @ e).T]
        while len(out) * stride * self.every_ns <= ticks * period_ns:
            e = A @ e + root @ rng.standard_normal(e.shape)
            out.append((a.out @ e).T)
        at = np.arange(ticks) * period_ns // (stride * self.every_ns)
        return np.array(out)[at]


def _spin_up(t: float) -> float:
    """Speed gained by a rotor, times its inertia, t s after the loss of 1 Nm."""
    return max(t, 0.0) * math.exp(-CATCH_RAD_S * t)


def _torque(t: float) -> float:
    """Change of the drive's torque t s after the loss: derivative of `_spin_up`, minus 1 Nm."""
    return (1.0 - CATCH_RAD_S * t) * math.exp(-CATCH_RAD_S * t) - 1.0 if t > 0.0 else 0.0


def _torque_error(t: float, after: float) -> float:
    """True torque impulse between two measurements, Nm s, minus the observer's (mean of ends)."""
    true = _spin_up(after) - after - (_spin_up(t) - max(t, 0.0))
    return true - 0.5 * (after - t) * (_torque(t) + _torque(after))


def _summed(A: Array, noise: Array, count: int) -> Array:
    total = noise
    for _ in range(count - 1):
        total = A @ total @ A.T + noise
    return total


def _root(P: Array) -> Array:
    values, vectors = np.linalg.eigh(P)
    return np.asarray(vectors * np.sqrt(np.maximum(values, 0.0)))


class Forecast:
    """Forecast for one speed and torque. Raises ConfigError as `Gateway`, ValueError (reason)."""

    def __init__(self, config: Config, codec: Codec, speed_rad_s: float, torque: float) -> None:
        """speed_rad_s: speed of all rotors; torque: share of each motor's rated torque."""
        self._gateway = gateway = Gateway(config, codec, 0)
        self._period = config.loop.period_ns
        self._torque = torque * np.array(gateway.adhesion.rated)
        self._inertia = gateway.motion.motions["mechanics"]["J"].tolist()
        self.sources = sources(gateway, speed_rad_s)
        _check_range(gateway, speed_rad_s, self._torque)
        rng = np.random.default_rng(1)
        status = [d.channels.get("Status") for d in gateway.inbox.drives]
        self._status_ns = max((c.period_ns for c in status if c), default=self._period)
        self._warm = -(-WARM_NS // self._period)
        ticks = self._warm + (LIMIT_NS + self._status_ns) // self._period + 2
        errors = [s.errors(self._period, ticks, rng) for s in self.sources]
        self._load, self._speed = np.moveaxis(np.stack(errors, axis=2), 3, 0)
        self._load += self._torque
        self._speed += speed_rad_s
        self._sent_ns = max(gateway.outbox.specs["Gateway_Adhesion"].cycle_ns, self._period)
        inputs, drives = gateway.inputs.status, gateway.inbox.receiver.drives
        inputs["speed_rad_s"] = [
            speed_rad_s if d.motion else math.nan for d in gateway.inbox.drives
        ]
        inputs["sample_fresh"], inputs["comm"], inputs["reason"] = 1, Flag.GOOD, Reason.NONE
        inputs["command_valid"] = [c is not None for c in status]
        drives["command"] = drives["previous_command"] = self._torque
        drives["command_steady"] = drives["operating"] = 1
        self._first = start_record.state_of(gateway)
        self._warmed = [self._warm_up(run) for run in range(RUNS)]

    def delays_ms(self, drive: int, loss: float) -> Array:
        """(RUNS,) times from a loss to the drive's bad flag, ms; infinite: not found.

        loss: share of the drive's load.
        """
        return np.array([self._delay_ms(run, drive, loss) for run in range(RUNS)])

    def _warm_up(self, run: int) -> start_record.State:
        start_record.set_state(self._gateway, self._first)
        for k in range(1, self._warm + 1):
            self._tick(self._load[k - 1, run], self._speed[k - 1, run], k * self._period)
        drives = self._gateway.status.drives
        for k in np.flatnonzero(self._flags() != Flag.GOOD)[:1].tolist():
            why = camel(Reason(drives["adhesion_reason"][k]).name)
            raise ValueError(f"drive {self._gateway.nodes[k]} is not judged, reason {why}")
        return start_record.state_of(self._gateway)

    def _delay_ms(self, run: int, drive: int, loss: float) -> float:
        start_record.set_state(self._gateway, self._warmed[run])
        # Phases spread over the cycle of Status and, by the golden ratio, over the tick.
        phase = (run + run * 0.618 % 1.0) / RUNS
        begin = self._warm * self._period + round(phase * self._status_ns)
        k = self._warm
        while (now := (k + 1) * self._period) <= begin + LIMIT_NS:
            passed = self.sources[drive].newest(now) - begin
            moved = self.sources[drive].answered(passed, self._inertia[drive])
            load, speed = self._load[k, run].copy(), self._speed[k, run].copy()
            load[drive] += loss * self._torque[drive] * moved[0]
            speed[drive] += loss * self._torque[drive] * moved[1]
            self._tick(load, speed, now)
            if self._flags()[drive] == Flag.BAD:
                sent = -(-now // self._sent_ns) * self._sent_ns
                return (sent - begin) / MS if now > begin else math.inf
            k += 1
        return math.inf

    def _flags(self) -> Any:
        return self._gateway.status.drives["flag"][:, FlagKind.ADHESION]["state"]

    def _tick(self, load: Array, speed: Array, now: Nanos) -> None:
        """Run a tick from the estimates onwards, as in `tick.c`."""
        gateway, estimates = self._gateway, self._gateway.bank.estimates
        estimates["load_nm"], estimates["speed_rad_s"] = load, speed
        estimates["load_sigma_nm"] = [s.answer.sigma for s in self.sources]
        estimates["health"], estimates["nis"] = Health.TRACKING, 2.0
        gateway.inbox.receiver.drives["command_ns"] = now // self._status_ns * self._status_ns
        p = gateway.pointer
        lib.adhesion_prepare(p.adhesion, p.estimates, p.inputs, p.receiver.drives, p.status, now)
        if p.detects:
            lib.adhesion_detect(p.adhesion)
        else:
            gateway.adhesion.ask_detector(estimates)
        p.stage, p.sent_count = lib.STAGE_DETECT, 0
        lib.finish_tick(p, now)


def sources(gateway: Gateway, speed_rad_s: float) -> list[Source]:
    """Load source of each drive: its filter, or the observer if any drive is too fast for samples.

    Raises ValueError for a drive without currents, or too fast and without `Motion`.
    """
    motors = gateway.bank.motors
    most = gateway.motion.record["max_w_e"].item()
    fast = [motor[3] * speed_rad_s > most for motor in motors]
    out = []
    for k, drive in enumerate(gateway.inbox.drives):
        if not drive.electrical:
            raise ValueError(f"drive {drive.node} sends no currents")
        if any(fast) and drive.motion is not None:
            out.append(_observer(gateway, k, drive.motion))
        elif fast[k]:
            raise ValueError(
                f"drive {drive.node} sends too few samples for this speed, and no Motion"
            )
        else:
            out.append(_filter(gateway, k, drive.electrical, motors[k], speed_rad_s * motors[k][3]))
    return out


def _check_range(gateway: Gateway, speed_rad_s: float, torque: Array) -> None:
    """Raises ValueError if the DBC's signals cannot hold the current or the speed."""
    for drive, nm, motor in zip(gateway.inbox.drives, torque, gateway.bank.motors, strict=True):
        per_a = motor[6] * motor[3] * motor[2]
        for names, channels, size, unit in (
            (CURRENT, drive.electrical, nm / per_a, "A"),
            (("Speed",), [drive.motion] if drive.motion else [], speed_rad_s / RPM, "rpm"),
        ):
            for signal in _signals(channels, names):
                most = signal.float_max if signal.is_float else signal.raw_max * abs(signal.scale)
                if size > most:
                    limit = f"but {signal.name} in the DBC ends at {most:.0f} {unit}"
                    raise ValueError(f"drive {drive.node} needs {size:.0f} {unit}, {limit}")


def _filter(
    gateway: Gateway, k: int, channels: Sequence[Channel], motor: Array, w_e: float
) -> Source:
    least = gateway.bank.record["limits"]["w_on"].item()
    if w_e < least:
        raise ValueError(f"{w_e:.0f} rad/s electrical is below min_speed_rad_s = {least:g}")
    noise, dt = gateway.bank.noise, gateway.motion.record["dt"].item()
    steps = round(gateway.motion.record["period_s"].item() / dt)
    step_a, step_v = _step(channels, CURRENT), _step(channels, VOLTAGE)
    rated = gateway.bank.rated_a[k] / BENCH_MOTOR.I_rated
    phase = gateway.config.estimator.current_noise_var * rated**2 + step_a**2 / 12.0
    # Variance share of three phases, or of two phases (mean of alpha and beta).
    share = 2.0 / 3.0 if len(channels) > 1 else 4.0 / 3.0
    of = load_response.ekf(
        motor, noise.Q[k], noise.R[k], phase * share * np.eye(2), step_v**2 / 12.0, w_e, steps, dt
    )
    cycle = max(c.period_ns for c in channels)
    return Source(load_response.answer(of), round(steps * dt * SECOND), cycle, by_observer=False)


def _observer(gateway: Gateway, k: int, channel: Channel) -> Source:
    m = gateway.motion.motions["mechanics"][k]
    step_w = _step((channel,), ("Speed",)) * RPM
    of = load_response.observer(
        m["J"].item(), m["B"].item(), m["load_rate"].item(),
        (m["speed_var"].item(), step_w**2 / 12.0), _step((channel,), ("Torque",)) ** 2 / 12.0,
        channel.period_ns / SECOND, OBSERVER_STEPS,
    )  # fmt: skip
    return Source(load_response.answer(of), channel.period_ns, channel.period_ns, by_observer=True)


def _signals(channels: Sequence[Channel], names: Sequence[str]) -> list[SignalSpec]:
    return [s for c in channels for s in c.spec.signals if s.name in names]


def _step(channels: Sequence[Channel], names: Sequence[str]) -> float:
    """Coarsest resolution of the signals with these names; 0 if there are none."""
    return max((abs(s.scale) for s in _signals(channels, names)), default=0.0)
