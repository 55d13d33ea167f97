"""A synthetic loss of adhesion, to check whether and when a configuration detects it.

Each drive is simulated with its own motor on the virtual clock, at a steady speed and load at which
its adhesion can be known. At a known time one drive's load halves. The configuration's own gateway
(its detector, times, noise, DBC, rate, motors and mapped inverters) reads the frames.
"""

from __future__ import annotations

import math
from bisect import bisect_right
from collections import defaultdict
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from functools import cached_property, partial
from itertools import takewhile
from typing import TYPE_CHECKING, Final, NamedTuple

from dbc.codec import Codec, bind
from dbc.frame import MS, SECOND, Frame, Nanos
from gateway.core.codes import Flag, Reason
from gateway.core.gateway import Gateway
from gateway.hil.inverter_sim import Inverters
from gateway.mapping import lacks
from gateway.mapping import plan as foreign
from gateway.reports.record import camel
from gateway.settings.config import BENCH_MOTOR, Config, shipped_dbc
from sim.physics import plant
from sim.scenario import ScenarioError, parse
from sim.simulation import PERIOD_NS, Simulation

if TYPE_CHECKING:
    from gateway.core.view import DriveView
    from gateway.hil.measured import Measured
    from gateway.mapping.plan import Plan
    from gateway.settings.config import Motor

DEPTH: Final = 0.5
LOAD: Final = 0.6
"""Share of the torque that rated current and rated torque allow."""
WITHIN_NS: Final[Nanos] = SECOND
SETTLE_NS: Final[Nanos] = 3 * SECOND // 2
"""Time before the loss, on top of `good_ms`: filters start and load ratios are learnt."""
CHUNK_NS: Final[Nanos] = 100 * MS
SPEED_RAD_S: Final = 100.0
"""Electrical speed, if the samples and `min_speed_rad_s` allow it."""
SAMPLES_PER_TURN: Final = 15
"""Fewest samples per electrical turn at the chosen speed; below ten the filters stop following."""


class Found(NamedTuple):
    """Result for the loss on drive `node`.

    after_ms: from the loss to `AdhesionLost`; None with a `problem`, which names the likely cause.
    """

    node: int
    after_ms: float | None
    problem: str = ""


class _Alike(NamedTuple):
    """Drives with the same motor and messages; plans: those of its mapped drives."""

    nodes: tuple[int, ...]
    motor: Motor
    codec: Codec
    plans: tuple[Plan, ...]


def never(config: Config, codec: Codec) -> dict[int, str]:
    """Drives whose adhesion is never known, by node, and why. codec: from `foreign.fitted`."""
    kinds: dict[int, set[str]] = defaultdict(set)
    for spec in codec.messages:
        kinds[spec.node].add(spec.kind)
    found = {d.node: lacks.adhesion(kinds[d.node], d.signals) for d in config.drive}
    return {node: ", ".join(texts) for node, texts in found.items() if texts}


def losses(config: Config, codec: Codec, measured: Measured | None = None) -> Iterator[Found]:
    """Test a loss on one drive of every motor and kind of inverter, one after the other.

    codec: that of the configuration's DBC. measured: records the time before the first loss. Raises
    ConfigError as `Gateway` does, ValueError if the DBC's messages cannot be simulated.
    """
    planned = foreign.plans(config)
    judged = [n for n in config.nodes if n not in never(config, foreign.fitted(codec, planned))]
    alike = _alike(config, codec, planned, judged)
    if not alike:
        return
    speed = _speed(config, alike)
    begin = config.adhesion.good_ms * MS + max(
        SETTLE_NS, *(3 * s.cycle_ns for one in alike for s in one.codec.messages
                     if s.node == one.nodes[0] and s.kind == "Status"),
    )  # fmt: skip
    begin += -begin % CHUNK_NS
    healthy = [_Stream(config, one, speed, begin) for one in alike]
    streams = {n: stream for stream in healthy for n in stream.nodes}
    for one in alike:
        lossy = dict.fromkeys(one.nodes, _Stream(config, one, speed, begin, lost=True))
        ticks = _ticks(config, codec, {**streams, **lossy}, begin, measured)
        try:
            yield _judge(config, one.nodes[0], ticks, begin)
        except ScenarioError as error:
            yield Found(one.nodes[0], None, f"a motor of this train: {error.problems[0]}")
            continue
        if measured is not None:  # the verdict may come before the loss
            for _ in takewhile(lambda tick: tick[0] < begin, ticks):
                pass
            measured = None


