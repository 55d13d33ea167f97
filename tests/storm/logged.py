"""A storm as a candump log: what arrives at the gateway, as a recorder would write it."""

from contextlib import suppress

from dbc.candump.writer import Writer
from tests.storm.bus_faults import HostileBus
from tests.storm.campaign import faults_of, first_of, train_of
from tests.storm.train import NODES, TICK
from tests.storm.value_faults import ValueFaults


def write_storm(path, seed, ticks):
    """So many ticks of a seed, without what no line of candump's can say."""
    honest, first = train_of(seed), first_of(seed)
    drives = [spec for spec in honest.codec.messages if not spec.is_gateway]
    ids = [[s.can_id for s in drives if s.name.startswith(f"Drive{n}_")] for n in NODES]
    bus = HostileBus(faults_of(seed, ticks), ids, seed, ValueFaults(honest.codec, NODES))
    with Writer(path) as writer:
        for tick in range(first, first + ticks):

            def elsewhere(tick=tick):
                return honest.elsewhere(tick)

            came = bus.carry(honest.sent(tick), elsewhere, tick, tick * TICK)
            for frame in came.block.frames():
                with suppress(ValueError):
                    writer.write(frame._replace(channel="can0"))
