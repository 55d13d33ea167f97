"""Compile before the first tick: a compiler that starts inside the loop costs seconds."""

from __future__ import annotations

import numpy as np

from dbc.codec import Codec
from dbc.e2e import protect
from dbc.frame import MS, Frame
from estimators.detect import Evidence
from gateway.config import Config
from gateway.core import Gateway

WARMED = ("PhaseCurrents", "StatorVoltages", "Samples", "Temperatures", "Motion", "Status")


def warm_up(config: Config, codec: Codec) -> None:
    """Run a throw-away gateway over a few made-up frames, so that every kernel is loaded.

    The frames say standstill at zero current; what the throw-away gateway thinks is dropped.
    """
    # What comes of a translator is of the same types.
    gateway = Gateway(config.unmapped(), codec, 0)
    specs = [spec for spec in codec.messages if spec.node in config.nodes and spec.kind in WARMED]
    for tick in range(3):
        now = tick * config.loop.period_ns
        frames = []
        for spec in specs:
            values: dict[str, float | int | None] = {
                signal.name: 0.0
                for signal in spec.signals
                if signal.name not in ("Crc", "Counter", "Quality")
            }
            values["Quality"] = 1
            if "SampleIndex" in values:
                values["SampleIndex"] = 8 * tick
            payload = codec.encode(spec, values)
            protect(spec, payload, tick)
            frames.append(Frame(max(0, now - MS), spec.can_id, bytes(payload), 8 * spec.is_fd))
        gateway.step(frames, now)
    gateway.step([], now)
    # At standstill nobody is tracked, so this would be met first in the middle of a run.
    n = max(2, len(config.nodes))
    gateway.adhesion.detector(
        Evidence(np.full(n, 0.5), np.full(n, 0.02), np.ones(n, dtype=np.bool_))
    )
