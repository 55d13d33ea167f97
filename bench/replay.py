"""Replay, log in to flags out, against what a user would write with the libraries.

The chain: python-can's `LogReader`, cantools, one filterpy EKF a drive. It predicts in the same
steps of 125 us as ours: in the 2 ms between two samples the rotor turns by up to a radian, which
one Euler step cannot follow. It checks no checksum and no counter, knows no loss and no drive that
starts, runs no detector and sends nothing.
"""

from __future__ import annotations

import itertools
import math
import tempfile
import time
from functools import partial
from pathlib import Path
from typing import Final

import can
import cantools
import numpy as np

import gateway
from bench.kernels import Motor
from bench.speed import best, quiet
from bench.wire import log_of, numbers
from dbc.candump import Reader
from dbc.codec import bind
from gateway.config import shipped_dbc

HEADER = ("figure", "measured", "reference in the same run", "ratio")
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
SUB_STEPS: Final = 16
"""Predictions a sample: 2 ms."""
_SQRT3: Final = math.sqrt(3.0)


def chain(log: Path, dbc: Path, frames: int) -> float:
    """s for the first `frames` frames."""
    database = cantools.database.load_file(dbc)
    drives = {node: (Motor(), {}) for node in (1, 2, 3)}  # type: ignore[var-annotated]
    began = time.perf_counter()
    for frame in itertools.islice(can.LogReader(log), frames):
        try:
            message = database.get_message_by_frame_id(frame.arbitration_id)
        except KeyError:
            continue
        drive, _, kind = message.name.partition("_")
        if kind not in ("PhaseCurrents", "StatorVoltages"):
            continue
        motor, halves = drives[int(drive.removeprefix("Drive"))]
        values = message.decode(frame.data)
        other = halves.pop(values["Counter"], None)
        if other is None:
            halves[values["Counter"]] = values
            continue
        currents, voltages = (values, other) if "Ia" in values else (other, values)
        a, b, c = (float(currents[name]) for name in ("Ia", "Ib", "Ic"))
        motor.u = float(voltages["Ualpha"]), float(voltages["Ubeta"])
        for _ in range(SUB_STEPS):
            motor.advance()
        motor.correct(np.array([(2.0 * a - b - c) / 3.0, (b - c) / _SQRT3]))
    return time.perf_counter() - began


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
    """One row per message set and reference."""
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
                theirs_k = FEW / chain(log, path, FEW) / 1e3
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
