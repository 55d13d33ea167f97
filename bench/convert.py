"""`traction-gateway convert` against python-can's converter: a minute of three drives, each way.

Theirs is what `can_convert` does: a LogReader into a Logger. Both in this process.
"""

from __future__ import annotations

import tempfile
from functools import partial
from pathlib import Path
from typing import Final

import can

from bench.speed import best, quiet
from bench.wire import log_of

FORMATS: Final = (".log", ".asc", ".trc", ".csv", ".blf", ".mf4")


def theirs(source: Path, target: Path) -> None:
    with can.LogReader(source) as reader, can.Logger(target) as writer:
        for message in reader:
            writer.on_message_received(message)


def options(target: Path) -> list[str]:
    """Of the command: MF4 and CSV of frames, as theirs are."""
    return ["--frames"] if target.suffix in (".csv", ".mf4") else []


def ours(source: Path, target: Path) -> None:
    target.unlink(missing_ok=True)
    quiet("convert", str(source), str(target), *options(target))


def rows() -> list[tuple[str, ...]]:
    """From candump into each format, and from each into candump. Each reads its own file."""
    out = []
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        log = log_of(folder, "traction.dbc")
        with log.open("rb") as lines:
            frames = sum(1 for _ in lines)
        for ending in FORMATS:
            pairs = [(log, folder / f"made{ending}", folder / f"theirs{ending}")]
            if ending != ".log":
                pairs.append((folder / f"made{ending}", folder / "back.log", folder / "back2.log"))
            for source, mine, other in pairs:
                spent = best(partial(ours, source, mine))
                reference = best(partial(theirs, source, other), 1)
                out.append((
                    f"{source.suffix} to {mine.suffix}", f"{frames / spent / 1e3:.0f} k frames/s",
                    f"python-can {frames / reference / 1e3:.0f} k frames/s",
                    f"{reference / spent:.1f} x",
                ))  # fmt: skip
    return out
