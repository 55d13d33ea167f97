"""`check CONFIG`: everything that can be known before the first run."""

from __future__ import annotations

import argparse
import time
from pathlib import Path
from typing import TYPE_CHECKING

from gateway.commands.common import BAD_INPUT, GOOD, console, prepare

if TYPE_CHECKING:
    from dbc.codec import Codec, MessageSpec
    from gateway.config import Config

HELP = "configuration against DBC, bus load and timing budget"
LOAD_LIMIT_PERCENT = 80.0
MEASURE_S = 1.0


def arguments(parser: argparse.ArgumentParser) -> None:
    """Options of the verb."""
    parser.add_argument("config", type=Path, help="the configuration to check")
    parser.add_argument("--no-timing", action="store_true", help="skip the self-measurement")


def run(options: argparse.Namespace) -> int:
    """Print what will be; exit 2 if it cannot work."""
    config, codec = prepare(options.config)
    print(f"configuration  good, hash {config.hash24():06x}")
    print(f"message set    {codec.path.name}: {len(codec.messages)} messages fit the contract")
    percent = bus_load(codec, config)
    verdict = "good" if percent <= LOAD_LIMIT_PERCENT else "too much"
    print(f"bus load       {percent:.0f} % with worst-case stuffing, {verdict}")
    period_us = config.loop.period_ns / 1e3
    if not options.no_timing:
        tick_us = measure_tick(config, codec)
        print(
            f"timing         a tick takes {tick_us:.0f} us of {period_us:.0f} us "
            f"({100 * tick_us / period_us:.0f} %) on this machine"
        )
    calibrated = (
        f"calibrated, method {config.thermal.method}"
        if config.calibration_path
        else "not calibrated: flags stay unknown"
    )
    print(f"thermal        {calibrated}")
    if config.calibration_path:
        from gateway import calibration

        calibration.load(config.calibration_path, config.nodes, config.thermal.window_s)
    if percent > LOAD_LIMIT_PERCENT:
        console().print(
            f"bus load {percent:.0f} % is above {LOAD_LIMIT_PERCENT:.0f} %: use slower cycles in "
            "the DBC (GenMsgCycleTime), fewer drives on this bus, or CAN FD", markup=False,
        )  # fmt: skip
        return BAD_INPUT
    return GOOD


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


def bus_load(codec: Codec, config: Config) -> float:
    """Percent of the bus that the configured drives and the gateway take."""
    from gateway.outbox import Outbox

    ours = set(Outbox(codec, config.nodes, 0, config.loop.period_ns).specs)
    bus = config.bus
    busy = 0.0
    for spec in codec.messages:
        if spec.cycle_ns and (spec.node in config.nodes or spec.name in ours):
            busy += frame_seconds(spec, bus.bitrate, bus.data_bitrate) * 1e9 / spec.cycle_ns
    heartbeats = (47 + 8 + (33 + 8) // 4) / bus.bitrate * 10 * (len(config.nodes) + 1)
    return 100.0 * (busy + heartbeats)


def measure_tick(config: Config, codec: Codec) -> float:
    """Median time of a full tick with simulated drives at the bus's own rates, us."""
    from gateway.core import Gateway
    from sim.scenario import parse
    from sim.simulation import Simulation

    scenario = parse({"title": "timing", "seed": 1, "duration_s": 2.0,
                      "drives": len(config.nodes)}, "timing")  # fmt: skip
    simulation = Simulation(scenario, codec, nodes=config.nodes, self_start=True)
    gateway = Gateway(config, codec, 0)
    ticks = round(MEASURE_S * config.loop.rate_hz)
    batches = [simulation.step((), k * config.loop.period_ns) for k in range(ticks)]
    times = []
    for k, frames in enumerate(batches):
        began = time.perf_counter_ns()
        gateway.step(frames, k * config.loop.period_ns)
        times.append(time.perf_counter_ns() - began)
    times.sort()
    return times[len(times) // 2] / 1e3
