"""Inverters with messages of their own: mapped, translated, judged; what `check` says of them."""

import math
from bisect import bisect_right
from collections import Counter
from pathlib import Path

import pytest

from dbc.candump.reader import Reader
from gateway.cli import main
from gateway.core.codes import Flag, Reason
from gateway.core.gateway import Gateway
from gateway.mapping.plan import fitted, plans
from gateway.mapping.translate import Translator
from gateway.settings import calibration
from gateway.settings.config import ConfigError, load, parse
from sim.simulation import Simulation
from tests.inverters import spoken, write_dbc
from tests.simrun import TICK, by_tick, codec, run, scenario

ROOT = Path(__file__).parents[2]
EXAMPLES = sorted((ROOT / "examples" / "inverters").glob("*.toml"))
FORMS = {
    "phases": (("Ia", "Ib", "Ic"), ("Ualpha", "Ubeta")),
    "two phases": (("Ia", "Ib"), ("Ualpha", "Ubeta")),
    "stator": (("Ialpha", "Ibeta"), ("Ualpha", "Ubeta")),
    "rotor": (("Id", "Iq", "ElectricalAngle"), ("Ud", "Uq")),
}


def signed(name, at, scale=0.1):
    return f'{name} : {at}|16@1- ({scale},0) [{-32766 * scale}|{32766 * scale}] ""'


def mapped(tmp, form="phases", cycle=2, drives=3, **more):
    """Drives that send this form of currents and voltages, and the rest, on messages of theirs."""
    currents, voltages = FORMS[form]
    ids = more.get("ids", 0x600)
    tables = []
    for n in range(1, drives + 1):
        write_dbc(tmp / f"{n}.dbc", {
            "Cur": (ids + 16 * n, cycle, [*(signed(name, 16 * k, 0.02)
                    if name != "ElectricalAngle" else f'{name} : 32|16@1+ (0.01,0) [0|360] "deg"'
                    for k, name in enumerate(currents)), 'Counter : 48|4@1+ (1,0) [0|15] ""']),
            "Vol": (ids + 1 + 16 * n, cycle, [signed(v, 16 * k) for k, v in enumerate(voltages)]),
            "Mot": (ids + 2 + 16 * n, 10, [signed("Speed", 0, 0.5), signed("Torque", 16)]),
            "Tmp": (ids + 3 + 16 * n, 100, [signed("Tstator", 0), signed("Tde", 16)]),
        })  # fmt: skip
        use = {name: f"Cur.{name}" for name in currents}
        use |= {name: f"Vol.{name}" for name in voltages}
        use |= {"Speed": "Mot.Speed", "Torque": "Mot.Torque"}
        use |= {"Tstator": "Tmp.Tstator", "Tde": "Tmp.Tde"}
        use |= more.get("use", {})
        use = {k: v for k, v in use.items() if k not in more.get("without", ())}
        tables.append({"node": n, "signals": {"dbc": f"{n}.dbc", "use": use}})
    return parse({"drive": tables}, base=tmp)


def loss(**more):
    lost = {"at_s": 2.0, "for_s": 1.0, "drive": 1, "kind": "adhesion_loss", "depth": 1.0}
    return scenario(seed=10, duration_s=3.5, drives=3, event=[lost], **more)


@pytest.fixture(scope="module")
def train():
    """What three simulated drives send; the first loses adhesion from 2 to 3 s."""
    return run(Simulation(loss(), codec()), 3.5)


def played(gateway, frames):
    """Adhesion flags tick by tick."""
    out, last = [], max(f.t_ns for f in frames)
    for now, batch in by_tick(frames, range(TICK, last + 1, TICK)):
        gateway.step(batch, now)
        out.append(tuple(drive.adhesion for drive in gateway.view.drives))
    return out


@pytest.mark.parametrize(("form", "cycle"), [
    pytest.param(form, cycle, marks=[pytest.mark.thorough] * (cycle != (2, 10)[k % 2]))
    for k, form in enumerate(FORMS) for cycle in (2, 4, 10)
])  # fmt: skip
def test_a_lost_wheel_is_found_through_foreign_messages(tmp_path, train, form, cycle):
    config = mapped(tmp_path, form, cycle)
    gateway = Gateway(config, codec(), 0)
    said = played(gateway, spoken(config, train))
    assert all(flag is Flag.GOOD for flag in said[150])
    first = [flags[0] for flags in said]
    begin = first.index(Flag.BAD)
    assert 200 <= begin <= 206
    assert all(flag is Flag.BAD for flag in first[begin:299])
    assert first[-1] is Flag.GOOD
    assert not any(Flag.BAD in flags[1:] for flags in said)


