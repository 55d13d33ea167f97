"""`check` sends a synthetic loss through the configuration, and says what is found and when."""

import re
from collections import Counter
from pathlib import Path

import pytest

from dbc.codec import bind
from gateway.cli import main
from gateway.core.codes import Reason
from gateway.hil.measured import Measured
from gateway.hil.synthetic_loss import losses, never
from gateway.mapping import plan as foreign
from gateway.settings.config import load, parse
from tests.unit.test_foreign import mapped

ROOT = Path(__file__).parents[2]
BENCH = {"R_s": 0.28, "L_s": 3.465e-3, "psi_pm": 0.1989, "pole_pairs": 4, "J": 0.04,
         "I_rated": 25.0, "T_rated": 30.0}  # fmt: skip
FOUND = re.compile(r"A loss of 50 % on drive (\d+) is found after (\d+) ms\.")
SOON_MS = 200
"""Of the virtual clock: the next torque command and some debounce."""


def drives(n, motor="bench"):
    return [{"node": k, "motor": motor} for k in range(1, n + 1)]


def tried(config):
    return list(losses(config, bind(config.dbc_path, config.nodes)))


def checked(capsys, path):
    code = main(["check", str(path), "--no-timing"])
    return code, *capsys.readouterr()


def test_the_example_says_when_a_loss_is_found(capsys):
    code, out, err = checked(capsys, ROOT / "examples" / "train.toml")
    assert code == 0, err
    [(drive, after_ms)] = FOUND.findall(out)
    assert drive == "1"
    assert int(after_ms) <= SOON_MS


@pytest.mark.parametrize(
    "raw",
    [
        {"drive": drives(1)},
        {"drive": drives(2)},
        {"drive": drives(16)},
        {"drive": drives(1, "traction_350kw")},
        {"drive": drives(3, "traction_350kw")},
        {"dbc": {"file": "traction_fd.dbc"}, "drive": drives(1)},
        {"dbc": {"file": "traction_fd.dbc"}, "drive": drives(16)},
        {"loop": {"rate_hz": 1000}},
        {"estimator": {"min_speed_rad_s": 150.0}},
        {"adhesion": {"detector": "median", "good_ms": 1000}},
    ],
    ids=str,
)
def test_a_loss_is_found_with_any_sensible_configuration(raw):
    [found] = tried(parse(raw))
    assert found.problem == ""
    assert found.after_ms is not None
    assert 0 < found.after_ms <= SOON_MS


def test_every_motor_has_its_own_loss():
    config = parse({"drive": [{"node": 1}, {"node": 4, "motor": "traction_350kw"}, {"node": 7}]})
    found = tried(config)
    assert [one.node for one in found] == [1, 4]
    assert all(one.after_ms is not None and one.after_ms <= SOON_MS for one in found), found


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("adhesion.raise_ms = 20000", r"adhesion.raise_ms: expected 0 to 500 ms, got 20000"),
        ("adhesion.spread_nm = 70", r"adhesion.spread_nm: expected 0.01 to 6 Nm, got 70"),
        ("adhesion.good_ms = 1e13", r"adhesion.good_ms: expected 0 to 5000 ms, got 1000"),
        ("adhesion.raise_probability = 0.7", r"adhesion.raise_probability: expected 0.71 to"),
        ("adhesion.clear_probability = 0.7", r"adhesion.clear_probability: expected .* to 0.69"),
        ("estimator.process_noise = [1e-4, 1e-4, 1e-5, 1e-6, 5e-324]",
         r"estimator.process_noise.4: expected 1e-05 to 1000 Nm2, got 5e-324"),
    ],
)  # fmt: skip
def test_what_would_never_tell_a_loss_is_refused_with_bounds_and_unit(text, said, capsys, tmp_path):
    path = tmp_path / "train.toml"
    path.write_text(f"{text}\n")
    code, _, err = checked(capsys, path)
    assert code == 2
    assert re.search(said, err), err
    assert len(err.splitlines()) == 1


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"T_rated": 300.0}, r"T_rated: 300 Nm .* I_rated = 25 A, .* = 29.8 Nm"),
        ({"I_rated": 2.5}, r"T_rated: 30 Nm .* I_rated = 2.5 A, .* = 2.98 Nm"),
        ({"R_s": 280.0}, r"R_s: expected 0.0001 to 100 ohm, got 280.0: give .* in ohm"),
        ({"L_s": 3.465}, r"L_s: expected 1e-06 to 2 H, got 3.465: give .* in henry"),
        ({"L_s": 3.465e-6}, r"L_s: 3.465e-06 H with R_s = 0.28 ohm is a time constant of"),
        ({"J": 40.0}, r"J: T_rated = 30 Nm would speed up 40 kg m2 by 0.75 rad/s2"),
        ({"B": 5.0}, r"B: a friction of 5 Nm s takes more than T_rated = 30 Nm"),
        ({"pole_pairs": 400}, r"pole_pairs: expected 1 to 100, got 400"),
    ],
)
def test_numbers_that_are_no_motor_are_named_together(change, said, capsys, tmp_path):
    path = tmp_path / "train.toml"
    lines = "".join(f"{key} = {value}\n" for key, value in {**BENCH, **change}.items())
    path.write_text(f"[motor.bench]\n{lines}")
    code, _, err = checked(capsys, path)
    assert code == 2
    assert re.search(rf"motor\.bench\.{said}", err), err


