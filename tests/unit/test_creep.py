"""`Drive{n}_Adhesion`: creep and utilisation against the reference, the truth, and cantools."""

import cantools
import numpy as np
import pytest
from _traction_core import lib

from dbc.codec import bind
from dbc.frame import Frame
from dbc.records import ADHESION, DRIVE_STATUS, ROTOR, ROTOR_INPUTS, pointer
from dbc.wire_time import longest_seconds
from gateway.commands.check import bus_load
from gateway.core.codes import Flag, Health
from gateway.core.flags import FlagKind, unknown_status
from gateway.core.gateway import Gateway
from gateway.core.transmit import Outbox
from gateway.io.permission import Mode, allowed
from gateway.settings.config import BENCH_MOTOR, TRACTION_350KW, ConfigError, parse
from tests.creep_truth import run
from tests.dbc_text import without
from tests.reference import creep as reference
from tests.sender import CLASSIC, FD_FILE, MS, codec_for

TICK_S = 0.01
OUT = ("creep", "creep_sigma", "utilisation", "utilisation_sigma")
ON = {"adhesion": {"send_creep": True}}


# ---- the function


def core(n, motors):
    """Records of n drives, and the `struct adhesion` over them."""
    rotors, inputs, status = (
        np.zeros(n, ROTOR),
        np.zeros(n, ROTOR_INPUTS),
        np.zeros(n, DRIVE_STATUS),
    )
    rotors["rated_nm"] = [m.T_rated for m in motors]
    rotors["inertia_kg_m2"] = [m.J for m in motors]
    rotors["motor"] = [motors.index(m) for m in motors]
    lib.train_reset(pointer("struct rotor", rotors), n)
    a = np.zeros(1, ADHESION)
    a["n"], a["tick_s"] = n, TICK_S
    a["rotors"], a["rotor_inputs"] = rotors.ctypes.data, inputs.ctypes.data
    return a, rotors, inputs, status


def draw(rng, rotors, inputs, status, train):
    """What the stations before leave of a tick: mostly wheels near their train, and anything."""
    n = len(rotors)
    turning = train * (1.0 + rng.choice([0.0, 0.01, -0.02, 0.3, -1.0, -1.4, 5.0], n))
    inputs["measured_rad_s"] = np.where(rng.random(n) < 0.3, np.nan, turning)
    inputs["speed_rad_s"] = turning + rng.normal(0.0, 0.1, n)
    rotors["speed"] = np.where(
        rng.random(n) < 0.1, rng.choice([np.nan, np.inf, 1e300]), np.abs(turning)
    )
    rotors["load"] = np.where(rng.random(n) < 0.2, np.nan, rng.normal(0.0, 1.0, n))
    rotors["train_speed"] = np.where(
        rng.random(n) < 0.05, rng.choice([np.nan, 3.0, 2.9]), abs(train)
    )
    status["flag"]["state"][:, FlagKind.ADHESION] = rng.integers(0, 3, n)
    status["load_nm"] = np.where(rng.random(n) < 0.2, np.nan, rng.normal(0.0, 30.0, n))
    status["load_sigma_nm"] = rng.choice([np.nan, 0.0, 0.1, 1.0, 60.0, np.inf], n)


def given(rotors, inputs, status):
    """The same for the reference."""
    measured = inputs["measured_rad_s"]
    return reference.Wheels(
        rotors["motor"].astype(np.int64), rotors["rated_nm"], rotors["inertia_kg_m2"],
        rotors["speed"], np.where(np.isnan(measured), inputs["speed_rad_s"], measured),
        rotors["train_speed"], ~np.isnan(rotors["load"]),
        status["flag"]["state"][:, FlagKind.ADHESION] == Flag.GOOD, status["load_nm"],
        status["load_sigma_nm"],
    )  # fmt: skip