def test_mounted_the_other_way_round(tmp_path, train):
    """Signs in the mapping undo signs on the bus."""
    turned = {"Speed": {"signal": "Mot.Speed", "scale": -1.0},
              "Torque": {"signal": "Mot.Torque", "scale": -1.0}}  # fmt: skip
    config = mapped(tmp_path, use=turned)
    theirs = [f for f in spoken(config, train) if f.t_ns <= 2_200_000_000]
    plain = played(Gateway(mapped(tmp_path), codec(), 0), theirs)
    assert Flag.GOOD not in [flags[0] for flags in plain], "speeds contradict currents"
    said = played(Gateway(config, codec(), 0), theirs)
    assert Flag.BAD in [flags[0] for flags in said]
    assert said[150][0] is Flag.GOOD


@pytest.mark.parametrize("without", [("Ualpha", "Ubeta"), ("Ia", "Ib", "Ic")])
def test_without_voltages_or_currents_nothing_is_known(tmp_path, train, without):
    config = mapped(tmp_path, without=without)
    gateway = Gateway(config, codec(), 0)
    said = played(gateway, [f for f in spoken(config, train) if f.t_ns <= 1_000_000_000])
    assert {flag for flags in said for flag in flags} == {Flag.UNKNOWN}
    assert gateway.view.drives[0].adhesion_reason is Reason.CONFIG


def translated(config, frames, now=10**12):
    """What is made for the first drive, decoded: (kind, time in ms, values)."""
    taken = fitted(codec(), plans(config))
    counts = Counter()
    block = Translator(plans(config), taken).translate(frames, now, counts)
    out = []
    for frame in block.frames():
        spec = taken.by_id.get(frame.can_id)
        if spec is not None and spec.node == 1:
            values = {k: r.value if r.validity == 0 else None
                      for k, r in taken.decode(spec, frame.data).items()}  # fmt: skip
            out.append((spec.kind, frame.t_ns / 1e6, values))
    return out, counts


@pytest.mark.parametrize("form", FORMS)
def test_values_arrive_as_they_were(tmp_path, train, form):
    config = mapped(tmp_path, form, drives=1)
    ours = codec()
    first = ours.by_name["Drive1_PhaseCurrents"]
    sent = [f for f in train if f.can_id == first.can_id]
    got, _ = translated(config, spoken(config, train))
    currents = [(t, v) for kind, t, v in got if kind == "PhaseCurrents"]
    assert len(currents) > 1000
    for t, values in currents[100:400]:
        newest = bisect_right([f.t_ns for f in sent], t * 1e6) - 1
        want = ours.decode(first, sent[newest].data)
        assert sum(values[name] for name in ("Ia", "Ib", "Ic")) == pytest.approx(0.0, abs=0.3)
        for name in ("Ia", "Ib", "Ic"):
            assert values[name] == pytest.approx(want[name].value, abs=0.3)


def test_rms_current_and_torque_where_nobody_sends_them(tmp_path, train):
    config = mapped(tmp_path, "rotor", drives=1, without=("Torque",))
    got, _ = translated(config, spoken(config, train))
    ours = codec().by_name["Drive1_Status"]
    sent = [codec().decode(ours, f.data) for f in train if f.can_id == ours.can_id]
    made = [(t, v) for kind, t, v in got if kind == "Status"]
    assert 30 <= len(made) <= 36, "every 100 ms"
    assert made[15][1]["Irms"] == pytest.approx(sent[15]["Irms"].value, rel=0.05)
    motion = codec().by_name["Drive1_Motion"]
    torque = [codec().decode(motion, f.data)["Torque"].value for f in train
              if f.can_id == motion.can_id]  # fmt: skip
    own = [v["Torque"] for kind, _, v in got if kind == "Motion"]
    assert own[150] == pytest.approx(torque[150], rel=0.1), "of the magnets, 1.5 p psi Iq"


def test_a_frame_that_is_missing_is_a_gap(tmp_path, train):
    config = mapped(tmp_path)
    theirs = [f for f in spoken(config, train) if f.t_ns <= 1_500_000_000]
    nth = [k for k, f in enumerate(theirs) if f.can_id == 0x610][500]
    gateway = Gateway(config, codec(), 0)
    played(gateway, theirs[:nth] + theirs[nth + 1 :])
    # Its voltages have nothing to belong to, so that a message of each kind is missing.
    assert gateway.inbox.counts["lost"] == 2
    assert gateway.view.drives[0].adhesion is Flag.GOOD, "bridged"


def test_a_counter_of_theirs_tells_repetition(tmp_path, train):
    config = mapped(tmp_path, use={"Counter": "Cur.Counter"})
    theirs = [f for f in spoken(config, train) if f.t_ns <= 1_500_000_000]
    gateway = Gateway(config, codec(), 0)
    played(gateway, theirs)
    assert not gateway.inbox.counts["repeated"]
    frozen = {}
    again = [
        frozen.setdefault(f.can_id, f)._replace(t_ns=f.t_ns)
        if f.can_id in (0x610, 0x611) and f.t_ns > 1_000_000_000
        else f
        for f in theirs
    ]
    gateway = Gateway(config, codec(), 0)
    said = played(gateway, again)
    assert gateway.inbox.counts["repeated"] > 200
    assert said[-1][0] is Flag.UNKNOWN, "the sender hangs"


