"""Running scenarios, and a gateway reduced to the flags it sends, for tests of the simulator."""

from bisect import bisect_right
from functools import cache
from operator import attrgetter
from pathlib import Path

import numpy as np

import dbc
from dbc.candump.writer import Writer
from dbc.codec import bind
from dbc.e2e import protect
from dbc.frame import Frame
from gateway.core.gateway import Gateway
from gateway.settings.config import parse as parse_config
from sim.scenario import parse
from sim.simulation import Simulation

CLASSIC = Path(dbc.__path__[0]) / "traction.dbc"
FD_FILE = Path(dbc.__path__[0]) / "traction_fd.dbc"
TICK = 10_000_000


@cache
def codec(nodes=(1, 2, 3), path=CLASSIC):
    return bind(path, nodes)


def scenario(**table):
    return parse({"title": "test", "duration_s": 5.0, **table})


def run(simulation, seconds, tick=TICK):
    out = []
    for k in range(1, round(seconds * 1e9) // tick + 1):
        out += simulation.step((), k * tick)
    return out


def log_of(path, frames, channel="can0"):
    """A log of these frames in order of time."""
    with Writer(path, channel) as writer:
        for frame in sorted(frames, key=attrgetter("t_ns")):
            writer.write(frame)
    return path


def by_tick(frames, times):
    """(time, frames until then that came after the time before) of each of these times."""
    frames, k = sorted(frames, key=attrgetter("t_ns")), 0
    for now in times:
        first, k = k, bisect_right(frames, now, k, key=attrgetter("t_ns"))
        yield now, frames[first:k]


def values(frames, name, codec_=None):
    """Decoded values of one message, with `t_s`, in order."""
    c = codec_ or codec()
    spec = c.by_name[name]
    rows = []
    for f in frames:
        if f.can_id == spec.can_id:
            row = {k: r.value for k, r in c.decode(spec, f.data).items()}
            rows.append({"t_s": f.t_ns * 1e-9, **row})
    return rows


class Flags:
    """`Gateway_Adhesion` frames as a gateway sends them."""

    def __init__(self):
        self.spec = codec().by_name["Gateway_Adhesion"]
        self.counter = 0

    def frame(self, t_ns, **states):
        """States by name as raw numbers; 3, which no gateway sends, is possible here."""
        payload = codec().encode(self.spec, {})
        for name, state in states.items():
            start = self.spec.signals[self.spec.column(name)].start
            payload[start >> 3] |= state << (start & 7)
        protect(self.spec, payload, self.counter)
        self.counter += 1
        return Frame(t_ns, self.spec.can_id, bytes(payload))


def flags_and_speeds(simulated, coded, through=lambda frames, now: frames, **config):
    """Adhesion flags and true rotor speeds of a scenario, both (ticks, N).

    through: which frames of those sent until a tick, and earlier, arrive in it.
    """
    nodes = simulated.nodes
    simulation = Simulation(simulated, coded)
    drives = {"drive": [{"node": node} for node in nodes]}
    core = Gateway(parse_config({"dbc": {"file": str(coded.path)}, **drives, **config}), coded, 0)
    flags = []
    for k in range(1, round(simulated.duration_s * 100) + 1):
        core.step(through(simulation.step((), k * TICK), k * TICK), k * TICK)
        flags.append([drive.adhesion for drive in core.view.drives])
    speeds = np.reshape([row.speed_rad_s for row in simulation.truth_rows()], (-1, len(nodes)))
    return np.array(flags), np.abs(speeds[: len(flags)])