@pytest.mark.parametrize("n", [1, 2, 3, 7, 16])
@pytest.mark.filterwarnings("ignore:.*encountered:RuntimeWarning")
def test_anything_is_as_the_reference_has_it(n):
    rng = np.random.default_rng(n)
    motors = [(BENCH_MOTOR, BENCH_MOTOR, TRACTION_350KW)[k % 3] for k in range(n)]
    a, rotors, inputs, status = core(n, motors)
    memory = reference.Memory(*np.zeros((2, n)), np.zeros(n, np.int64))
    known = np.zeros(4, np.int64)
    for tick in range(3000):
        if tick % 40 == 0:
            train, adhering = rng.choice([0.0, 4.0, 60.0, -60.0]), rng.random() < 0.5
        draw(rng, rotors, inputs, status, train)
        if not adhering:
            status["flag"]["state"][:, FlagKind.ADHESION] = Flag.BAD
        wanted = reference.estimate(given(rotors, inputs, status), memory, TICK_S)
        lib.estimate_creep(pointer("struct adhesion", a), pointer("struct drive_status", status))
        for name, one in zip(OUT, wanted, strict=True):
            np.testing.assert_allclose(status[name], one, rtol=1e-12, atol=1e-15, err_msg=name)
        np.testing.assert_array_equal(rotors["way"], memory.way)
        known += (~np.isnan(wanted)).sum(axis=1)
    assert (known > 200 * n).all(), "the draws know something"
    assert (known < 2900 * n).all(), "and not everything"


def test_a_load_without_its_sigma_is_not_known():
    a, _rotors, _inputs, status = core(1, [BENCH_MOTOR])
    status["load_nm"], status["load_sigma_nm"] = 15.0, np.nan
    lib.estimate_creep(pointer("struct adhesion", a), pointer("struct drive_status", status))
    assert np.isnan(status["utilisation"][0])
    status["load_sigma_nm"] = 0.0
    lib.estimate_creep(pointer("struct adhesion", a), pointer("struct drive_status", status))
    assert (status["utilisation"][0], status["utilisation_sigma"][0]) == (0.5, 0.005)


# ---- the truth


@pytest.mark.parametrize(("world", "family", "seeds"), [
    ("ours", "slide_slow_limiter", (1000, 1001)), ("ours", "all_together", (1001,)),
    ("ours", "slide_no_limiter", (1000, 1002)), ("roller", "roller_slow", (1000, 1001)),
])  # fmt: skip
def test_the_truth_lies_within_two_sigma(world, family, seeds, monkeypatch):
    runs = [run(world, family, seed, monkeypatch) for seed in seeds]
    for name, least in (("Creep", 0.6), ("Utilisation", 0.9)):
        within, known = np.sum([one.within(name) for one in runs], axis=0)
        assert within >= 0.9 * known, name
        assert known >= least * sum(one.creep.size for one in runs), "unknown is no way out"
    assert max(np.nanmax(np.abs(one.creep)) for one in runs) > 0.05, "a wheel slid"
    sigmas = [np.concatenate([one.sent[f"{n}Sigma"].ravel() for one in runs])
              for n in ("Creep", "Utilisation")]  # fmt: skip
    assert np.nanmedian(sigmas[0]) <= 1.5
    assert np.nanmedian(sigmas[1]) <= 4.0, "wide enough is no way out"
    assert any((one.sent["Quality"] == 1).any() for one in runs)


# ---- the message


