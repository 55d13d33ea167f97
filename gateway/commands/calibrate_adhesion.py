"""`calibrate --adhesion LOG..`: how long evidence of a loss lasts in fault-free logs."""

from __future__ import annotations

import argparse

from gateway.commands.common import GOOD
from gateway.commands.progress import track_file
from gateway.io.console import note
from gateway.io.prepare import prepare


def run(options: argparse.Namespace) -> int:
    """Print `fault_free` for `[adhesion]`, and what it promises.

    Raises ConfigError if the logs have no whole minute.
    """
    from gateway.core.gateway import Gateway
    from gateway.io.replay import Briefly, OneChannel, open_log, replay
    from gateway.settings.config import ConfigError
    from gateway.settings.sections import Adhesion
    from gateway.study.fault_free import Evidence, at_once, largest

    given, codec = prepare(options.config)
    config, evidence = at_once(given), Evidence()

    def gateway(start: int) -> Gateway:
        evidence.begin_log(start)
        return Gateway(config, codec, start)

    for log in options.log:
        tracked = track_file(open_log(log, strict=False), log, log.name)
        frames = OneChannel(tracked, options.log_channel)
        sink = Briefly(lambda _frames: None, evidence.follow_flags)
        done = replay(frames, gateway, config.loop.period_ns, sink)
        evidence.end_log(done.gateway.now_ns)
    longest = evidence.longest_ms
    if not len(longest):
        raise ConfigError("calibrate --adhesion", ["the logs have less than a minute together"])
    times = largest(longest)
    print(f"fault_free = {{ minutes = {len(longest)}, longest_ms = {times} }}")
    rate = given.adhesion.false_alarms_per_1000_h
    if rate is None:
        note("put this line into [adhesion], and state false_alarms_per_1000_h")
        return GOOD
    measured = {"minutes": len(longest), "longest_ms": times}
    stated = Adhesion.model_validate({"false_alarms_per_1000_h": rate, "fault_free": measured})
    note(f"adhesion: {stated.promise}")
    return GOOD
