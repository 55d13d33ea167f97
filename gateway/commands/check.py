"""`check CONFIG`: everything that can be known before the first run."""

from __future__ import annotations

import argparse
import time
from pathlib import Path
from typing import TYPE_CHECKING

from dbc.text import printable
from dbc.wire_time import bits_of
from gateway.commands.common import BAD_INPUT, GOOD, add_bus, add_signature
from gateway.io.console import console
from gateway.io.prepare import prepare
from gateway.settings.config import ConfigError

if TYPE_CHECKING:
    from collections.abc import Sequence

    from dbc.codec import Codec, MessageSpec
    from dbc.frame import Frame
    from gateway.mapping.plan import Plan
    from gateway.settings.config import Config

HELP = "configuration against DBC, bus load and timing budget"
LOAD_LIMIT_PERCENT = 80.0
MEASURE_S = 2.0
SETTLE_S = 1.0
"""Before it: filters start, drives come to life."""


def arguments(parser: argparse.ArgumentParser) -> None:
    """Options of the verb."""
    parser.description = (
        "Configuration against DBC, bus load and timing budget, before deployment. A synthetic "
        "loss of 50 % of the load on a drive of each kind goes through the configuration: what is "
        "found, and after how many ms. Exit 2 where the loss is not found within 1 s."
    )
    parser.add_argument("config", type=Path, help="the configuration to check")
    add_signature(parser)
    parser.add_argument("--no-timing", action="store_true", help="skip the self-measurement")
    add_bus(parser)


def run(options: argparse.Namespace) -> int:
    """Print what will be; exit 2 if it cannot work, or would never tell a loss."""
    from gateway.commands import check_loss
    from gateway.commands.check_signals import told
    from gateway.mapping import plan as foreign
    from gateway.settings import calibration

    config, codec = prepare(options.config, signature=options)
    planned = foreign.plans(config)
    foreign.fitted(codec, planned)
    word = calibration.config_hash(config, codec.digest, calibration.of(config))
    print(f"configuration  good, hash {word:06x}")
    print(
        f"message set    {printable(codec.path.name)}: "
        f"{len(codec.messages)} messages fit the contract"
    )
    for plan in planned:
        print("\n".join(told(plan)))
    percent = bus_load(codec, config, planned)
    verdict = "good" if percent <= LOAD_LIMIT_PERCENT else "too much"
    print(f"bus load       {percent:.0f} % with worst-case stuffing, {verdict}")
    if not options.no_timing:
        _tell_measured(config, codec)
    print(f"heartbeats     {_heartbeats(config)}")
    unfound = check_loss.tell(config, codec)
    calibrated = (
        f"calibrated, method {config.thermal.method}"
        if config.calibration_path
        else "not calibrated: flags stay unknown"
    )
    print(f"thermal        {calibrated}")
    signed = f"by the owner of {options.public_key}" if config.sealed else "not checked"
    print(f"signature      {signed}")
    print(f"flags          {_authentication(config)}")
    _tell_machine(options, config)
    if percent > LOAD_LIMIT_PERCENT:
        console().print(
            f"bus load {percent:.0f} % is above {LOAD_LIMIT_PERCENT:.0f} %: use slower cycles in "
            "the DBC (GenMsgCycleTime), fewer drives on this bus, or CAN FD",
            markup=False, soft_wrap=True,
        )  # fmt: skip
    if unfound:
        console().print(
            "no loss would be told: " + "; ".join(unfound), markup=False, soft_wrap=True
        )
    return BAD_INPUT if unfound or percent > LOAD_LIMIT_PERCENT else GOOD


def _tell_measured(config: Config, codec: Codec) -> None:
    """Bus load and timing of simulated drives, where the DBC's messages can be simulated."""
    ours = config.unmapped()
    try:
        frames, times_us = measure(ours, codec)
    except ValueError as error:
        print(f"timing         not measured: these messages cannot be simulated: {error}")
        return
    if ours is not config:
        print("timing         as if all drives spoke our message set: without translation")
    _tell_loads(codec, config, frames)
    _tell_timing(times_us, config.loop.period_ns / 1e3)


def _tell_machine(options: argparse.Namespace, config: Config) -> None:
    """Settings of the kernel and of the link, each with its cure; they refuse nothing."""
    from gateway.commands.run import bus_options
    from gateway.io import interface_settings as settings

    bus = bus_options(options, config)
    found = settings.machine()
    if bus.get("interface") == "socketcan" and bus.get("channel"):
        rates = (int(bus.get(key) or 0) for key in ("bitrate", "data_bitrate"))
        found += settings.link(str(bus["channel"]), *rates)
    else:
        print("link           not looked at: name it with -i socketcan -c can0, or in [bus]")
    for what, said, cure in found:
        print(f"{what:<14} {said}{'' if cure else ', good'}")
        if cure:
            print(f"{'':<14} cure: {cure}")


def _heartbeats(config: Config) -> str:
    """What the gateway expects of the drives' heartbeats."""
    from gateway.core.gateway import HEARTBEAT_LIMIT_NS
    from gateway.core.supervision import TIMEOUT_PERIODS

    shortest = HEARTBEAT_LIMIT_NS // 1_000_000
    if (period := config.canopen.heartbeat_ms) is None:
        return (
            "of any period, or none: from its second one on a drive is lost after "
            f"{TIMEOUT_PERIODS} of the periods heard, at least {shortest} ms"
        )
    limit = max(shortest, TIMEOUT_PERIODS * period)
    return f"every {period} ms: from its second one on a drive is lost after {limit} ms of silence"


