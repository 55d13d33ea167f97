"""Fuzz targets: configuration, scenario and DBC. Input: the text of the file."""

import atexit
import os
import re
import shutil
import tempfile
import tomllib
from pathlib import Path
from zlib import crc32

import numpy as np

from dbc.codec import bind
from dbc.contract import ANY, CLASSIC, FD
from dbc.spec import DbcMismatch
from gateway.core.gateway import Gateway
from gateway.settings.config import BUILTIN_DBC, Config, ConfigError, load
from sim.scenario import Scenario, ScenarioError
from sim.scenario import load as load_scenario
from tests.fuzzing.held import Held
from tests.reference import codec as reference
from tests.sender import FD_FILE, SteadyDrive, codec_for

ALL = tuple(range(1, 17))
CODECS = {"traction.dbc": codec_for(ALL), "traction_fd.dbc": codec_for(ALL, FD_FILE)}
TICK = 10_000_000
GATEWAYS = 16
"""Of so many configurations that are good one drives a gateway."""
LONGEST = 2000
_BARE = re.compile(r"[A-Za-z0-9_-]+")
_DRIVES = [SteadyDrive(CODECS["traction.dbc"], n, 80.0 * n, 15.0) for n in (1, 2, 3)]
_SENT = [frame for k in range(25) for drive in _DRIVES for frame in drive.frames(k)]
CONTRACTS = (ANY, CLASSIC, FD, None)
_SHARED = Path("/dev/shm")
FOLDER = Path(tempfile.mkdtemp(prefix="fuzzing", dir=_SHARED if _SHARED.is_dir() else None))
atexit.register(shutil.rmtree, FOLDER, ignore_errors=True)


def _file(data, suffix):
    """In memory where the system has such a folder; one per process, overwritten."""
    path = FOLDER / f"{os.getpid()}.{suffix}"
    path.write_bytes(data)
    return path


def _readable(problems):
    """A person can read them: some, each a line, none endless."""
    assert problems
    for problem in problems:
        assert problem.strip()
        assert len(problem.splitlines()) == 1, problem
        assert problem.isprintable(), problem
        assert len(problem) <= LONGEST, problem


def _placed(problems, data, model, apart):
    """Each begins with the path of a key, after its line if that is known, if the file is TOML."""
    try:
        text = data.decode()
        if model is Scenario:
            # Read as text, where each kind of line end is one.
            text = text.replace("\r\n", "\n").replace("\r", "\n")
        given = set(tomllib.loads(text))
    except (ValueError, RecursionError):
        assert len(problems) == 1
        assert re.search(r"TOML|cannot be read", next(iter(problems)))
        return
    known = given | set(model.model_fields)
    if not all(_BARE.fullmatch(key) and len(key) < 100 for key in known):
        return
    for problem in problems:
        line = re.match(r"line (\d+): ", problem)
        assert not line or 1 <= int(line[1]) <= text.count("\n") + 1, problem
        rest = problem[line.end() :] if line else problem
        head = re.match(rf"[A-Za-z0-9_-]+(?=[{apart}])", rest)
        assert head, problem
        assert head[0] in known, problem


def config(data, read=load, every=GATEWAYS):
    """A Config, or a ConfigError with a path in every line. Returns 1 for a Config."""
    try:
        found = read(Held(data, "train.toml"))
    except ConfigError as error:
        _readable((*error.problems, str(error)[:LONGEST]))
        _placed(error.problems, data, Config, ".:")
        return 0
    assert 0 <= found.hash24() < 1 << 24
    assert set(found.bus.options) <= {"interface", "channel", "bitrate", "fd", "data_bitrate"}
    assert found.dbc_path.name
    if crc32(data) % every == 0 and found.dbc.file in BUILTIN_DBC:
        _drives(found)
    return 1


def _drives(found):
    """What was accepted makes a gateway that takes frames, or is refused as a ConfigError."""
    try:
        # A motor that cannot be overflows its noise: no harm, the drive is never believed.
        with np.errstate(all="ignore"):
            gateway = Gateway(found, CODECS[found.dbc.file], 0)
    except ConfigError as error:
        _readable(error.problems)
        return
    for tick in range(1, 6):
        now = tick * TICK
        with np.errstate(all="ignore"):
            gateway.step([f for f in _SENT if now - TICK < f.t_ns <= now], now)


def scenario(data, read=load_scenario):
    """A Scenario, or a ScenarioError with a path in every line. Returns 1 for a Scenario."""
    try:
        found = read(_file(data, "toml"))
    except ScenarioError as error:
        _readable(error.problems)
        _placed(error.problems, data, Scenario, r".:\[")
        return 0
    assert 1 <= found.drives <= 16
    for item in (*found.event, *found.expect):
        assert set(found.drives_of(item.drive)) <= set(ALL)
    for event in found.event:
        assert event.end_s >= event.at_s
        assert event.number == event.number
    return 1


def dbc(data, read=bind):
    """A Codec that decodes and encodes anything, or a DbcMismatch. Returns 1 for a Codec."""
    path = _file(data, "dbc")
    mark = crc32(data)
    try:
        codec = read(path, (1, 2), CONTRACTS[0 if mark & 7 else mark >> 3 & 3])
    except DbcMismatch as error:
        _readable(error.problems)
        return 0
    n = len(codec.messages)
    index = np.arange(n, dtype=np.int32).repeat(3)
    payload = np.zeros((3 * n, 64), np.uint8)
    payload[1::3] = 0xFF
    payload[2::3] = np.frombuffer(data.ljust(64, b"~")[-64:], np.uint8)
    with np.errstate(all="ignore"):
        fast, slow = (
            codec.decode_rows(index, payload),
            reference.decode_rows(codec, index.tolist(), payload),
        )
    for one, other in zip(fast, slow, strict=True):
        assert np.array_equal(one, other, equal_nan=one.dtype.kind == "f")
    for spec in codec.messages:
        for number in (0.0, -1.0, 1e308, None):
            made = codec.encode(spec, {signal.name: number for signal in spec.signals})
            assert len(made) == spec.length
        assert all(signal.raw_min <= signal.raw_max for signal in spec.signals)
    return 1