@pytest.mark.parametrize("file", [CLASSIC, FD_FILE])
def test_cantools_reads_what_is_sent(file):
    database, codec = cantools.database.load_file(file), codec_for((2, 5), file)
    rng = np.random.default_rng(4)
    for k in range(200):
        words = unknown_status(2, 5)
        for name, most in zip(OUT, (4.0, 0.25, 7.0, 1.3), strict=True):
            least = -most if name == "creep" else 0.0
            words.drives[name] = np.where(rng.random(2) < 0.3, np.nan, rng.uniform(least, most, 2))
        words.drives["health"] = rng.integers(0, 6, 2)
        box = Outbox(codec, (2, 5), 0, 10 * MS, creep=True)
        box.messages["counter"] = k
        sent = [f for f in box.due(words, 0) if f.can_id in (0x302, 0x305)]
        assert len(sent) == 2
        for drive, frame in zip(words.drives, sent, strict=True):
            read = database.decode_message(frame.can_id, frame.data, decode_choices=False)
            assert read["Counter"] == k % 16
            again = database.encode_message(frame.can_id, read, strict=False)
            assert again == frame.data
            for name, signal, step, ends in (
                ("creep", "Creep", 0.01, 327.66), ("creep_sigma", "CreepSigma", 0.1, 25.4),
                ("utilisation", "Utilisation", 0.01, 655.34),
                ("utilisation_sigma", "UtilisationSigma", 0.5, 127.0),
            ):  # fmt: skip
                value = drive[name]
                if np.isnan(value):
                    assert read[signal] == pytest.approx(ends + step), "the not-available code"
                else:
                    assert read[signal] == pytest.approx(
                        np.clip(100.0 * value, -ends, ends), abs=0.501 * step)  # fmt: skip
            known = (~np.isnan(drive["creep"])).astype(int) + ~np.isnan(drive["utilisation"])
            tracks = drive["health"] == Health.TRACKING
            none = 0 if drive["health"] == Health.CONVERGING else 15
            assert read["Quality"] == ((1 if known == 2 and tracks else 2) if known else none)


def sent_by(config, ticks=4):
    """Identifiers of what a gateway sends in so many ticks of 10 ms."""
    gateway = Gateway(config, bind(config.dbc_path, config.nodes), 0)
    return [f.can_id for k in range(ticks) for f in gateway.step([], k * 10 * MS)]


def test_it_is_sent_every_20_ms_and_only_where_it_is_asked_for():
    off, on = sent_by(parse({})), sent_by(parse(ON))
    assert [on.count(0x300 + n) for n in (1, 2, 3)] == [2, 2, 2]
    assert [i for i in on if i not in (0x301, 0x302, 0x303)] == off
    assert parse({"adhesion": {"send_creep": False}}).hash24() == parse({}).hash24()
    assert parse(ON).hash24() != parse({}).hash24()


@pytest.mark.parametrize("raw", [{}, ON])
def test_the_identifiers_are_the_gateways_own_only_where_it_sends_them(raw):
    config = parse(raw)
    codec = bind(config.dbc_path, config.nodes)
    gateway = Gateway(config, codec, 0)
    foreign = Frame(0, 0x301, bytes(8))
    gateway.step([foreign], 0)
    assert gateway.inbox.receiver.pointer.tick.own == bool(raw)
    assert allowed(Mode.RUN, config, codec).permits(foreign) == bool(raw)


def test_the_bus_load_of_check_counts_it():
    loads = [bus_load(bind(c.dbc_path, c.nodes), c) for c in (parse({}), parse(ON))]
    spec = codec_for((1, 2, 3)).by_name["Drive1_Adhesion"]
    more = 100.0 * 3 * 50 * longest_seconds(spec.length, 1_000_000)
    assert loads[1] - loads[0] == pytest.approx(more)
    assert 1.5 < more < 2.5


def test_a_dbc_without_it_is_good_until_it_is_asked_for(tmp_path):
    text = CLASSIC.read_text(encoding="ascii")
    for n in range(1, 17):
        text = without(text, f"Drive{n}_Adhesion")
    (tmp_path / "mine.dbc").write_text(text, encoding="ascii")
    own = {"dbc": {"file": "mine.dbc"}}
    assert 0x500 + 1 in sent_by(parse(own, base=tmp_path))
    with pytest.raises(ConfigError) as refused:
        sent_by(parse({**own, **ON}, base=tmp_path))
    assert len(refused.value.problems) == 3
    assert "Drive1_Adhesion: message missing; take it from the shipped DBC" in str(refused.value)
