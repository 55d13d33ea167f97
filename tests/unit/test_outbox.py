"""What goes out is what is said, signal by signal; and the schedule."""

import math

import numpy as np
import pytest

from gateway import outbox as module
from gateway._outbox_kernels import send
from gateway.flags import FlagKind, unknown_status
from gateway.health import NEVER
from gateway.heatside import Wear
from gateway.outbox import Outbox
from gateway.view import Counted, drives_of, view_of
from tests.sender import CLASSIC, FD_FILE, MS, codec_for

NODES = (2, 1, 3)
N = len(NODES)
TICK = 10 * MS
RPM = 60.0 / (2.0 * math.pi)
COUNTED = Counted(3, 5000, 7, 41.0, 120.0, None)


def drawn(rng):
    """Any words and numbers that there can be."""
    status = unknown_status(N, 4)
    drives, train = status
    drives["flag"]["state"] = rng.integers(0, 3, (N, len(FlagKind)))
    drives["health"], drives["fault_sensor"] = rng.integers(0, 6, (2, N))
    drives["fault_class"], drives["jumps"] = rng.integers(0, 9, N), rng.integers(0, 40, N)
    for name, most in (("speed_rad_s", 1500.0), ("load_nm", 3000.0), ("loss_probability", 1.0),
                       ("nis", 40.0), ("mixed_c", 250.0), ("maisd_k", 40.0),
                       ("rate_k_h", 3.0)):  # fmt: skip
        drives[name] = np.where(rng.random(N) < 0.3, np.nan, rng.uniform(0.0, most, N))
    train["adhesion_reason"], train["faults_reason"] = rng.integers(0, 12, 2)
    for name in ("sensor", "comm", "estimator", "overrun"):
        train[name] = rng.integers(0, 3)
    train["state"], train["common_mode"] = 3, 2
    for name in ("age_ns", "temperature_age_ns"):
        train[name] = rng.choice([NEVER, rng.integers(0, 10**9), rng.integers(0, 4 * 10**9)])
    return status


def expected(words, config_hash):
    """Every signal's value by message, from the view of the same words; None: not known."""
    view = view_of(0, words, drives_of(words, NODES, [Wear()] * N), None, COUNTED)
    ages = [None if a == NEVER else a // MS for a in (
        words.train["age_ns"].item(), words.train["temperature_age_ns"].item(),
    )]  # fmt: skip
    out = {
        "Gateway_Adhesion": {
            "Reason": view.adhesion_reason, "Detector": view.detector,
            "CommonMode": view.common_mode, "Age": None if ages[0] is None else min(ages[0], 254),
            **{f"Adhesion{d.node}": d.adhesion for d in view.drives},
        },
        "Gateway_Faults": {
            "Reason": view.faults_reason, "SensorFault": view.sensor, "CommFault": view.comm,
            "EstimatorFault": view.estimator, "Overrun": view.overrun,
            "Age": None if ages[1] is None else min(ages[1] // 10 * 10, 2540),
            **{f"Thermal{d.node}": d.thermal for d in view.drives},
        },
        "Gateway_Info": {"ConfigHash": config_hash, "LatencyP99": 120.0, "LatenessP99": None},
        "Gateway_Status": {"State": view.state, "DeadlineMisses": 3, "RejectedFrames": 4094,
                           "LostFrames": 7, "BusLoad": 41.0},
    }  # fmt: skip
    for k, d in enumerate(view.drives):
        rate, jumps = (words.drives[name].item(k) for name in ("rate_k_h", "jumps"))
        lost = d.loss_probability
        out[f"Drive{d.node}_Estimate"] = {
            "Health": d.health, "Speed": None if d.speed_rad_s is None else RPM * d.speed_rad_s,
            "LoadTorque": d.load_nm, "LossProbability": None if lost is None else 100.0 * lost,
            "Nis": None if d.nis is None else min(d.nis, 25.4),
        }  # fmt: skip
        out[f"Drive{d.node}_Thermal"] = {
            "FaultClass": d.fault_class, "FaultSensor": d.fault_sensor, "Tmixed": d.mixed_c,
            "Maisd": d.maisd_k, "Jumps": None if math.isnan(rate) else min(jumps, 14),
            "DegradationRate": None if math.isnan(rate) else rate,
        }  # fmt: skip
    return out


@pytest.mark.parametrize("file", [CLASSIC, FD_FILE])
def test_every_signal_says_what_is_said(file):
    codec, rng = codec_for(NODES, file), np.random.default_rng(2)
    for _ in range(100):
        box, words = Outbox(codec, NODES, 0xABCDEF, TICK), drawn(rng)
        assert box.wants_counts(0)
        box.note_counts(COUNTED)
        frames = box.due(words, 0)
        wanted = expected(words, 0xABCDEF)
        assert [f.can_id for f in frames] == sorted(f.can_id for f in frames)
        assert {codec.by_id[f.can_id].name for f in frames} == set(wanted)
        for frame in frames:
            spec = codec.by_id[frame.can_id]
            values = {
                name: reading.value if reading.validity == 0 else None
                for name, reading in codec.decode(spec, frame.data).items()
            }
            for name, value in wanted[spec.name].items():
                step = spec.signals[spec.column(name)].scale
                told = values.pop(name)
                assert (told is None) == (value is None), (spec.name, name)
                assert told is None or abs(told - value) <= 0.501 * abs(step), (spec.name, name)
            rest = {name for name in values if name not in ("Crc", "Counter")}
            assert all(values[name] in (0, None) for name in rest), "of drives that there are not"


def names(codec, frames):
    return [codec.by_id[f.can_id].name for f in frames]


def test_each_goes_out_in_its_cycle_and_faults_at_a_change_too():
    codec = codec_for(NODES)
    box, words = Outbox(codec, NODES, 0, TICK), unknown_status(N, 1)
    sent = {}
    for tick in range(300):
        if tick == 155:
            words.drives["flag"]["state"][1, FlagKind.THERMAL] = 2
        if tick == 163:
            words.train["comm"] = 1
        if box.wants_counts(tick * TICK):
            box.note_counts(COUNTED)
        for name in names(codec, box.due(words, tick * TICK)):
            sent.setdefault(name, []).append(tick)
    assert sent["Gateway_Adhesion"] == list(range(300))
    assert sent["Drive1_Estimate"] == list(range(0, 300, 2))
    assert sent["Gateway_Info"] == [0, 100, 200]
    assert sent["Gateway_Status"] == list(range(0, 300, 10))
    assert sent["Gateway_Faults"] == [*range(0, 151, 10), 155, 163, *range(173, 300, 10)]


def test_the_grid_stays_however_late_a_tick_is():
    codec = codec_for(NODES)
    box, words = Outbox(codec, NODES, 0, TICK), unknown_status(N, 1)
    ticks = (0, 1, 9, 10, 31, 39, 47, 52)
    sent = [t for t in ticks if "Gateway_Status" in names(codec, box.due(words, t * TICK + t % 3))]
    assert sent == [0, 10, 31, 47, 52]


def test_the_loop_is_the_same_function_uncompiled(monkeypatch):
    codec, made = codec_for(NODES), []
    for kernel in (send, send.py_func):
        monkeypatch.setattr(module, "send", kernel)
        box, rng = Outbox(codec, NODES, 0x123456, TICK), np.random.default_rng(5)
        out = []
        for tick in range(40):
            box.note_counts(COUNTED)
            with np.errstate(over="ignore"):
                out += box.due(drawn(rng), tick * TICK)
        made.append(out)
    assert made[0] == made[1]