def _alike(
    config: Config, codec: Codec, planned: Sequence[Plan], judged: Sequence[int]
) -> list[_Alike]:
    """Groups of drives that one simulation can drive, in the order of their first drives."""
    plans = {plan.node: plan for plan in planned}
    groups: dict[tuple[object, ...], list[int]] = defaultdict(list)
    motors = {}
    for drive in config.drive:
        if drive.node not in judged:
            continue
        motors[drive.node] = motor = config.motors[drive.motor]
        plan = plans.get(drive.node)
        specs = codec.messages if plan is None else plan.spec.values()
        cycles = {s.kind: s.cycle_ns for s in specs if s.node == drive.node}
        mapped = plan and (plan.signals.dbc, tuple(plan.signals.use.items()))
        groups[motor, mapped, tuple(sorted(cycles.items()))].append(drive.node)
    out = []
    for nodes in groups.values():
        mine = tuple(plans[n] for n in nodes if n in plans)
        motor = motors[nodes[0]]
        out.append(_Alike(tuple(nodes), motor, _wide(mine, motor) if mine else codec, mine))
    return out


def _wide(plans: Sequence[Plan], motor: Motor) -> Codec:
    """Our message set with the cycle times and ranges of mapped drives, for translation."""
    ours = bind(shipped_dbc("traction.dbc"), [plan.node for plan in plans])
    sizes = {"Ia": motor.I_rated, "Ib": motor.I_rated, "Ic": motor.I_rated, "Irms": motor.I_rated,
             "Torque": motor.T_rated, "TorqueCommand": motor.T_rated,
             "Ualpha": 1000.0, "Ubeta": 1000.0}  # fmt: skip
    cycles = {
        kind: max(1, round(plans[0].spec["PhaseCurrents"].cycle_ns / PERIOD_NS)) * PERIOD_NS
        for kind in ("PhaseCurrents", "StatorVoltages")
    } | {"Motion": 10 * MS, "Status": 10 * MS}
    messages = [
        replace(
            spec,
            cycle_ns=cycles.get(spec.kind, spec.cycle_ns),
            signals=tuple(
                replace(s, scale=sizes[s.name] / 3000.0) if s.name in sizes else s
                for s in spec.signals
            ),
        )
        for spec in ours.messages
    ]
    return Codec(ours.path, messages, ours.digest)


def _speed(config: Config, alike: Sequence[_Alike]) -> float:
    """Speed of all rotors, rad/s, at which every drive's adhesion can be known, if there is one."""
    least, most = 0.0, math.inf
    for one in alike:
        sample = min(
            PERIOD_NS if s.kind == "Samples" else s.cycle_ns
            for s in one.codec.messages
            if s.node == one.nodes[0] and s.kind in ("Samples", "PhaseCurrents")
        )
        pairs = one.motor.pole_pairs
        least = max(least, 2.0 * config.estimator.min_speed_rad_s / pairs)
        turn = 2.0 * math.pi / (SAMPLES_PER_TURN * sample / SECOND)
        most = min(most, max(turn, 1.2 * config.estimator.min_speed_rad_s) / pairs)
    return min(max(SPEED_RAD_S / alike[0].motor.pole_pairs, least), most)


