"""`hil --slip-bench`: how well a gateway, or a controller, uses the available adhesion."""

from __future__ import annotations

import argparse
import importlib.util
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Final

from gateway.commands.common import FAILED, GOOD, names_bus
from gateway.reports.known import percentage
from gateway.settings.config import ConfigError

if TYPE_CHECKING:
    from gateway.hil.slip_bench import Run
    from gateway.hil.slip_plant import Controller
    from gateway.hil.slip_rails import Track

REFERENCES: Final = ("oracle", "none")
"""Controllers run beside the device under test: the best and the worst that a track allows."""


def arguments(parser: argparse.ArgumentParser) -> None:
    """Options of `hil` that are about slip protection."""
    parser.add_argument("--slip-bench", action="store_true",
                        help="brake on slippery tracks (names instead of scenarios, default all) "
                        "and score the slip protection; -o DIR: a page with pictures")  # fmt: skip
    parser.add_argument("--controller", metavar="NAME", default="gateway",
                        help="what reduces torque: gateway (default; our flags on a virtual "
                        "bus, or with -i and -c the flags of a device on a bus), oracle, creep, "
                        "late, timid, none or FILE.py:FUNCTION")  # fmt: skip
    parser.add_argument("--expect-score", type=percentage, metavar="PERCENT",
                        help="exit 1 if the score of a track is lower")  # fmt: skip


def run(options: argparse.Namespace) -> int:
    """Print a table, and write a page if a folder is given. Exit 1 if a score is too low."""
    from gateway.hil.slip_bench import CONTROLLERS, ride
    from gateway.hil.slip_page import HEAD, cells, leave

    tracks = list(_tracks(options.scenario))
    device = _device(options)
    runs: list[Run] = []
    print("  ".join(name.removesuffix(":") for name in HEAD))
    for track in tracks:
        rides = [device(track)]
        rides += [ride(track, CONTROLLERS[name](0), name) for name in REFERENCES
                  if name != options.controller]  # fmt: skip
        for one in rides:
            print("  ".join(f"{cell:>{len(name) - name.endswith(':')}}"
                            for cell, name in zip(cells(one), HEAD, strict=True)))  # fmt: skip
        runs += rides
    own = [one for one in runs if one.controller == runs[0].controller]
    mean = 100.0 * sum(one.score.score for one in own) / len(own)
    print(f"{own[0].controller}: {mean:.1f} %, tracks: {len(own)}")
    if options.output is not None:
        print(f"report: {leave(options.output, runs, own[0].controller)}")
    low = options.expect_score or 0.0
    return FAILED if any(100.0 * one.score.score < low for one in own) else GOOD


def _tracks(names: list[str]) -> Iterator[Track]:
    """Tracks: of the library by name, or `seed_N` by seed. Raises ConfigError."""
    from gateway.hil.slip_rails import LIBRARY, seeded

    for name in names or LIBRARY:
        seed = name.removeprefix("seed_")
        if name in LIBRARY:
            yield LIBRARY[name]
        elif seed != name and seed.isdecimal():
            yield seeded(int(seed))
        else:
            cure = f"one of {', '.join(LIBRARY)}, or seed_N"
            raise ConfigError("--slip-bench", [f"no track {name!r}: {cure}"])


def _device(options: argparse.Namespace) -> Callable[[Track], Run]:
    """Function that runs the chosen controller on a track. Raises ConfigError."""
    from gateway.hil.slip_bench import CONTROLLERS, ride, ride_on_bus, ride_with_gateway

    name = options.controller
    if names_bus(options):
        if name != "gateway":
            raise ConfigError("--controller", ["on a bus the device's flags control the torque"])
        return partial(ride_on_bus, options=options)
    if name == "gateway":
        return ride_with_gateway
    if name in CONTROLLERS:
        return lambda track: ride(track, CONTROLLERS[name](0), name)
    path, _, function = name.partition(":")
    if not function:
        cure = f"one of gateway, {', '.join(CONTROLLERS)}, or FILE.py:FUNCTION"
        raise ConfigError("--controller", [f"no {name!r}: {cure}"])
    return lambda track: ride(track, _from_file(Path(path), function), function)


def _from_file(path: Path, function: str) -> Controller:
    """The user's own controller, loaded again for each track. Raises ConfigError."""
    spec = importlib.util.spec_from_file_location(path.stem, path)
    if spec is None or spec.loader is None or not path.is_file():
        raise ConfigError("--controller", [f"{path}: no Python file"])
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    try:
        found: Controller = getattr(module, function)
    except AttributeError:
        raise ConfigError("--controller", [f"{path}: no function {function!r}"]) from None
    return found
