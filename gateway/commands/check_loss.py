"""`check`: a synthetic loss of adhesion, detected with the configuration."""

from __future__ import annotations

from typing import NamedTuple

from dbc.codec import Codec
from gateway.hil.measured import Measured
from gateway.hil.synthetic_loss import DEPTH, WITHIN_NS, Found, losses, never
from gateway.mapping import plan as foreign
from gateway.settings.config import Config


class Tried(NamedTuple):
    """Results: `blind`: nodes always Unknown, and why; problem: why the rest was not simulated."""

    blind: dict[int, str]
    found: list[Found]
    problem: str


def attempt(config: Config, codec: Codec, measured: Measured | None = None) -> Tried:
    """Simulate the losses; the first one fills `measured`. Raises ConfigError as `Gateway` does."""
    blind = never(config, foreign.fitted(codec, foreign.plans(config)))
    found: list[Found] = []
    try:
        found.extend(losses(config, codec, measured))
    except ValueError as error:
        return Tried(blind, found, f"these messages cannot be simulated: {error}")
    return Tried(blind, found, "")


def print_results(config: Config, tried: Tried) -> list[str]:
    """Print a line per loss; return the problems: losses that are not or cannot be found."""
    for node, why in tried.blind.items():
        if node not in _mapped(config):  # the reason of mapped drives is printed above
            _line(f"drive {node} is always Unknown: {why}")
    if len(tried.blind) == len(config.nodes):
        _line("not simulated: every drive is always Unknown")
        no_flag = "no adhesion flag from this inverter"
        return [f"drive {node}: {no_flag}: {why}" for node, why in tried.blind.items()]
    problems = []
    what = f"A loss of {100 * DEPTH:.0f} % on drive"
    for found in tried.found:
        if found.after_ms is not None:
            _line(f"{what} {found.node} is found after {found.after_ms:.0f} ms.")
            continue
        _line(f"{what} {found.node} is not found within {WITHIN_NS / 1e9:g} s.")
        problems.append(f"drive {found.node}: {found.problem}{_motor(config, found.node)}")
    if tried.problem:
        _line(f"not tried: {tried.problem}")
    return problems


def _motor(config: Config, node: int) -> str:
    """Cure for a mapped drive that has a motor of this project instead of its own."""
    (name,) = (drive.motor for drive in config.drive if drive.node == node)
    if node not in _mapped(config) or name in config.motor:
        return ""
    return f"; it has motor {name} of this project: put the data of its own motor into [motor.NAME]"


def _mapped(config: Config) -> set[int]:
    return {drive.node for drive in config.drive if drive.signals is not None}


def _line(text: str) -> None:
    print(f"{'adhesion':<14} {text}")