class _Stream:
    """Frames of a group of drives, simulated only as far as requested.

    With `lost`, the first drive of the group loses half of its load at `begin`.
    """

    def __init__(
        self, config: Config, one: _Alike, speed: float, begin: Nanos, *, lost: bool = False
    ) -> None:
        motor, share = one.motor, one.motor.I_rated / BENCH_MOTOR.I_rated
        load = LOAD * min(motor.T_rated, motor.torque_nm)
        at_s, first = begin / SECOND, one.nodes[0]
        loss = {"at_s": at_s, "drive": first, "kind": "adhesion_loss", "depth": DEPTH}
        scenario = parse({
            "title": "synthetic loss", "seed": 2 if lost else 1, "event": [loss] if lost else [],
            "duration_s": (begin + 2 * WITHIN_NS) / SECOND, "nodes": list(one.nodes),
            "load": {"kind": "preset", "torque_nm": load},
            "motion": {"speed": speed * motor.pole_pairs},
            "sensors": {"current_noise_var": config.estimator.current_noise_var * share**2,
                        "current_range_a": 100.0 * motor.I_rated},
            "thermal": {"start": "ambient"}, "bus": {"bitrate": 0},
        })  # fmt: skip
        self.nodes = one.nodes
        self._codec = one.codec
        self._make = partial(Simulation, scenario, one.codec, motor=simulated(motor, speed, load))
        mapped = [plan for plan in one.plans if plan.node in one.nodes]
        self._inverters = [Inverters([plan], one.codec) for plan in mapped]
        self._chunks: list[dict[int, list[Frame]]] = []

    @cached_property
    def _simulation(self) -> Simulation:
        return self._make()

    def chunk(self, k: int, node: int) -> list[Frame]:
        """Frames of drive `node` in the k-th 100 ms, from 0."""
        while k >= len(self._chunks):
            frames = self._simulation.step((), (len(self._chunks) + 1) * CHUNK_NS)
            by_node: dict[int, list[Frame]] = {n: [] for n in self.nodes}
            for frame in frames:
                by_node[_sender(self._codec, frame)].append(frame)
            for n, inverters in zip(self.nodes, self._inverters, strict=False):
                by_node[n] = inverters.convert(by_node[n])
            self._chunks.append(by_node)
        return self._chunks[k][node]


def _sender(codec: Codec, frame: Frame) -> int:
    """Node of a drive's frame; identifiers of CANopen contain it."""
    spec = codec.by_id.get(frame.can_id)
    return frame.can_id & 0x7F if spec is None else spec.node


def simulated(motor: Motor, speed: float, load: float) -> plant.Motor:
    """The motor for the simulator, with a DC link voltage sufficient for this speed and load."""
    w_e, i_q = motor.pole_pairs * speed, load / (motor.torque_nm / motor.I_rated)
    link = max(4.0 * motor.voltage(w_e, i_q), math.sqrt(4.0 * load * speed), 24.0)
    return plant.Motor(**motor.model_dump(), U_dc=link)


def _ticks(
    config: Config,
    codec: Codec,
    sent: Mapping[int, _Stream],
    begin: Nanos,
    measured: Measured | None,
) -> Iterator[tuple[Nanos, Sequence[DriveView]]]:
    """Run the gateway on the frames: (now, drives) of each tick until `WITHIN_NS` after `begin`."""
    gateway, period = Gateway(config, codec, 0), config.loop.period_ns
    waiting: list[Frame] = []
    for now in range(period, begin + WITHIN_NS + period, period):
        if now % CHUNK_NS == period % CHUNK_NS:
            k = now // CHUNK_NS
            waiting += sorted(f for n, stream in sent.items() for f in stream.chunk(k, n))
        due = bisect_right(waiting, now, key=lambda frame: frame.t_ns)
        batch, waiting = waiting[:due], waiting[due:]
        if measured is None:
            gateway.step(batch, now)
        else:
            measured.step(gateway, batch, now, begin)
        assert gateway.view is not None
        yield now, gateway.view.drives


