"""The configuration that a scenario needs: its drives and motors."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import TYPE_CHECKING

from gateway.io.console import console
from gateway.io.prepare import bound, prepare
from gateway.settings.config import Config, ConfigError

if TYPE_CHECKING:
    from dbc.codec import Codec
    from sim.scenario import Scenario


def scenario_thermal() -> dict[str, str]:
    """The calibration of the simulated bench motors that ships with the package."""
    import gateway

    return {"calibration": str(Path(gateway.__path__[0]) / "bench_calibration.toml")}


def fitting(
    path: Path | None, scenario: Scenario, signature: argparse.Namespace | None = None
) -> tuple[Config, Codec]:
    """The configuration in a file, or without one that for the scenario's drives and motors.

    signature: see `prepare`. Raises InputError with every problem.
    """
    from gateway.settings.sections import Drive

    if path is not None:
        config, codec = prepare(path, signature=signature)
        _check_drives(str(path), config, scenario)
        return config, codec
    config, _ = prepare(None, signature=signature, thermal=scenario_thermal())
    name = scenario.motor.name
    motor = name if name in config.motors else "bench"
    drives = tuple(Drive(node=n, motor=motor) for n in scenario.nodes)
    config = config.model_copy(update={"drive": drives})
    return config, bound(config)


def _check_drives(source: str, config: Config, scenario: Scenario) -> None:
    """Raise ConfigError if the configuration's drives cannot be simulated by the scenario."""
    nodes = ", ".join(map(str, config.nodes))
    if config.unmapped() is not config:
        problem = "drive.signals: simulated drives send only this project's message set"
        cure = "remove the signals to test the rest, or replay a log of such an inverter"
        raise ConfigError(source, [f"{problem}; {cure}"])
    if len(config.nodes) < scenario.drives:
        problem = f"the scenario has {scenario.drives} drives, [[drive]] names"
        cure = "add the others, or set `drives` in the scenario"
        raise ConfigError(source, [f"{problem} {len(config.nodes)}: {cure}"])
    if scenario.names_nodes and not set(scenario.nodes) <= set(config.nodes):
        own = ", ".join(map(str, scenario.nodes))
        problem = f"the scenario has nodes {own}, [[drive]] names {nodes}"
        raise ConfigError(source, [f"{problem}: change one of them"])
    if len(config.nodes) > scenario.drives:
        console().print(
            f"note: the scenario has {scenario.drives} drives, the configuration "
            f"{len(config.nodes)}", markup=False,
        )  # fmt: skip


def fitted(
    path: Path | None, scenario: Scenario, signature: argparse.Namespace | None = None
) -> tuple[Scenario, Config, Codec]:
    """As `fitting`, with the scenario; with a file, its drives have that one's nodes and motor."""
    config, codec = fitting(path, scenario, signature)
    if path is not None:
        from gateway.hil.own_motor import with_motor_of, with_nodes_of

        scenario = with_motor_of(config, with_nodes_of(config, scenario))
    return scenario, config, codec
