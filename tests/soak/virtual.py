"""Soaks of the core in virtual time: an hour of full traffic, thirty days of slow messages.

Both play a recorded hour or loop again and again; counters go on where it is joined.
"""

from collections import Counter
from functools import cache
from typing import Final, NamedTuple

from dbc.codec import bind
from dbc.frame import SECOND
from dbc.frames import block_of
from gateway.core.gateway import Gateway
from gateway.settings.config import parse
from sim.scenario import parse as parse_scenario
from sim.simulation import Simulation
from tests.dbc_text import with_cycles
from tests.simrun import CLASSIC
from tests.soak.books import Books, unaccounted
from tests.storm.campaign import CALIBRATION
from tests.storm.train import NODES, TICK, train

HOUR: Final = 3600
SLOW_KINDS: Final = ("Motion", "Status", "Temperatures")


class Soaked(NamedTuple):
    """What a soak came to."""

    books: Books
    counts: Counter[str]
    said: Counter[str]
    """Drives' flags, by tick."""
    ticks: int

    def summary(self):
        """As JSON."""
        return {
            **self.books.summary(),
            "ticks": self.ticks,
            "counts": dict(sorted((+self.counts).items())),
            "unaccounted": unaccounted(self.counts),
            "said": dict(sorted(self.said.items())),
        }


def soak(core, codec, came, ticks, tick_ns, every):
    """Step so many ticks; read memory and descriptors every so many."""
    books, said = Books(codec), Counter[str]()
    for tick in range(1, ticks + 1):
        books.count(core.step(came(tick), tick * tick_ns))
        _listen(core.view, said)
        if tick % every == 0:
            books.read(tick * tick_ns / SECOND / HOUR)
    return Soaked(books, core.inbox.counts, said, ticks)


def _listen(view, said):
    assert view is not None
    for drive in view.drives:
        said[f"adhesion {drive.adhesion.name}"] += 1
        said[f"thermal {drive.thermal.name}"] += 1


def full_traffic(seconds, every_s=60):
    """Three drives with everything they send: the train of the storm in fair weather."""
    honest = train()
    config = parse({"thermal": {"calibration": str(CALIBRATION)}})
    core = Gateway(config, honest.codec, 0)
    return soak(core, honest.codec, honest.sent, seconds * 100, TICK, every_s * 100)


def slow_dbc(folder):
    """The message set with a second between slow messages: what a long record holds."""
    by_name = bind(CLASSIC, NODES).by_name
    slow = [by_name[f"Drive{node}_{kind}"].can_id for node in NODES for kind in SLOW_KINDS]
    return with_cycles(CLASSIC, folder / "slow.dbc", dict.fromkeys(slow, 1000))


@cache
def slow_round(path, span_s):
    """The second of two rounds alike, by the second: the first brings motors to their warmth."""
    codec = bind(path, NODES)
    duty = [(0.0, 60.0), (0.25, 140.0), (0.27, 140.0), (0.58, 80.0), (0.6, 80.0), (0.97, 60.0)]
    pull = [(0.0, 8.0), (0.17, 20.0), (0.42, 6.0), (0.67, 14.0), (0.92, 8.0)]
    rounds = (0.0, 1.0)
    simulation = Simulation(
        parse_scenario({
            "title": "soak", "seed": 11, "duration_s": 2 * span_s, "nodes": list(NODES),
            "traffic": "slow",
            "motion": {"profile": [[(t + r) * span_s, w] for r in rounds for t, w in duty]},
            "load": {"kind": "preset", "smooth_s": 2.0,
                     "profile": [[(t + r) * span_s, nm] for r in rounds for t, nm in pull]},
        }),
        codec,
    )  # fmt: skip
    frames = [block_of(simulation.step((), k * SECOND)) for k in range(1, 2 * span_s + 1)]
    return codec, [b._replace(t_ns=b.t_ns - span_s * SECOND) for b in frames[span_s:]]


def slow_messages(readings, path, span_s=HOUR, every_s=HOUR):
    """Motion, Status and Temperatures once a second, and a step of the core as often.

    The gateway itself steps a hundred times as often, mostly with nothing to do: thirty days of
    that are eleven hours of a core here, and not what is looked for, which is what adds up.
    readings: of memory and descriptors, one every so many seconds.
    span_s: length of the record that is played again and again; a multiple of 16.
    """
    codec, recorded = slow_round(path, span_s)
    config = parse({"dbc": {"file": str(path)}, "thermal": {"calibration": str(CALIBRATION)}})

    def came(tick):
        turn, k = divmod(tick - 1, span_s)
        block = recorded[k]
        return block._replace(t_ns=block.t_ns + turn * span_s * SECOND)

    core = Gateway(config, codec, 0)
    return soak(core, codec, came, readings * every_s, SECOND, every_s)
