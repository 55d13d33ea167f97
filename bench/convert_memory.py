"""`python -m bench.convert_memory`: peak memory of `traction-gateway convert`.

From a short log and from one of two gigabytes, a process each, from candump into each format and
back; 10 to 20 minutes and 8 GB of disk.
"""

from __future__ import annotations

import tempfile
from pathlib import Path
from typing import Final

from bench.__main__ import table
from bench.convert import FORMATS, options
from bench.speed import quiet
from bench.whole import LONG_S, ours, process, repeated

HEADER = ("conversion", "a short log", "a log of 2 GB")
BYTES: Final = 2_000_000_000


def rows() -> list[tuple[str, ...]]:
    found: dict[str, list[str]] = {}
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        part, log = folder / "part.log", folder / "in.log"
        quiet("sim", "healthy", "--duration", str(LONG_S), "-o", str(part))
        for times in (1, -(-BYTES // part.stat().st_size)):
            repeated(part, log, times)
            size = f"{log.stat().st_size / 1e6:.0f} MB"
            for ending in FORMATS:
                made, back = folder / f"made{ending}", folder / "back.log"
                there = process(*ours("convert", str(log), str(made), *options(made)))
                found.setdefault(f".log to {ending}", []).append(f"{there.peak_mb:.0f} MB ({size})")
                if ending != ".log":
                    again = process(*ours("convert", str(made), str(back)))
                    text = f"{again.peak_mb:.0f} MB ({made.stat().st_size / 1e6:.0f} MB)"
                    found.setdefault(f"{ending} to .log", []).append(text)
                    back.unlink()
                made.unlink()
            log.unlink()
    return [(conversion, *peaks) for conversion, peaks in found.items()]


if __name__ == "__main__":
    print(table(HEADER, rows()))
