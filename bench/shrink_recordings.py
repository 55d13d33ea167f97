"""Recordings made by others as logs for `bench.shrink`; sources are in tests/data/README.md.

Wheels and temperatures were no CAN frames when they were recorded: each wheel, half-bridge or joint
becomes a drive that sends them, see `bench.real_wheels` and `bench.real_recordings`. The cars' logs
are frames as they were; three temperatures of the one inverter stand for three drives.
"""

from __future__ import annotations

import gzip
import math
from collections.abc import Iterable, Iterator, Sequence
from itertools import count
from pathlib import Path
from typing import Final, NamedTuple

from bench import real_recordings, real_wheels
from bench.real_wheels import RATED_A, TERRAIN_A
from bench.speed import quiet
from dbc.candump.writer import Writer
from dbc.codec import Codec, bind
from dbc.e2e import protect
from dbc.frame import Frame
from gateway.io.prepare import prepare
from gateway.settings.calibration import to_toml
from gateway.settings.config import Config, parse
from tests.inverters import write_dbc
from tests.stations import Temperatures

KONA: Final = "can_logs/kona_ev_2019_pcan_ccan_off_on_ready_off.log"
CASCADIA: Final = ("healthy_572A", "open_sensor_trips")
SENSORS: Final = ("Tstator", "Tde", "Tnde", "Tambient")


class Case(NamedTuple):
    """A log, its configuration, and its channel if it has several."""

    name: str
    path: Path
    config: Config
    channel: str | None = None


def recordings(folder: Path) -> Iterator[Case]:
    """Wheels and temperatures of tests/data."""
    moved = [(name, RATED_A) for name in real_wheels.groups()["onto another floor"]]
    moved += [(name, TERRAIN_A) for name in real_wheels.terrain()]
    for name, rated_a in moved:
        yield wheels(name, rated_a, folder)
    for name in (*real_recordings.LABELS, "icub"):
        yield temperatures(name, folder)


def wheels(name: str, rated_a: float, folder: Path) -> Case:
    """Of `real_wheels.runs` or `real_wheels.terrain`."""
    run = {**real_wheels.runs(), **real_wheels.terrain()}[name]
    config = real_wheels.config_of(run)
    frames = real_wheels.frames(run, bind(config.dbc_path, config.nodes), rated_a)
    return Case(f"wheels {name}", _written(folder / f"{name}.log", frames), config)


def temperatures(name: str, folder: Path) -> Case:
    """Of `real_recordings.LABELS`, or `icub`."""
    if name == "icub":
        readings, calibration = real_recordings.icub(), real_recordings.learn_icub()
    else:
        readings = real_recordings.inverter(name)
        calibration = real_recordings.to_accuracy(real_recordings.learn_inverter())
    limits = folder / f"{name}.toml"
    limits.write_text(to_toml(calibration))
    config = parse({
        "thermal": {"method": "maisd", "calibration": str(limits)},
        "drive": [{"node": motor.node, "sensors": ["stator"]} for motor in calibration.motor],
    })  # fmt: skip
    frames = _sent(readings, bind(config.dbc_path, config.nodes))
    return Case(f"temperatures {name}", _written(folder / f"{name}.log", frames), config)


def _sent(readings: Iterable[Temperatures], codec: Codec) -> Iterator[Frame]:
    """A message for each reading; what is not valid is sent as not available."""
    counters: dict[int, Iterator[int]] = {}
    for one in readings:
        spec = codec.by_name[f"Drive{one.drive + 1}_Temperatures"]
        values = zip(SENSORS, one.celsius, strict=False)
        payload = codec.encode(
            spec, {"Quality": 1, **{k: v for k, v in values if not math.isnan(v)}}
        )
        protect(spec, payload, next(counters.setdefault(one.drive, count())))
        yield Frame(one.t_ns, spec.can_id, bytes(payload), 0, "vcan0")


def _written(path: Path, frames: Iterable[Frame]) -> Path:
    with Writer(path) as writer:
        for frame in frames:
            writer.write(frame)
    return path


def cars(data: Path, folder: Path) -> Iterator[Case]:
    """Logs of two electric cars in `data`, a copy of the shared data; the licence of one is not
    known, so it is not in this repository.
    """
    dbc = write_dbc(folder / "kona.dbc", {
        "Mcu": (0x523, 10, [f'T{k} : {8 + 8 * k}|8@1+ (1,-40) [-40|214] "degC"' for k in (1, 2, 3)])
    })  # fmt: skip
    signals = [
        f'{{ signal = "Mcu.T{k}", not_available = [255], settle_ms = 200 }}' for k in (1, 2, 3)
    ]
    config = _learnt(folder, dbc, signals, data / KONA, "can0")
    yield Case("car: Kona", data / KONA, config, "can0")
    cascadia = data / "cascadia_inverter"
    logs = [_candump(cascadia / f"{name}.txt.gz", folder) for name in CASCADIA]
    signals = [f'"MC_Temperature_Set_1.INV_Module_{k}_Temp"' for k in "ABC"]
    config = _learnt(folder, cascadia / "car.dbc", signals, logs[0], "can0")
    for name, log in zip(CASCADIA, logs, strict=True):
        yield Case(f"car: Cascadia {name}", log, config)


def _learnt(folder: Path, dbc: Path, signals: Sequence[str], log: Path, channel: str) -> Config:
    """Three drives with a sensor each, and limits that the log gives."""
    drives = "".join(
        f'[[drive]]\nnode = {node}\nsensors = ["stator"]\n[drive.signals]\ndbc = "{dbc}"\n'
        f"[drive.signals.use]\nTstator = {signal}\n"
        for node, signal in enumerate(signals, 1)
    )
    head, limits = '[thermal]\nmethod = "maisd"\n', folder / f"{log.stem}.limits.toml"
    config = folder / f"{log.stem}.toml"
    config.write_text(head + drives)
    words = ["--config", str(config), "--log-channel", channel, "--without-model"]
    quiet("calibrate", str(log), *words, "-o", str(limits))
    config.write_text(f'{head}calibration = "{limits}"\n{drives}')
    return prepare(config)[0]


def _candump(path: Path, folder: Path) -> Path:
    """`TTTTTTTTxIIIIIIIIDD..`, hexadecimal, T in ms, as candump has it."""
    log = folder / f"{path.name.partition('.')[0]}.log"
    with gzip.open(path, "rt", encoding="ascii") as lines, log.open("w") as out:
        for line in lines:
            seconds, ms = divmod(int(line[:8], 16), 1000)
            out.write(f"({seconds}.{ms:03d}000) can0 {line[9:17]}#{line[17:].strip()}\n")
    return log