@pytest.mark.parametrize(
    ("section", "change", "said"),
    [
        ("adhesion", {"detector": "vb", "spread_nm": 70.0}, "adhesion.spread_nm = 70 Nm hides it"),
        ("adhesion", {"raise_ms": 20_000, "raise_severe_ms": 20_000}, "adhesion.raise_ms = 20000"),
        ("estimator", {"process_noise": (5e-324,) * 5}, "estimator.process_noise"),
    ],
)
def test_beyond_the_bounds_nothing_is_found_and_the_key_is_named(section, change, said):
    """What a bound forbids, the synthetic loss finds on its own."""
    config = load(None)
    config = config.model_copy(update={section: getattr(config, section).model_copy(update=change)})
    [found] = tried(config)
    assert found.after_ms is None
    assert said in found.problem


def test_a_current_that_the_dbc_cannot_hold_is_a_configuration_that_fails(capsys, tmp_path):
    """Every number has its bounds, and still no loss would ever be found."""
    path = tmp_path / "train.toml"
    motor = {**BENCH, "R_s": 0.01, "L_s": 1e-4, "I_rated": 2000.0, "T_rated": 2400.0, "J": 10.0}
    lines = "".join(f"{key} = {value}\n" for key, value in motor.items())
    path.write_text(f"[motor.bench]\n{lines}")
    code, out, err = checked(capsys, path)
    assert code == 2
    assert "A loss of 50 % on drive 1 is not found within 1 s." in out
    assert "losses that would not be found: drive 1: the drive is Unknown before the loss" in err
    assert f"reason {Reason.RANGE.name.title()}" in err
    assert "give those signals a larger factor" in " ".join(err.split())


def test_a_flag_without_a_reason_fails():
    """A heavy rotor that is stated to be light is taken for a wheel that lets go."""
    config = load(None)
    bench = config.motors["bench"].model_copy(update={"J": 40.0})
    [found] = tried(config.model_copy(update={"motor": {"bench": bench}}))
    assert found.after_ms is None
    assert re.search(r"drive \d is AdhesionLost \d+ ms before the loss", found.problem)


def test_bus_load_and_timing_are_of_a_whole_second_whatever_the_verdict():
    config = load(None)
    bench = config.motors["bench"].model_copy(update={"J": 40.0})
    wrong = config.model_copy(update={"motor": {"bench": bench}})
    rates = []
    for each in (config, wrong):
        measured = Measured(each)
        [found] = losses(each, bind(each.dbc_path, each.nodes), measured)
        assert (found.after_ms is None) is (each is wrong)
        assert len(measured.times_us) == each.loop.rate_hz
        rates.append(Counter(frame.can_id for frame in measured.frames))
    assert rates[0] == rates[1]
    assert rates[0][0x181] == 500
    assert rates[0][0x701] == rates[0][0x720] == 10


@pytest.mark.parametrize("ids", [0x600, 0x8CFFA500], ids=["11 bits", "29 bits"])
def test_a_mapped_inverter_is_tried_in_its_own_words(tmp_path, ids):
    command = {"TorqueCommand": "Mot.Torque"}
    config = mapped(tmp_path, "rotor", 4, drives=2, use=command, ids=ids)
    found = tried(config)
    assert [one.node for one in found] == [1, 2]
    assert all(one.after_ms is not None and one.after_ms <= SOON_MS for one in found), found


def test_a_torque_in_place_of_the_command_hides_half_a_load(tmp_path):
    for one in tried(mapped(tmp_path, "phases", 2, drives=3)):
        assert one.after_ms is None
        assert "map TorqueCommand" in one.problem


@pytest.mark.parametrize(
    ("without", "said"),
    [(("Ia", "Ib", "Ic"), "no phase currents"), (("Ualpha", "Ubeta"), "no voltages")],
)
def test_a_drive_that_can_never_be_judged_is_not_tried(tmp_path, without, said):
    config = mapped(tmp_path, without=without, drives=2)
    codec = bind(config.dbc_path, config.nodes)
    assert never(config, foreign.fitted(codec, foreign.plans(config))) == {1: said, 2: said}
    assert tried(config) == []


def test_check_says_that_nothing_was_tried_and_why(capsys):
    code, out, err = checked(capsys, ROOT / "examples" / "inverters" / "bamocar_d3.toml")
    assert code == 2
    assert "drive 1: no adhesion flag from this inverter: no electrical angle" in err
    assert "always Unknown: no electrical angle, no voltages" in out
    assert "not simulated: every drive is always Unknown" in out
    assert not FOUND.search(out)


def test_a_motor_that_the_simulator_cannot_follow_is_named_as_the_cause():
    """48 pole pairs on a rotor of 0.011 kg m2: rotor and current swing at some kHz."""
    motor = {
        "R_s": 0.1353352832366127, "L_s": 0.0005286534501430184, "psi_pm": 1.0, "pole_pairs": 48,
        "I_rated": 1.0, "T_rated": 72.0, "J": 0.01098565761367104,
    }  # fmt: skip
    config = parse({
        "drive": [{"node": 1, "motor": "x"}], "motor": {"x": motor}, "adhesion": {"good_ms": 0}
    })  # fmt: skip
    (found,) = losses(config, bind(config.dbc_path, config.nodes))
    assert found.after_ms is None
    assert "the simulator cannot follow it" in found.problem
