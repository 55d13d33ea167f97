"""Reading and decoding: our reader and decoder against the libraries, in the same run.

Reader: every verdict of the strict grammar included. Decoder: all signals of every frame, ranges
and not-available codes included; `received` is the gateway's way in, with routing, E2E and pairing.
"""

from __future__ import annotations

import gzip
import resource
import shutil
import tempfile
import time
from functools import reduce
from pathlib import Path
from typing import Final

import can
import cantools
import numpy as np

from bench.speed import best, quiet
from dbc.candump.reader import Reader
from dbc.codec import Codec, bind
from dbc.contract import ANY
from dbc.frame import MS
from dbc.frames import EMPTY, Block, join
from gateway.core.supervision import Supervision
from gateway.settings.config import shipped_dbc
from tests.stations import Inbox

SECONDS: Final = 60.0
PIECE: Final = 8192
"""Frames that are decoded together: a block of the reader."""
FEW: Final = 20_000
"""Frames that cantools decodes: it takes microseconds for each."""
LARGE: Final = 20
"""Times the log, for what memory does."""

MIXED: Final = """VERSION ""
BS_:
BU_: A
BO_ 1 Motorola: 8 A
 SG_ Speed : 7|16@0- (0.01,0) [0|0] "" A
 SG_ Torque : 23|12@0- (0.1,0) [0|0] "" A
 SG_ Level : 27|10@0+ (1,-40) [0|0] "" A
 SG_ Flag : 33|1@0+ (1,0) [0|0] "" A
BO_ 2 Intel: 8 A
 SG_ Count : 0|11@1+ (1,0) [0|0] "" A
 SG_ Offset : 11|13@1- (0.5,0) [0|0] "" A
 SG_ Power : 24|20@1- (0.02,0) [0|0] "" A
BO_ 3 Switched: 8 A
 SG_ Which M : 0|2@1+ (1,0) [0|0] "" A
 SG_ A0 m0 : 8|16@1- (0.1,0) [0|0] "" A
 SG_ B0 m0 : 31|12@0- (1,0) [0|0] "" A
 SG_ A1 m1 : 8|12@1+ (0.1,0) [0|0] "" A
 SG_ B1 m1 : 39|16@0+ (1,0) [0|0] "" A
 SG_ A2 m2 : 8|8@1+ (1,0) [0|0] "" A
 SG_ A3 m3 : 8|24@1- (1e-3,0) [0|0] "" A
"""
"""Both byte orders, signs, and a multiplexer."""
MIXED_FRAMES: Final = 200_000


def log_of(folder: Path, dbc: str, seconds: float = SECONDS) -> Path:
    """A minute of three healthy drives, or so long."""
    log = folder / f"{Path(dbc).stem}.log"
    quiet("sim", "healthy", "--duration", str(seconds), "--dbc", dbc, "-o", str(log))
    return log


def whole(log: Path) -> Block:
    return reduce(join, Reader(log).blocks(), EMPTY)


def lines(log: Path) -> list[tuple[str, ...]]:
    frames = whole(log).size
    ours = best(lambda: sum(block.size for block in Reader(log).blocks()), 7)
    theirs = best(lambda: sum(1 for _ in can.LogReader(log)), 2)
    packed = log.with_suffix(".log.gz")
    with log.open("rb") as source, gzip.open(packed, "wb", compresslevel=6) as target:
        shutil.copyfileobj(source, target)
    unpacked = best(lambda: _drain(packed), 3)
    from_gz = best(lambda: sum(block.size for block in Reader(packed).blocks()), 3)
    large = log.with_suffix(".large.log")
    with large.open("wb") as out:
        for _ in range(LARGE):
            out.write(log.read_bytes())
    sum(block.size for block in Reader(log).blocks())
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    began = time.perf_counter()
    sum(block.size for block in Reader(large).blocks())
    spent = time.perf_counter() - began
    grown = (resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before) / 1024
    size = large.stat().st_size / 1e6
    return [
        _against("candump lines, classic", frames / ours, frames / theirs, "lines/s", "LogReader"),
        ("candump lines, .gz", f"{from_gz:.3f} s", f"decompressor alone {unpacked:.3f} s",
         f"{from_gz / unpacked:.2f}"),
        (f"{size:.0f} MB of candump lines", f"{LARGE * frames / spent / 1e6:.2f} M lines/s",
         "growth of peak memory", f"+{grown:.1f} MB"),
    ]  # fmt: skip


def _drain(packed: Path) -> None:
    with gzip.open(packed, "rb") as stream:
        while stream.read(1 << 20):
            pass


