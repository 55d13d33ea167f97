"""Every shipped scenario on the virtual clock: what it expects, holds."""

from types import SimpleNamespace

import numpy as np
import pytest

from dbc.frame import MS
from gateway.core.codes import Flag
from gateway.hil.bench import run_virtual
from gateway.hil.fitting import scenario_thermal
from gateway.io.prepare import prepare
from gateway.reports.record import Changes
from sim.scenario import builtin, builtin_names, parse
from tests.thorough import some

NAMES = [name for name in builtin_names() if not name.startswith("calibration_")]
THERMAL = (
    "bearing", "cold_start", "cooling_loss", "duty_change", "hot_restart", "overheating", "tunnel",
)  # fmt: skip
"""Minutes of temperatures: with everything that drives send before a release only."""


def run(scenario, watch=()):
    config, codec = prepare(None, thermal=scenario_thermal())
    return run_virtual(scenario, config, codec, watch)


@pytest.mark.parametrize(
    ("name", "traffic"),
    [pytest.param(n, "full", marks=[pytest.mark.thorough] * (n in THERMAL)) for n in NAMES]
    + [(name, "slow") for name in THERMAL],
)
def test_expectations_hold(name, traffic):
    """Of temperatures also on the slow messages, which are all that thermal flags are made of."""
    outcome = run(builtin(name).model_copy(update={"traffic": traffic}))
    assert outcome.verdicts
    assert not [v for v in outcome.verdicts if not v.passed]
    counts = outcome.gateway.inbox.counts
    assert counts["received"] > 100


@pytest.mark.parametrize(
    "name", ["runaway_gradual", "runaway_sudden", "slow_limiter", "brake_slide", "brake_lock"]
)
def test_a_wheel_that_slides_is_not_called_good_for_200_ms(name):
    """Beyond 10 % creep, whatever its load: the wheel's speed is the evidence."""
    speed, since, longest = {}, {}, {}

    def really(rows):
        speed.update((row.drive, row.speed_rad_s) for row in rows)

    def watch(now, _rx, _tx, gateway):
        if not speed:
            return
        train = float(np.median(list(speed.values())))
        for drive in gateway.view.drives:
            slides = abs(speed[drive.node] - train) > 0.1 * abs(train)
            if not (slides and drive.adhesion is Flag.GOOD):
                since[drive.node] = now
            beyond = (now - since.get(drive.node, now)) // MS
            longest[drive.node] = max(beyond, longest.get(drive.node, 0))

    config, codec = prepare(None, thermal=scenario_thermal())
    left = SimpleNamespace(begin=lambda _gateway: None, add_truth=really, add_tick=lambda: None)
    run_virtual(builtin(name), config, codec, [watch], left=left)
    assert len(longest) == 3
    assert max(longest.values()) <= 200, longest


@pytest.mark.parametrize("detector", ["vb", "switching"])
@pytest.mark.parametrize("seed", some([13], [14, 15, 16]))
def test_a_drive_that_takes_its_torque_back_is_judged_all_the_time(detector, seed):
    """It says how much it is asked for in every tenth tick only, and the ramp goes on between."""
    event = {"at_s": 2.5, "for_s": 1.0, "drive": 1, "kind": "adhesion_loss", "depth": 1.0}
    scenario = parse({
        "title": "t", "seed": seed, "duration_s": 6.0, "drives": 3, "event": [event],
        "expect": [{"flag": "adhesion", "is": "bad", "drive": 1, "after_s": 2.5, "within_ms": 50}],
    })  # fmt: skip
    seen = []
    config, codec = prepare(None, thermal=scenario_thermal(), adhesion={"detector": detector})
    outcome = run_virtual(
        scenario, config, codec, [lambda now, _rx, _tx, gateway: seen.append((now, gateway.view))]
    )
    assert outcome.passed
    start = seen[0][0]
    after = [d.adhesion for now, view in seen if now - start > 3_560 * MS for d in view.drives]
    assert set(after) == {Flag.GOOD}


@pytest.mark.parametrize("value", [-100.0, -20.0, 40.0, 100.0])
@pytest.mark.parametrize("for_s", some([0.2], [0.1, 0.6]))
def test_a_reading_that_jumps_for_a_moment_makes_no_motor_hot(value, for_s):
    """By MAISD: neither this motor nor, from far below, the others (public report 77)."""
    event = {"at_s": 8.0, "for_s": for_s, "drive": 1, "kind": "sensor_bias", "sensor": "stator",
             "value": value}  # fmt: skip
    never = {"flag": "thermal", "is": "bad", "drive": "all", "never": True}
    scenario = parse({
        "title": "t", "seed": 41, "duration_s": 22.0, "drives": 3, "traffic": "slow",
        "event": [event], "expect": [never],
    })  # fmt: skip
    config, codec = prepare(None, thermal={**scenario_thermal(), "method": "maisd"})
    outcome = run_virtual(scenario, config, codec, ())
    assert outcome.passed, outcome.verdicts
    assert Flag.GOOD in {drive.thermal for drive in outcome.gateway.view.drives}


def test_a_wrong_expectation_fails():
    table = {
        "title": "t",
        "seed": 1,
        "duration_s": 1.0,
        "drives": 2,
        "expect": [{"flag": "adhesion", "is": "bad", "drive": 1, "after_s": 0, "within_ms": 900}],
    }
    outcome = run(parse(table))
    assert not outcome.passed
    assert "not seen" in outcome.verdicts[0].detail


def test_the_same_scenario_gives_the_same_bytes():
    def frames():
        seen = []
        run(builtin("release"), [lambda _now, rx, tx, _gateway: seen.extend((*rx, *tx))])
        return seen

    assert frames() == frames()


def test_a_cut_drive_is_released_and_comes_back_to_full_torque():
    """The loop closed on the bus: lost, cut to 30 %, regained, released within a second, ramped."""
    commands = []
    recorder = Changes()

    def watch(now, _rx, _tx, gateway):
        recorder.add_view(gateway.view)
        commands.append((now / 1e9, gateway.view))

    outcome = run(builtin("release"), [watch])
    changes = [(t / 1e9, word) for t, node, what, word in recorder.changes
               if node == 1 and what == "adhesion"]  # fmt: skip
    lost = [t for t, word in changes if word == "AdhesionLost"]
    back = [t for t, word in changes if word == "Adhering" and t > lost[0]]
    assert 2.0 < lost[0] < 2.05
    assert 4.0 < back[0] < 5.0
    assert len(lost) == 1
    load = {node: outcome.gateway.view.drives[node - 1].load_nm for node in (1, 2)}
    assert load[1] == pytest.approx(load[2], abs=3.0)
