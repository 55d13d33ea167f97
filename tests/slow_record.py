"""A record of slow messages alone: motors that warm and cool with a changing duty."""

import math
import re

import numpy as np

from dbc.codec import bind
from dbc.e2e import protect
from dbc.frame import SECOND, Frame
from gateway.settings.config import load
from tests.simrun import log_of

KINDS = ("Motion", "Status", "Temperatures")


def slow_dbc(path, cycle_ms=1000):
    """A copy of the DBC in which the slow messages come every `cycle_ms`."""
    text = load(None).dbc_path.read_text()
    ids = [base + n for base in (0x380, 0x1C0, 0x480) for n in range(1, 17)]
    for one in ids:
        text, found = re.subn(rf'(BA_ "GenMsgCycleTime" BO_ {one}) \d+;', rf"\1 {cycle_ms};", text)
        assert found == 1
    path.write_text(text)


def config(folder, drives=2, cycle_ms=1000):
    """A configuration for such records; its path."""
    slow_dbc(folder / "slow.dbc", cycle_ms)
    path = folder / "slow.toml"
    nodes = "".join(f"[[drive]]\nnode = {n}\n" for n in range(1, drives + 1))
    path.write_text(f'[dbc]\nfile = "slow.dbc"\n{nodes}')
    return path


def duty(seconds, rng):
    """(L,) squared current's root, A, and (L,) speed, rad/s: new ones every few minutes."""
    parts = -(-seconds // 240)
    current = np.repeat(rng.uniform(2.0, 24.0, parts), 240)[:seconds]
    return current, np.repeat(rng.uniform(30.0, 180.0, parts), 240)[:seconds]


def temperatures(current, speed, scale):
    """(L, 4) degC of a motor, and the air: two lumps, second by second."""
    winding = frame = 20.0
    out = np.empty((len(current), 4))
    heat = scale * 2.5e-4 * current**2
    for k, (warm, cool) in enumerate(zip(heat.tolist(), (speed * 4e-6).tolist(), strict=True)):
        flow = 4e-3 * (winding - frame)
        winding += warm - flow
        frame += 0.4 * flow - (1e-3 + cool) * (frame - 20.0)
        out[k] = winding, 0.8 * frame + 4.0, 0.7 * frame + 6.0, 20.0
    return out


def write(
    path, config_path, seconds, *, cycle_ms=1000, without=(), cut_out=(), until=math.inf, seed=1
):
    """A log. without: (node, signal) that are not available in it.

    cut_out: nodes without current, until so many seconds from the start.
    """
    settings = load(config_path)
    codec = bind(settings.dbc_path, settings.nodes)
    rng = np.random.default_rng(seed)
    driven, speed = duty(seconds, rng)
    each = 1000 // cycle_ms
    frames = []
    for node in settings.nodes:
        current = driven * ((node not in cut_out) | (np.arange(len(driven)) >= until))
        warm = temperatures(current, speed, 1.0 + 0.03 * node)
        rows = np.repeat(warm, each, axis=0) + rng.normal(0.0, 0.15, (seconds * each, 4))
        columns = {
            "Motion": {"Speed": speed * 30 / np.pi, "ElectricalAngle": 0 * speed,
                       "Torque": current},
            "Status": {"Irms": current / np.sqrt(2), "TorqueCommand": current,
                       "State": 2 + 0 * speed, "FaultCode": 0 * speed},
            "Temperatures": dict(zip(("Tstator", "Tde", "Tnde", "Tambient"), rows.T, strict=True)),
        }  # fmt: skip
        for kind, values in columns.items():
            spec = codec.by_name[f"Drive{node}_{kind}"]
            names = ("Quality", *values)
            table = np.stack(
                [np.ones(seconds * each)]
                + [np.resize(np.repeat(v, each), seconds * each) if len(v) == seconds and each > 1
                   else v for v in values.values()],
                axis=1,
            )  # fmt: skip
            for name in names:
                if (node, name) in without:
                    table[:, names.index(name)] = np.nan
            at = SECOND + 1000 * (3 * node + KINDS.index(kind))
            for k, payload in enumerate(codec.encode_rows(spec, names, table)):
                protect(spec, payload, k)
                stamp = at + k * cycle_ms * SECOND // 1000
                frames.append(Frame(stamp, spec.can_id, bytes(payload)))
    log_of(path, sorted(frames))
