"""`warm`: compile ahead, into a folder that `run --kernels` reads."""

from __future__ import annotations

import argparse
import time
from pathlib import Path

from gateway.commands.common import BAD_INPUT, GOOD, patience, prepare, scenario_thermal

HELP = "compile ahead of time, for a service that must not"


def arguments(parser: argparse.ArgumentParser) -> None:
    """Options of the verb."""
    parser.add_argument(
        "config", type=Path, nargs="*", metavar="CONFIG",
        help="configurations to be run; without any: both shipped message sets",
    )  # fmt: skip
    parser.add_argument("-o", "--output", type=Path, required=True, dest="kernels", metavar="DIR",
                        help="folder of the compiled code; anew after every upgrade")  # fmt: skip


def run(options: argparse.Namespace) -> int:
    """Compile, or find compiled, what the configurations need."""
    from gateway.drivers import kernelcache

    made = kernelcache.make(options.kernels)
    from gateway.drivers.warm import warm_up

    began, before = time.monotonic(), kernelcache.lost()
    shipped = [{"file": name} for name in ("traction.dbc", "traction_fd.dbc")]
    with patience():
        for path in options.config:
            warm_up(*prepare(path))
        for given in () if options.config else shipped:
            # Any calibration will do: without one nothing of the thermal side would be compiled.
            warm_up(*prepare(None, dbc=given, thermal=scenario_thermal()))
    kernels, lost = kernelcache.count(made), kernelcache.lost() - before
    if lost:
        print(f"{lost} kernels could not be kept in {made}: make room, and repeat this")
        return BAD_INPUT
    print(f"{kernels} kernels in {made}, {time.monotonic() - began:.0f} s")
    return GOOD