def test_not_available_and_power_up_defaults_of_a_real_car():
    config = load(ROOT / "examples" / "inverters" / "hyundai_kona.toml")
    frames = list(Reader(ROOT / "tests/data/temperatures/kona_523.log.gz"))
    on_ms = next(f.t_ns for f in frames if f.data[4] == 0x28) / 1e6
    got, _ = translated(config, frames, now=10**19)
    values = [(t, v["Tstator"]) for kind, t, v in got if kind == "Temperatures"]
    assert all(v is None for t, v in values if t < values[0][0] + 199.0)
    assert {v for t, v in values if values[0][0] + 201.0 < t < on_ms} == {36.0}
    assert all(v is None for t, v in values if 0.0 <= t - on_ms < 199.0), "0 degC at power-up"
    assert {v for t, v in values if t - on_ms > 201.0} <= {36.0, 35.0, 37.0}
    none = [f._replace(data=f.data[:2] + b"\xff" + f.data[3:]) if f.can_id == 0x523 else f
            for f in frames]  # fmt: skip
    got, _ = translated(config, none, now=10**19)
    assert {v["Tstator"] for kind, _, v in got if kind == "Temperatures"} == {None}


def test_nobody_passes_for_the_translator(tmp_path, train):
    """Frames of our own kind from a mapped drive's node are not looked at."""
    config = mapped(tmp_path)
    gateway = Gateway(config, codec(), 0)
    said = played(gateway, [f for f in train if f.t_ns <= 1_000_000_000])
    assert {flag for flags in said for flag in flags} == {Flag.UNKNOWN}
    assert gateway.inbox.counts["decoded"] == 0
    assert gateway.inbox.counts["unknown_id"] > 1000


def among_ours(config, train):
    """Flags where its first drive is one of three, the others being ours."""
    tables = [config.drive[0].model_dump(), {"node": 2}, {"node": 3}]
    both = parse({"drive": tables}, base=config.base)
    return played(Gateway(both, codec(), 0), spoken(both, train))


def test_others_go_on_as_they_are(tmp_path, train):
    said = among_ours(mapped(tmp_path, drives=1), train)
    assert all(flag is Flag.GOOD for flag in said[150])
    assert said[250][0] is Flag.BAD


@pytest.mark.parametrize(("cycle", "motion_ms"), [(2, 3), (2, 20), (10, 2), (10, 5)])
def test_drives_whose_speed_comes_at_another_pace(tmp_path, train, cycle, motion_ms):
    config = mapped(tmp_path, "rotor", cycle, drives=1)
    path = tmp_path / "1.dbc"
    path.write_text(path.read_text().replace("BO_ 1554 10;", f"BO_ 1554 {motion_ms};"))
    said = among_ours(config, train)
    assert all(flag is Flag.GOOD for flag in said[150])
    assert {flags[0] for flags in said[206:299]} == {Flag.BAD}


def problems(config):
    with pytest.raises(ConfigError) as error:
        Gateway(config, codec(), 0)
    return "\n".join(error.value.problems)


def test_everything_wrong_with_a_mapping_is_said_at_once(tmp_path):
    config = mapped(tmp_path, drives=1)
    raw = config.drive[0].model_dump()
    raw["signals"]["use"] |= {"Tnde": {"signal": "Tmp.None"}, "Irms": {"signal": "Nobody.I"}}
    raw["signals"]["cycle_ms"] = {"Other": 5.0}
    text = problems(parse({"drive": [raw]}, base=tmp_path))
    assert "Tmp has no signal 'None'; it has Tstator, Tde" in text
    assert "1.dbc has no message 'Nobody'" in text
    assert "cycle_ms.Other" in text
    silent = write_dbc(tmp_path / "1.dbc", {"Mot": (0x602, 0, [signed("Speed", 0)]),
                                            "Tmp": (0x603, 0, [signed("Tstator", 0)])})  # fmt: skip
    use = {"Tstator": "Tmp.Tstator"}
    text = problems(parse({"drive": [{"node": 1, "signals": {"dbc": silent.name, "use": use}}]},
                          base=tmp_path))  # fmt: skip
    assert "has no cycle time of Tmp: add cycle_ms.Tmp" in text
    text = problems(parse({"drive": [{"node": 1, "signals": {"dbc": "no.dbc", "use": use}}]},
                          base=tmp_path))  # fmt: skip
    assert "no.dbc: no such file" in text


