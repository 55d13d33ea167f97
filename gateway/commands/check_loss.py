"""What `check` says of a synthetic loss of adhesion through the configuration."""

from __future__ import annotations

from typing import TYPE_CHECKING

from gateway.mapping import plan as foreign

if TYPE_CHECKING:
    from dbc.codec import Codec
    from gateway.settings.config import Config


def tell(config: Config, codec: Codec) -> list[str]:
    """Print a line per loss; gives what is wrong: losses that are not found, or cannot be.

    Raises ConfigError as `Gateway` does.
    """
    from gateway.hil.synthetic_loss import DEPTH, WITHIN_NS, losses, never

    blind = never(config, foreign.fitted(codec, foreign.plans(config)))
    for node, why in blind.items():
        if node not in _mapped(config):  # of those it is said above
            _line(f"drive {node} is always Unknown: {why}")
    if len(blind) == len(config.nodes):
        _line("not tried: no drive can ever be judged")
        return [f"drive {node}: {why}" for node, why in blind.items()]
    problems = []
    what = f"A loss of {100 * DEPTH:.0f} % on drive"
    try:
        for found in losses(config, codec):
            if found.after_ms is not None:
                _line(f"{what} {found.node} is found after {found.after_ms:.0f} ms.")
                continue
            _line(f"{what} {found.node} is not found within {WITHIN_NS / 1e9:g} s.")
            problems.append(f"drive {found.node}: {found.problem}")
    except ValueError as error:
        _line(f"not tried: these messages cannot be simulated: {error}")
    return problems


def _mapped(config: Config) -> set[int]:
    return {drive.node for drive in config.drive if drive.signals is not None}


def _line(text: str) -> None:
    print(f"{'adhesion':<14} {text}")
