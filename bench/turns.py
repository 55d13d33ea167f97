"""`python -m bench.turns OTHER`: processor time of short commands, here and in another checkout.

In turns, so that it can be measured on a busy machine: there the time by the clock says nothing.
OTHER has a compiled core of its own (`_traction_core.abi3.so`); the libraries are those here.
"""

from __future__ import annotations

import argparse
import tempfile
from pathlib import Path
from statistics import median

from bench.speed import quiet
from bench.whole import BARE, ROUNDS, SHORT_S, ours, process

HERE = Path(__file__).parents[1]


def main() -> None:
    """Print a line per command, ms of both and what is left of the other's."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("other", type=Path)
    other = parser.parse_args().other.resolve()
    with tempfile.TemporaryDirectory() as name:
        log, out = Path(name) / "short.log", str(Path(name) / "flags.log")
        quiet("sim", "healthy", "--duration", str(SHORT_S), "-o", str(log))
        commands = {
            "python -c pass": BARE,
            "--help": ours("--help"),
            "check examples/train.toml": ours("check", str(HERE / "examples/train.toml")),
            f"replay of {SHORT_S:.0f} s": ours("replay", str(log), "-o", out),
        }
        for what, words in commands.items():
            spent: dict[Path, list[float]] = {other: [], HERE: []}
            for _ in range(ROUNDS + 1):
                for folder, busy in spent.items():
                    busy.append(1e3 * process(*words, folder=folder).busy_s)
            a, b = (median(busy[1:]) for busy in spent.values())
            print(f"{what:<32} {a:7.0f} ms {b:7.0f} ms {b / a:5.2f}", flush=True)


if __name__ == "__main__":
    main()
