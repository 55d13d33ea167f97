"""Replay, log in to flags out, against what a user would write with the libraries (`chain`).

In this process; whole ones are in `whole`.
"""

from __future__ import annotations

import tempfile
import time
from functools import partial
from pathlib import Path
from typing import Final

import numpy as np

import gateway
from bench.chain import chain
from bench.speed import best, quiet
from bench.wire import log_of, numbers
from dbc.candump.reader import Reader
from dbc.codec import bind
from gateway.settings.config import shipped_dbc

SPANS: Final = {"traction.dbc": 300.0, "traction_fd.dbc": 60.0}
"""s of the logs: a command's start and end are a twentieth of a second."""
FEW: Final = 5_000
"""Frames that the chain gets: it would take minutes for all."""
TRAIN: Final = """[dbc]
file = "{dbc}"
[thermal]
calibration = "{calibration}"
[[drive]]
node = 1
[[drive]]
node = 2
[[drive]]
node = 3
"""
"""Calibrated, so that the thermal detector has something to do."""
CALIBRATION: Final = Path(gateway.__file__).with_name("bench_calibration.toml")


def hilspy(log: Path, dbc: Path) -> float | str:
    """s to read and decode all by hilspy, the values fetched; why not, if it does not."""
    try:
        import hilspy as library
    except ModuleNotFoundError:
        return "not installed"
    began = time.perf_counter()
    try:
        with library.open(f"file://{log}?format=candump", f"dbc:{dbc}") as channel:
            for message in channel:
                message.fields  # noqa: B018
    except library.Error as error:
        return str(error)
    return time.perf_counter() - began


def parsed(log: Path, dbc: Path) -> float:
    """s to do the same here."""
    codec = bind(dbc, (1, 2, 3))
    number = numbers(codec)

    def all_of_it() -> None:
        for block in Reader(log).blocks():
            codec.decode_rows(number[block.can_id].astype(np.int32), block.data)

    return best(all_of_it)


def rows() -> list[tuple[str, ...]]:
    out = []
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        for dbc, seconds in SPANS.items():
            log, path = log_of(folder, dbc, seconds), shipped_dbc(dbc)
            train = folder / "train.toml"
            train.write_text(TRAIN.format(dbc=dbc, calibration=CALIBRATION))
            with log.open("rb") as lines:
                frames = sum(1 for _ in lines)
            ours = best(
                partial(quiet, "replay", str(log), "--config", str(train), "-o", str(folder / "o"))
            )
            what = f"replay, {Path(dbc).stem}: {frames / ours / 1e3:.0f} k frames/s"
            out.append((what, f"{ours:.2f} s", f"real time {seconds:.0f} s",
                        f"{seconds / ours:.0f} x"))  # fmt: skip
            ours_k = frames / ours / 1e3
            if dbc == "traction.dbc":
                theirs_k = FEW / chain(log, path, FEW)[0] / 1e3
                out.append((
                    f"  against LogReader + cantools + filterpy ({FEW} frames)",
                    f"{ours_k:.0f} k frames/s", f"{theirs_k:.1f} k frames/s",
                    f"{ours_k / theirs_k:.1f} x",
                ))  # fmt: skip
            spent, peer = parsed(log, path), hilspy(log, path)
            out.append((
                f"parse and decode, {Path(dbc).stem}", f"{frames / spent / 1e3:.0f} k frames/s",
                f"hilspy: {peer}" if isinstance(peer, str)
                else f"hilspy {frames / peer / 1e3:.0f} k frames/s",
                "" if isinstance(peer, str) else f"{peer / spent:.0f} x",
            ))  # fmt: skip
    return out
