"""`calibrate LOG..`: thermal limits from fault-free logs."""

from __future__ import annotations

import argparse
from pathlib import Path

from gateway.commands.common import GOOD, add_config, out_file, prepare, track_file

HELP = "thermal limits from fault-free logs"
MARGIN = 1.5
"""Limits stand this far above the largest value of a fault-free run."""


def arguments(parser: argparse.ArgumentParser) -> None:
    """Options of the verb."""
    parser.add_argument("log", type=Path, nargs="+", help="fault-free logs")
    add_config(parser)
    parser.add_argument("-o", "--output", type=Path, required=True, metavar="FILE.toml")
    parser.add_argument("--log-channel", metavar="NAME", help="channel, if a log has several")


def run(options: argparse.Namespace) -> int:
    """Read the temperatures through the gateway's own inbox and write the calibration."""
    from gateway.calibration import to_toml
    from gateway.core import Gateway
    from gateway.drivers.replay import open_log, pick_channel, replay
    from gateway.results.calibrating import Learner

    config, codec = prepare(options.config)
    learner = Learner(config.nodes, config.thermal.window_s)
    for log in options.log:
        reader = open_log(log, strict=False)
        frames = track_file(pick_channel(reader, options.log_channel), reader, log, log.name)
        made: list[Gateway] = []

        def make(start: int, made: list[Gateway] = made) -> Gateway:
            made.append(Gateway(config, codec, start))
            return made[0]

        learner.begin()
        replay(frames, make, config.loop.period_ns,
               lambda now, _out, _view, made=made: learner.take(made[0].thermal, now))  # fmt: skip
    result = learner.finish(MARGIN)
    path = out_file(options.output)
    assert path is not None
    path.write_text(to_toml(result), encoding="utf-8")
    limits = ", ".join(f"{v:.2f}" for v in result.maisd_limit_k)
    print(
        f"{path}: {learner.samples} samples of {len(config.nodes)} motors; MAISD limits {limits} K"
    )
    return GOOD
