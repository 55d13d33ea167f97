"""The worlds in which detectors of adhesion are judged, by name.

Detectors are tuned on `ours` alone. `ours_held` has the kinds of `held` on the machines of `ours`.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Final, NamedTuple

from dbc.codec import Codec
from dbc.frames import Block
from gateway.study import held_world, motulator_world, roller_world, scenarios_family
from gateway.study.held_world import OtherMachine, without_status
from sim.scenario import Scenario
from sim.simulation import Simulation


class Family(NamedTuple):
    """Runs of one kind.

    common: all drives lose adhesion together; motor: None for any; commands: `Status` is on the
    bus; varied: motor and bus are those of `varied_trains`.
    """

    common: bool = False
    motor: str | None = None
    commands: bool = True
    varied: bool = False

    def received(self, block: Block) -> Block:
        """Frames of a block that are on the bus; `Variation.received` removes more if `varied`."""
        return block if self.commands else without_status(block)


class World(NamedTuple):
    """Source of runs.

    usual: families that are evaluated unless others are named; draw: return a family's run for a
    seed and a motor; simulate: return the simulation of a family's run.
    """

    families: Mapping[str, Family]
    usual: tuple[str, ...]
    groups: Mapping[str, tuple[str, ...]]
    draw: Callable[[str, int, str], Scenario]
    simulate: Callable[[str, Scenario, Codec], Simulation]


def _ours(_family: str, scenario: Scenario, codec: Codec) -> Simulation:
    return Simulation(scenario, codec, self_start=True)


def _held(_family: str, scenario: Scenario, codec: Codec) -> Simulation:
    return OtherMachine(scenario, codec, held_world.waveforms(scenario))


_HELD_KINDS: Final = {
    k: Family(f.lost is None, None, f.commands) for k, f in held_world.KINDS.items()
}
WORLDS: Final = {
    "ours": World(
        {k: Family(f.common, f.motor) for k, f in scenarios_family.ALL.items()},
        tuple(scenarios_family.FAMILIES),
        {name: tuple(group) for name, group in scenarios_family.GROUPS.items()},
        scenarios_family.draw, _ours,
    ),
    "ours_held": World(_HELD_KINDS, tuple(_HELD_KINDS), {}, held_world.draw, _ours),
    "held": World(_HELD_KINDS, tuple(_HELD_KINDS), {}, held_world.draw, _held),
    "motulator": World(
        _HELD_KINDS, tuple(_HELD_KINDS), {}, held_world.draw, motulator_world.simulate
    ),
    "roller": World(
        {k: Family(False, None, f.commands, f.varied) for k, f in roller_world.KINDS.items()},
        tuple(roller_world.KINDS), {}, roller_world.draw, roller_world.Roller,
    ),
}  # fmt: skip
