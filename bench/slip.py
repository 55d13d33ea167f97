"""What the slip-protection bench reaches: the library, seeded tracks, 95 and 105 % of the peak.

    python -m bench.slip [--seeds 1000-1099] [--gateway 20] [--held 20]

Controllers that need no bus run on a seeded track for each seed; our gateway on the library and on
the first `--gateway` of these seeds. Its torque law was tuned on the library.
"""

from __future__ import annotations

import argparse
import sys
import time
from collections.abc import Sequence

import numpy as np

from bench.__main__ import table
from gateway.hil.slip_bench import CONTROLLERS, Run, ride, ride_with_gateway
from gateway.hil.slip_page import HEAD, cells
from gateway.hil.slip_rails import LIBRARY, held, seeded
from gateway.hil.slip_score import LOST

BAD = ("late", "timid")
SPAN = ("controller", "tracks", "score %, mean (worst)", "utilisation %, mean (worst)")


def spread(name: str, runs: Sequence[Run]) -> tuple[str, ...]:
    """A row under `SPAN`."""
    both = [[100.0 * r.score.score for r in runs], [100.0 * r.score.utilisation for r in runs]]
    return name, str(len(runs)), *(f"{np.mean(x):.1f} ({min(x):.1f})" for x in both)


def library() -> None:
    runs = []
    for track in LIBRARY.values():
        runs.append(ride_with_gateway(track))
        runs += [ride(track, make(0), name) for name, make in CONTROLLERS.items()]
    names = [name.removesuffix(":") for name in HEAD]
    print(table(tuple(names), [cells(run) for run in runs]), "\n")
    rows = [spread(name, [r for r in runs if r.controller == name])
            for name in ("gateway", *CONTROLLERS)]  # fmt: skip
    print(table(SPAN, rows), "\n", flush=True)


def ranking(seeds: range) -> None:
    """Who ranks how on tracks by seed, bad ones made by the same seed."""
    began = time.process_time()
    runs = {name: [ride(seeded(seed), make(seed), name) for seed in seeds]
            for name, make in CONTROLLERS.items()}  # fmt: skip
    seconds = time.process_time() - began
    print(table(SPAN, [spread(name, found) for name, found in runs.items()]), "\n")
    for bad in BAD:
        pairs = zip(runs["creep"], runs[bad], strict=True)
        below = sum(one.score.score > other.score.score for one, other in pairs)
        print(f"`{bad}` ranks below `creep` for {below} of {len(seeds)} seeds")
    what = f"{len(seeds)} seeds, {len(runs)} controllers"
    print(f"{what}: {seconds:.0f} s of one processor\n", flush=True)


def ours(seeds: range) -> None:
    """Our gateway on tracks that its torque law was not tuned on."""
    runs = [ride_with_gateway(seeded(seed)) for seed in seeds]
    print(table(SPAN, [spread("gateway", runs)]), "\n", flush=True)


def peaks(seeds: range) -> None:
    """Runs with an `AdhesionLost`, where 95 and 105 % of the peak are asked for."""
    rows = []
    for share in (0.95, 1.05):
        runs = [ride_with_gateway(held(share, seed), longest_s=8.0) for seed in seeds]
        told = [any((m.flag == LOST).any() for m in run.moments) for run in runs]
        rows.append((f"{100 * share:g} %", str(len(runs)), str(sum(told))))
    print(table(("asked, of the peak", "runs of 8 s", "with AdhesionLost"), rows), flush=True)


def main(words: Sequence[str]) -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seeds", default="1000-1099")
    parser.add_argument("--gateway", type=int, default=20)
    parser.add_argument("--held", type=int, default=20)
    options = parser.parse_args(words)
    first, last = map(int, options.seeds.split("-"))
    library()
    ranking(range(first, last + 1))
    ours(range(first, first + options.gateway))
    peaks(range(first, first + options.held))


if __name__ == "__main__":
    main(sys.argv[1:])