def decoding(
    codec: Codec, dbc: Path, index: np.ndarray, payload: np.ndarray
) -> tuple[float, float, int]:
    """s of all messages by us, s of the first FEW by cantools, and the signals in those.

    index: of each message in the codec.
    """
    database = cantools.database.load_file(dbc)
    known = [database.get_message_by_name(spec.name) for spec in codec.messages]
    some = [
        (known[i], data.tobytes()[: codec.messages[i].length])
        for i, data in zip(index[:FEW].tolist(), payload[:FEW], strict=True)
    ]

    def ours() -> None:
        for k in range(0, len(index), PIECE):
            codec.decode_rows(index[k : k + PIECE], payload[k : k + PIECE])

    def theirs() -> None:
        for message, data in some:
            message.decode(data)

    signals = sum(len(message.decode(data)) for message, data in some)
    return best(ours, 7), best(theirs, 3), signals


def decoded(log: Path, dbc: str) -> list[tuple[str, ...]]:
    path = shipped_dbc(dbc)
    codec = bind(path, (1, 2, 3))
    frames = whole(log)
    number = numbers(codec)[frames.can_id]
    index = number[number >= 0].astype(np.int32)
    payload = np.ascontiguousarray(frames.data[number >= 0])
    signals = np.array([len(spec.signals) for spec in codec.messages])[index]
    ours, theirs, _ = decoding(codec, path, index, payload)
    rate = signals.sum() / ours
    name = f"decode, {'FD' if codec.fd else 'classic'}"
    out = [
        _against(name, rate, signals[:FEW].sum() / theirs, "signals/s", "cantools"),
        *_asammdf(name, log, path, rate, int(signals.sum())),
    ]  # fmt: skip
    taken = best(lambda: _taken(codec, frames), 3)
    return [
        *out,
        (f"received, {'FD' if codec.fd else 'classic'}: a tick of 10 ms at a time",
         f"{1e9 * taken / frames.size:.0f} ns a frame", "", ""),
    ]  # fmt: skip


def mixed(folder: Path) -> tuple[str, ...]:
    """Decoding of what our own message set has none of."""
    path = folder / "mixed.dbc"
    path.write_text(MIXED)
    codec = bind(path, (), ANY)
    rng = np.random.default_rng(0)
    index = rng.integers(0, len(codec.messages), MIXED_FRAMES).astype(np.int32)
    payload = np.zeros((MIXED_FRAMES, 64), dtype=np.uint8)
    payload[:, :8] = rng.integers(0, 256, (MIXED_FRAMES, 8))
    ours, theirs, signals = decoding(codec, path, index, payload)
    # A switched message has only the signals of its switch.
    each = signals / FEW
    return _against(
        "decode, both byte orders, multiplexed", each * MIXED_FRAMES / ours, signals / theirs,
        "signals/s", "cantools",
    )  # fmt: skip


def _taken(codec: Codec, frames: Block) -> None:
    inbox = Inbox(codec, (1, 2, 3), 10 * MS, Supervision((1, 2, 3), 300 * MS))
    first, last = frames.t_ns.item(0), frames.t_ns.item(-1)
    ends = np.arange(first, last + 10 * MS, 10 * MS)
    places = np.searchsorted(frames.t_ns, ends, side="right").tolist()
    done = 0
    for now, end in zip(ends.tolist(), places, strict=True):
        inbox.take(frames.part(done, end), now)
        done = end


def _asammdf(name: str, log: Path, dbc: Path, ours: float, signals: int) -> list[tuple[str, ...]]:
    """The same by asammdf, from its own file format."""
    try:
        from asammdf import MDF
    except ModuleNotFoundError:
        return [(f"{name}, against asammdf", "", "not installed", "")]
    measured = log.with_suffix(".mf4")
    with can.MF4Writer(measured, database=dbc) as writer:
        for message in can.LogReader(log):
            writer.on_message_received(message)
    with MDF(measured) as file:
        spent = best(lambda: file.extract_bus_logging({"CAN": [(str(dbc), 0)]}).close(), 1)
    return [_against(f"{name}, against asammdf", ours, signals / spent, "signals/s",
                     "extract_bus_logging")]  # fmt: skip


def numbers(codec: Codec) -> np.ndarray:
    """Message number of each 11-bit identifier, -1 for none."""
    out = np.full(0x800, -1)
    for spec in codec.messages:
        out[spec.can_id] = spec.index
    return out


def _against(
    what: str, ours: float, theirs: float, unit: str, reference: str
) -> tuple[str, str, str, str]:
    return (
        what, f"{ours / 1e6:.2f} M {unit}", f"{reference} {theirs / 1e6:.3f} M {unit}",
        f"{ours / theirs:.0f} x",
    )  # fmt: skip


def rows() -> list[tuple[str, ...]]:
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        classic = log_of(folder, "traction.dbc")
        fd = log_of(folder, "traction_fd.dbc")
        return [
            *lines(classic), *decoded(classic, "traction.dbc"), *decoded(fd, "traction_fd.dbc"),
            mixed(folder),
        ]  # fmt: skip
