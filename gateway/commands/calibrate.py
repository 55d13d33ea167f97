"""`calibrate LOG..`: thermal limits from fault-free logs, or times of the adhesion flag."""

from __future__ import annotations

import argparse
from collections import Counter
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import TYPE_CHECKING

from gateway.commands.common import add_config, faults, shown, verdict_of_input
from gateway.commands.progress import Progress, track_file
from gateway.io.console import note
from gateway.io.prepare import prepare
from gateway.settings.config import ConfigError

if TYPE_CHECKING:
    from dbc.codec import Codec
    from dbc.frames import Block
    from gateway.io.replay import Replayed
    from gateway.settings.config import Config
    from gateway.study.calibrating import Learner

WITHOUT = "nothing was written; for [thermal] method = 'maisd' run again with --without-model"
MARGIN = 1.5
"""Factor from the largest value of a fault-free run to the limit."""


def arguments(parser: argparse.ArgumentParser) -> None:
    """Options of the verb."""
    parser.add_argument("log", type=Path, nargs="+", help="fault-free logs")
    add_config(parser)
    to = parser.add_mutually_exclusive_group(required=True)
    to.add_argument("-o", "--output", type=Path, metavar="FILE.toml",
                    help="the calibration to write")  # fmt: skip
    to.add_argument("--adhesion", action="store_true",
                    help="no thermal calibration: print the key fault_free of [adhesion], "
                    "which its false_alarms_per_1000_h needs")  # fmt: skip
    parser.add_argument("--without-model", action="store_true",
                        help="learn only the differences between motors, for [thermal] method = "
                        "'maisd'; else logs that give no thermal model are refused")  # fmt: skip
    parser.add_argument("--pictures", type=Path, metavar="FOLDER", help="pictures of measured and "
                        "modelled temperatures, one per motor")  # fmt: skip
    parser.add_argument("--log-channel", metavar="NAME", help="channel, if a log has several")


def run(options: argparse.Namespace) -> int:
    """Read the temperatures through the gateway's own inbox and write the calibration.

    Exit 1 if more than 1 % of the logs was dropped.
    Raises ConfigError, and writes nothing, if the logs do not contain what the method needs.
    """
    if options.adhesion:
        return _adhesion(options)
    from gateway.core.thermal import NO_MODEL
    from gateway.io.extras import pictures
    from gateway.io.whole_file import refuse_unwritable, write_text
    from gateway.settings.calibration import promise_lines, to_toml
    from gateway.study import calibration_fit
    from gateway.study.calibrating import Learner

    if options.pictures is not None:
        pictures("--pictures")
    refuse_unwritable(options.output)
    config, codec = prepare(options.config)
    # An earlier calibration must not affect this one.
    thermal = config.thermal.model_copy(update={"calibration": None})
    config = config.model_copy(update={"thermal": thermal})
    rate = config.thermal.false_alarms_per_1000_h
    learner = Learner(config.nodes, config.thermal.window_s, promises=rate is not None)
    dropped, used = _each_log(options, lambda blocks: _learn(blocks, config, codec, learner))
    with Progress("limits and thermal models"):
        result = learner.finish(MARGIN)
    if result.heat is None and config.thermal.method == "model" and not options.without_model:
        raise ConfigError("calibrate", [*learner.lacks(), NO_MODEL, WITHOUT])
    promised = promise_lines(result if rate is None else result.promising(rate))
    path = options.output
    write_text(path, to_toml(result))
    limits = ", ".join(f"{v:.2f}" for v in result.maisd_limit_k)
    model = "thermal models learnt" if result.heat else NO_MODEL
    motors = len(config.nodes)
    seen = f"{learner.samples} samples of {motors} motors"
    print(f"{shown(path)}: {seen}; MAISD limits {limits} K; {model}")
    lacks = [] if result.heat else [f"no thermal model because {line}" for line in learner.lacks()]
    for line in (*lacks, *learner.notes, *promised):
        print(line)
    for line in learner.too_little():
        note(f"warning: {line}")
    if learner.fits:
        print("\n".join(calibration_fit.lines(learner.fits)))
        if learner.coverage is not None:
            print("\n".join(calibration_fit.filter_lines(learner.coverage, learner.nodes)))
        if options.pictures is not None:
            calibration_fit.draw(options.pictures, learner.fits)
    return verdict_of_input(dropped, used)


def _each_log(
    options: argparse.Namespace, read: Callable[[Iterable[Block]], Replayed]
) -> tuple[Counter[str], int]:
    """Read every log; return how many frames were left out, by cause, and how many were used."""
    from gateway.io.log_file import BadLogError, OneChannel, open_log

    dropped: Counter[str] = Counter()
    used = 0
    for log in options.log:
        opened = open_log(log, strict=False)
        try:
            done = read(OneChannel(track_file(opened, log, log.name), options.log_channel))
        except BadLogError as error:
            text = str(error)
            raise BadLogError(text if str(log) in text else f"{log}: {text}") from None
        dropped.update(time_back=done.dropped, **faults(opened.reader))
        used += done.frames - done.dropped
    return dropped, used


def _learn(blocks: Iterable[Block], config: Config, codec: Codec, learner: Learner) -> Replayed:
    """Feed one log's temperatures, as the gateway receives them, into the learner."""
    from gateway.core.gateway import Gateway
    from gateway.io.replay import Briefly, replay
    from gateway.study.temperature_reader import TemperatureReader

    def pass_on(gateway: Gateway) -> None:
        assert isinstance(gateway, TemperatureReader)
        thermal = gateway.thermal
        learner.learn(gateway.log.drain(), thermal.sensors.configured, thermal.dt_s)

    def new_gateway(start: int) -> TemperatureReader:
        return TemperatureReader(config, codec, start)

    learner.begin()
    done = replay(
        blocks, new_gateway, config.loop.period_ns, Briefly(lambda _frames: None, pass_on)
    )
    pass_on(done.gateway)
    return done


def _adhesion(options: argparse.Namespace) -> int:
    """Print `fault_free` for `[adhesion]`, and what it promises.

    Raises ConfigError if the logs have no whole minute.
    """
    from gateway.core.gateway import Gateway
    from gateway.io.replay import Briefly, replay
    from gateway.settings.sections import Adhesion
    from gateway.study.fault_free import Evidence, at_once, largest

    given, codec = prepare(options.config)
    config, evidence = at_once(given), Evidence()

    def gateway(start: int) -> Gateway:
        evidence.begin_log(start)
        return Gateway(config, codec, start)

    def follow(blocks: Iterable[Block]) -> Replayed:
        sink = Briefly(lambda _frames: None, evidence.follow_flags)
        done = replay(blocks, gateway, config.loop.period_ns, sink)
        evidence.end_log(done.gateway.now_ns)
        return done

    dropped, used = _each_log(options, follow)
    longest = evidence.longest_ms
    if not len(longest):
        raise ConfigError("calibrate --adhesion", ["the logs have less than a minute together"])
    times = largest(longest)
    print(f"fault_free = {{ minutes = {len(longest)}, longest_ms = {times} }}")
    rate = given.adhesion.false_alarms_per_1000_h
    if rate is None:
        note("put this line into [adhesion], and state false_alarms_per_1000_h")
        return verdict_of_input(dropped, used)
    measured = {"minutes": len(longest), "longest_ms": times}
    stated = Adhesion.model_validate({"false_alarms_per_1000_h": rate, "fault_free": measured})
    note(f"adhesion: {stated.promise}")
    return verdict_of_input(dropped, used)