def _judge(
    config: Config, node: int, ticks: Iterator[tuple[Nanos, Sequence[DriveView]]], begin: Nanos
) -> Found:
    """Result for a loss on drive `node` at `begin`, from the flags in these ticks."""
    place = config.nodes.index(node)
    most = 0.0
    for now, drives in ticks:
        wrong = [d.node for d in drives if d.adhesion is Flag.BAD and d.node != node]
        if wrong or (now <= begin and drives[place].adhesion is Flag.BAD):
            return Found(node, None, _false(wrong or [node], (now - begin) / MS, config))
        if now < begin:
            continue
        if now == begin and drives[place].adhesion is not Flag.GOOD:
            return Found(node, None, _unknown(drives[place], "before the loss"))
        if drives[place].adhesion is Flag.BAD:
            return Found(node, (now - begin) / MS)
        most = max(most, drives[place].loss_probability or 0.0)
    return Found(node, None, _cause(drives[place], most, config))


def _raise_ms(config: Config) -> str:
    """The time after which a loss is flagged, ms, with the key that sets it."""
    own, after_ms = config.adhesion.raise_ms, config.adhesion.raised_after_ms[0]
    key = "raise_ms" if own == after_ms else "false_alarms_per_1000_h by fault_free"
    return f"adhesion.{key} = {after_ms}"


def _false(nodes: Sequence[int], since_ms: float, config: Config) -> str:
    """Problem text for `AdhesionLost` of drives that have not lost adhesion."""
    when = f"{since_ms:.0f} ms after" if since_ms >= 0 else f"{-since_ms:.0f} ms before"
    return (
        f"drive {nodes[0]} is AdhesionLost {when} the loss, although it lost no adhesion: "
        f"{_spread(config)}{_raise_ms(config)} ms is too "
        "small for the noise, or a parameter in [motor] is wrong"
    )


def _spread(config: Config, then: str = " or ") -> str:
    """The key `spread_nm` in words; empty for the detector that learns the spread."""
    a = config.adhesion
    return "" if a.detector == "switching" else f"adhesion.spread_nm = {a.spread_nm:g} Nm{then}"


def _unknown(view: DriveView, when: str) -> str:
    why = view.adhesion_reason
    return f"the drive is Unknown {when}, reason {camel(why.name)}: {_CURES.get(why, _FILTER)}"


def _cause(view: DriveView, most: float, config: Config) -> str:
    """Why a loss was not found. view: at the end; most: highest loss probability since the loss."""
    a = config.adhesion
    signals = {drive.node: drive.signals for drive in config.drive}[view.node]
    if signals is not None and "TorqueCommand" not in signals.use:
        return (
            "its measured torque replaces the missing command and falls with the load: map "
            "TorqueCommand to the commanded torque"
        )
    if most >= a.raise_probability:
        return (
            f"its loss probability reaches {most:.3g}, but does not hold for "
            f"{_raise_ms(config)} ms: reduce it"
        )
    if view.adhesion is Flag.UNKNOWN:
        return _unknown(view, "in the loss")
    return (
        f"its loss probability reaches only {most:.3g}, below adhesion.raise_probability = "
        f"{a.raise_probability:g}: {_spread(config, ' hides it, or ')}"
        "estimator.process_noise and estimator.current_noise_var do not suit the motor"
    )


_FILTER: Final = (
    "the filter does not follow the motor: compare [motor] with its data sheet, and "
    "estimator.process_noise, current_noise_var and min_speed_rad_s with the defaults"
)
_CURES: Final = {
    Reason.RANGE: "signals of the DBC cannot hold 60 % of I_rated and T_rated of its motor: "
    "correct [motor], or give those signals a larger factor; or its currents and its torque "
    "contradict each other: compare estimator.process_noise with the default",
    Reason.STALE: "messages come less often than GenMsgCycleTime of the DBC says",
}