@pytest.mark.parametrize(
    ("use", "said"),
    [
        ({"Ia": "A.B"}, "Ib missing"), ({"Ic": "A.B"}, "Ia, Ib missing"),
        ({"Ud": "A.B", "Uq": "A.C"}, "Ud, Uq need ElectricalAngle"),
        ({"Ia": "A.B", "Ib": "A.C", "Id": "A.D", "Iq": "A.E"}, "in 2 forms"),
        ({"Speed": {"signal": "A.B", "scale": 0.0}}, "is too small"),
        ({"Speed": "AB"}, "expected 'MESSAGE.SIGNAL', got "),
        ({"Sped": "A.B"}, "Speed"), ({}, "expected 1 or more entries"),
    ],
)  # fmt: skip
def test_mappings_that_cannot_be(use, said):
    with pytest.raises(ConfigError) as error:
        parse({"drive": [{"node": 1, "signals": {"dbc": "a.dbc", "use": use}}]})
    assert said in str(error.value)


def test_identifiers_of_the_gateway_and_of_others_are_refused(tmp_path):
    text = (ROOT / "examples" / "inverters" / "cascadia_pm.toml").read_text()
    (tmp_path / "a.toml").write_text(text.replace("id_offset = 0x20", "id_offset = 0"))
    dbc = ROOT / "examples" / "inverters" / "cascadia_pm.dbc"
    (tmp_path / dbc.name).write_bytes(dbc.read_bytes())
    said = problems(load(tmp_path / "a.toml"))
    assert "M160_Temperatures_1 (0xa0) has the identifier of the gateway's emergencies" in said
    (tmp_path / "b.toml").write_text(text.replace("id_offset = 0x40", "id_offset = 0x20"))
    assert "is also used by drive 1" in problems(load(tmp_path / "b.toml"))


def test_the_mapped_file_is_part_of_the_hash_and_needs_a_signature_of_its_own(tmp_path):
    config = mapped(tmp_path, drives=1)
    before = calibration.config_hash(config, "", None)
    path = tmp_path / "1.dbc"
    path.write_text(path.read_text() + "\n")
    assert calibration.config_hash(config, "", None) != before
    sealed = config.model_copy(update={"sealed": {"dbc": "0" * 64}})
    assert "not covered by the signature" in problems(sealed)


def test_scenarios_are_refused_for_a_mapped_drive(refused):
    assert "simulated drives send only this project's message set" in refused(
        "hil", "release", "--config", EXAMPLES[0]
    )


@pytest.mark.parametrize("path", EXAMPLES, ids=lambda p: p.stem)
def test_check_says_what_an_example_can_give(path, capsys):
    currents = "cascadia" in path.name
    assert main(["check", str(path), "--no-timing"]) == (0 if currents else 2)
    said = capsys.readouterr().out
    assert "no counter" in said
    assert ("adhesion: always Unknown" in said) != currents
    assert ("no voltages" in said) != currents
    assert ("by the currents up to 150 rpm" in said) == currents


def test_there_is_an_example_for_every_layout():
    assert len(EXAMPLES) == 7


def test_silence_of_a_drive_without_currents_is_told_and_ends(train):
    config = load(ROOT / "examples" / "inverters" / "sevcon_gen4.toml")
    theirs = [f for f in spoken(config, train) if not 1_000_000_000 < f.t_ns < 2_000_000_000]
    gateway, comm = Gateway(config, codec(), 0), []
    for now, batch in by_tick(theirs, range(TICK, 3_500_000_000, TICK)):
        gateway.step(batch, now)
        comm.append(gateway.view.drives[0].comm)
    assert comm[0] is Flag.UNKNOWN
    assert [comm[t] for t in (90, 150, 340)] == [Flag.GOOD, Flag.BAD, Flag.GOOD]


@pytest.mark.parametrize("path", EXAMPLES, ids=lambda p: p.stem)
def test_an_example_takes_what_such_an_inverter_sends(path, train):
    """And its flags are good only where it can give them."""
    config = load(path)
    theirs = spoken(config, train)
    sent = Counter(f.can_id for f in theirs)
    for plan in plans(config):
        for spec in plan.codec.messages:
            assert sent[spec.can_id] > 3, spec.name
    gateway = Gateway(config, codec(), 0)
    said = played(gateway, theirs)
    assert gateway.inbox.counts["translated"] > 30
    seen = {flag for flags in said for flag in flags}
    if "cascadia" in path.name:
        assert Flag.GOOD in seen
    else:
        assert seen == {Flag.UNKNOWN}
    got, _ = translated(config, theirs)
    temperatures = [v for kind, _, v in got if kind == "Temperatures"]
    if "Tstator" in config.drive[0].signals.use:
        assert 20.0 < temperatures[-1]["Tstator"] < 200.0
    assert not any(math.isnan(x) for _, _, v in got for x in v.values() if x is not None)
