"""A bus with drives and a gateway on it, recorded, for the tests of the monitor."""

from functools import cache
from typing import NamedTuple

from dbc.frame import Frame
from gateway.core.gateway import Gateway
from gateway.core.view import GatewayView
from gateway.hil.bench import run_virtual
from gateway.monitor.model.observer import Observer
from gateway.settings.config import Config, parse
from sim.scenario import parse as scenario
from tests.simrun import by_tick, codec

TICK = 10_000_000
SECONDS = 3.0


class Run(NamedTuple):
    """drives, gateway: who sent it; views: what the gateway thought at each tick."""

    config: Config
    drives: list[Frame]
    gateway: list[Frame]
    views: list[GatewayView]

    @property
    def frames(self):
        return sorted(self.drives + self.gateway, key=lambda f: f.t_ns)

    def observer(self, **options):
        return Observer(codec(), self.config, **options)


def config_of(nodes=(1, 2, 3), **more):
    return parse({"drive": [{"node": n} for n in nodes], **more})


@cache
def recorded():
    """Three drives, of which the second loses adhesion from 1.2 s to 2.0 s; from 0 to 3 s."""
    world = scenario(
        {
            "title": "one loss", "seed": 5, "duration_s": SECONDS, "drives": 3,
            "event": [{"at_s": 1.2, "for_s": 0.8, "drive": 2, "kind": "adhesion_loss",
                       "depth": 1.0}],
        }
    )  # fmt: skip
    config = config_of()
    drives, own, views = [], [], []

    def watch(_now, received, sent, gateway):
        drives.extend(received)
        own.extend(sent)
        views.append(gateway.view)

    run_virtual(world, config, codec(), [watch])
    return Run(config, drives, own, views)


def play(observer, frames, until_ns=None, step_ns=7_000_000):
    """Give all frames in cuts of `step_ns`; the snapshot at the end."""
    frames = list(frames)
    end = max(f.t_ns for f in frames) if until_ns is None else until_ns
    for now, part in by_tick(frames, (*range(step_ns, end, step_ns), end)):
        observer.add_frames(part, now)
    return observer.snapshot(end)


def shadow_views(run):
    """What a gateway of its own makes of the drives' frames, tick by tick as replay does."""
    stamps = [f.t_ns for f in run.drives]
    gateway, views = Gateway(run.config, codec(), min(stamps)), []
    for now, frames in by_tick(run.drives, range(min(stamps), max(stamps) + TICK, TICK)):
        gateway.step(frames, now)
        views.append(gateway.view)
    return views
