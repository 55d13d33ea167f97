"""A scenario with the configuration's nodes and motor: simulation and filters use the same."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import tomli_w

from gateway.settings.config import Config, ConfigError
from gateway.settings.motors import BENCH_MOTOR, Motor
from sim.physics.plant import MOTORS
from sim.scenario import Scenario, parse


def with_motor_of(config: Config, scenario: Scenario) -> Scenario:
    """The scenario with the configuration's motor, unless it names one itself.

    A scenario's loads are made for the bench motor: they are scaled by rated torque, currents by
    rated current; speeds stay as they are. Raises ConfigError if the drives' motors differ.
    """
    names = sorted({drive.motor for drive in config.drive})
    motors = {config.motors[name] for name in names}
    if "motor" in scenario.model_fields_set or motors == {BENCH_MOTOR}:
        return scenario
    if len(motors) > 1:
        problem = f"drives have the motors {', '.join(names)}; simulated drives share one motor"
        raise ConfigError(
            "motor", [problem, "name it, or its parameters, in the scenario's [motor]"]
        )
    (motor,) = motors
    table = _table(scenario)
    if names[0] in MOTORS and motor == Config().motors.get(names[0]):
        table["motor"] = {"name": names[0]}
    else:
        table["motor"] = {**motor.model_dump(), "U_dc": _link_v(motor, scenario)}
    _scale(table, scenario, motor)
    return parse(table, scenario.title)


def with_nodes_of(config: Config, scenario: Scenario) -> Scenario:
    """The scenario with the configuration's first nodes, unless it names nodes itself.

    Raises ScenarioError if it then names a drive that does not exist.
    """
    nodes = list(config.nodes[: scenario.drives])
    if scenario.names_nodes or nodes == scenario.nodes:
        return scenario
    return parse({**_table(scenario), "nodes": nodes}, scenario.title)


def save_scenario(scenario: Scenario, path: Path) -> None:
    """Write a scenario file. Raises OSError."""
    path.write_text(tomli_w.dumps(_table(scenario)), encoding="utf-8")


def _table(scenario: Scenario) -> dict[str, Any]:
    table: dict[str, Any] = scenario.model_dump(
        mode="json", by_alias=True, exclude_unset=True, exclude_none=True
    )
    return table


def _link_v(motor: Motor, scenario: Scenario) -> float:
    """DC link voltage, V: enough for the fastest speed at 1.5 times the rated current."""
    motion = scenario.motion
    fastest = max(abs(speed) for _, speed in motion.profile or [(0.0, motion.speed)])
    if motion.unit == "rpm":
        fastest *= math.pi / 30.0 * motor.pole_pairs
    return max(2.0 * motor.voltage(fastest, 1.5 * motor.I_rated), 24.0)


def _scale(table: dict[str, Any], scenario: Scenario, motor: Motor) -> None:
    """Scale loads by rated torque, and sensor currents by rated current."""
    torque = motor.T_rated / BENCH_MOTOR.T_rated
    current = motor.I_rated / BENCH_MOTOR.I_rated
    load, sensors = table.setdefault("load", {}), table.setdefault("sensors", {})
    load["torque_nm"] = scenario.load.torque_nm * torque
    if scenario.load.profile:
        load["profile"] = [[t_s, nm * torque] for t_s, nm in scenario.load.profile]
    for one in load.get("disturbance", ()):
        one["amplitude_nm"] *= torque
    if scenario.motion.effort_nm is not None:
        table["motion"]["effort_nm"] *= torque
    for event in table.get("event", ()):
        if event["kind"] == "friction_brake" and "value" in event:
            event["value"] *= torque
    of_sensors = scenario.sensors
    sensors["current_noise_var"] = of_sensors.current_noise_var * current**2
    sensors["current_range_a"] = of_sensors.current_range_a * max(current, 1.0)
    sensors["current_offset_a"] = of_sensors.current_offset_a * current
    sensors["current_offset_within_a"] = of_sensors.current_offset_within_a * current