def _authentication(config: Config) -> str:
    if config.authentication is None:
        return "not authenticated"
    from gateway.io.credentials import flag_key

    try:
        flag_key(config.authentication.key, config.base)
    except ConfigError as error:
        # Keys are where the gateway runs; a configuration is checked anywhere.
        return f"authenticated; no key here: {error.problems[0]}"
    return "authenticated, the key can be used"


def frame_seconds(spec: MessageSpec, bitrate: int, data_bitrate: int) -> float:
    """Longest time one frame occupies the bus, s; worst-case stuffing.

    Classic: 47 + 8 n bits and a stuff bit per four of the first 34 + 8 n. FD: the arbitration
    part and the end of frame at the nominal rate (29 bits and worst stuffing), the data part
    with its 17- or 21-bit CRC, fixed stuff bits and worst stuffing at the data rate.
    """
    n = spec.length
    if not spec.is_fd:
        return (47 + 8 * n + (33 + 8 * n) // 4) / bitrate
    crc = 21 + 6 if n > 16 else 17 + 5
    return 34 / bitrate + (8 * n + 9 + crc + (8 * n + 9) // 4) / (
        data_bitrate if spec.brs else bitrate
    )


def bus_load(codec: Codec, config: Config, planned: Sequence[Plan] = ()) -> float:
    """Percent of the bus that the configured drives and the gateway take.

    planned: drives of other makers, of which only the messages in use are known.
    """
    from gateway.core.transmit import VOUCHED, Outbox

    outbox = Outbox(codec, config.nodes, 0, config.loop.period_ns)
    ours = set(outbox.specs)
    bus = config.bus
    busy = 0.0
    if config.authentication is not None:
        follows = sum(1e9 / outbox.specs[name].cycle_ns for name in VOUCHED)
        busy += frame_seconds(outbox.auth, bus.bitrate, bus.data_bitrate) * follows
    mapped = {plan.node for plan in planned}
    native = [node for node in config.nodes if node not in mapped]
    theirs = {spec.key: spec for plan in planned for spec in plan.codec.messages}
    for spec in (*codec.messages, *theirs.values()):
        used = spec.node in native or spec.name in ours or spec.key in theirs
        if spec.cycle_ns and used:
            busy += frame_seconds(spec, bus.bitrate, bus.data_bitrate) * 1e9 / spec.cycle_ns
    theirs_hz = 1e3 / (config.canopen.heartbeat_ms or 100)
    heartbeats = (47 + 8 + (33 + 8) // 4) / bus.bitrate * (10 + theirs_hz * len(config.nodes))
    return 100.0 * (busy + heartbeats)


def _tell_loads(codec: Codec, config: Config, frames: list[Frame]) -> None:
    """A line per kind of message: its share of the bus by the frames' own stuff bits."""
    bus = config.bus
    kinds: dict[str, list[float]] = {}
    bits: dict[str, list[int]] = {}
    for frame in frames:
        spec = codec.by_id.get(frame.can_id)
        name = "CANopen" if spec is None else _kind(spec)
        exact = bits_of(frame)
        kinds.setdefault(name, []).append(exact.seconds(bus.bitrate, bus.data_bitrate))
        bits.setdefault(name, []).append(exact.nominal + exact.data)
    total = 0.0
    for name in sorted(kinds, key=lambda name: -sum(kinds[name])):
        share = 100.0 * sum(kinds[name]) / MEASURE_S
        total += share
        each = bits[name]
        rate, mean = len(each) / MEASURE_S, sum(each) / len(each)
        print(
            f"  {name:<24} {rate:7.0f} frames/s of {mean:5.1f} bits "
            f"({min(each)} to {max(each)}): {share:5.1f} %"
        )
    what = f"by every stuff bit of {MEASURE_S:g} s of simulated drives"
    print(f"  {'together':<24} {total:5.1f} % {what}")


def _kind(spec: MessageSpec) -> str:
    return f"Drive{{n}}_{spec.kind}" if spec.node else spec.name


def _tell_timing(times_us: list[float], period_us: float) -> None:
    ordered = sorted(times_us)
    p50, p99 = (ordered[int(len(ordered) * q)] for q in (0.5, 0.99))
    print(
        f"timing         a tick takes {p50:.0f} us of {period_us:.0f} us "
        f"({100 * p50 / period_us:.0f} %), p99 {p99:.0f} us, longest {ordered[-1]:.0f} us, here"
    )


def measure(config: Config, codec: Codec) -> tuple[list[Frame], list[float]]:
    """Two seconds with simulated drives: all frames of the bus, and each tick's time, us."""
    from gateway.core.gateway import Gateway
    from gateway.io.canopen_node import CanopenNode
    from sim.scenario import parse
    from sim.simulation import Simulation

    scenario = parse({"title": "timing", "seed": 1, "duration_s": 3.0,
                      "drives": len(config.nodes)}, "timing")  # fmt: skip
    simulation = Simulation(scenario, codec, nodes=config.nodes, self_start=True)
    gateway, node = Gateway(config, codec, 0), CanopenNode(config.nodes)
    period = config.loop.period_ns
    settling = round(SETTLE_S * config.loop.rate_hz)
    ticks = settling + round(MEASURE_S * config.loop.rate_hz)
    batches = [simulation.step((), k * period) for k in range(ticks)]
    frames: list[Frame] = []
    times = []
    for k, came in enumerate(batches):
        began = time.perf_counter_ns()
        out = gateway.step(came, k * period)
        took = time.perf_counter_ns() - began
        out += node.step(came, k * period)
        if k >= settling:
            frames += [*came, *out]
            times.append(took / 1e3)
    return frames, times
