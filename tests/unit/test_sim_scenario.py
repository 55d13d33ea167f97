import numpy as np
import pytest

from gateway.study.scenarios_random import random_scenario
from sim.faults import Schedule
from sim.physics.plant import BENCH
from sim.profile import Profile
from sim.scenario import ScenarioError, builtin, builtin_names, find, load, parse, parse_text

MINIMAL = {"title": "t", "duration_s": 1.0}
BRAKE = {"at_s": 0.5, "kind": "friction_brake"}
REQUIRED = {
    "paper_section5", "wet_one", "leaves_all", "bearing", "cooling_loss", "stuck_sensor",
    "silent", "lossy_bus", "release", "healthy", "demo",
}  # fmt: skip


def problems(table):
    with pytest.raises(ScenarioError) as caught:
        parse(table, "x.toml")
    assert str(caught.value) == "x.toml: " + "; ".join(caught.value.problems)
    return caught.value.problems


def test_minimal_file_has_sensible_defaults():
    s = parse(MINIMAL)
    assert (s.drives, s.load.kind, s.motion.speed, s.traffic) == (3, "rail", 100.0, "full")
    assert 15 <= s.load.torque_nm <= 20
    assert s.event == []


def test_all_builtin_scenarios_load_and_expect_something():
    assert set(builtin_names()) >= REQUIRED
    for name in REQUIRED:
        s = builtin(name)
        assert s.title
        assert s.expect
        assert s.duration_s <= 90


def test_every_problem_is_listed_with_its_path():
    found = problems({
        "title": "t",
        "duration_s": -1,
        "nonsense": 1,
        "event": [
            {"at_s": 0, "kind": "rail"},
            {"at_s": 0, "kind": "adhesion_loss", "depth": 3, "bar": 1, "drive": "both"},
        ],
        "motion": {"zz": 1},
        "expect": [{"flag": "adhesion", "is": "bad", "never": True, "within_ms": 5}],
    })  # fmt: skip
    text = "\n".join(found)
    for part in (
        "duration_s: ", "nonsense: unknown key", "event[0]: rail needs value",
        "event[1].depth: ", "event[1].bar: unknown key", "event[1].drive: ",
        "motion.zz: unknown key", "expect[0]: within_ms and never",
    ):  # fmt: skip
        assert part in text
    assert len(found) == 8
    found = problems(
        {"title": "t", "duration_s": 1, "exspect": [], "event": [{"at": 0, "kind": "rail"}]}
    )
    assert "exspect: unknown key; did you mean 'expect'?" in found
    assert "event[0].at: unknown key; did you mean 'at_s'?" in found


@pytest.mark.parametrize(
    ("event", "message"),
    [
        ({"kind": "adhesion_loss"}, "needs depth"),
        ({"kind": "adhesion_loss", "value": 1.0}, "needs depth"),
        ({"kind": "silent", "depth": 1.0}, "takes neither"),
        ({"kind": "overheating"}, "needs depth or value"),
        ({"kind": "rail", "value": "ice"}, "unknown rail condition"),
        ({"kind": "rail", "value": 7.0}, "outside"),
        ({"kind": "sensor_bias", "value": "much"}, "value: expected a number"),
        ({"kind": "silent", "sensor": "stator"}, "sensor: belongs to"),
        ({"kind": "bearing", "value": 5.0, "sensor": "stator"}, "a bearing is at"),
        ({"kind": "silent", "ramp_s": 0.1}, "ramp_s: belongs"),
        ({"kind": "adhesion_loss", "depth": 1.0, "for_s": 0.1, "ramp_s": 0.06}, "two ramps"),
        ({"kind": "explosion"}, "event[0].kind"),
        ({"kind": "silent", "drive": 4}, "event[0].drive: 4 is not one of the nodes 1, 2, 3"),
        ({"kind": "silent", "at_s": float("nan")}, "event[0].at_s"),
    ],
)
def test_events_that_make_no_sense_are_refused(event, message):
    assert message in "\n".join(problems({**MINIMAL, "event": [{"at_s": 0.0, **event}]}))


def test_files_and_names(tmp_path):
    file = tmp_path / "one.toml"
    file.write_text('title = "one"\nduration_s = 2\n')
    assert load(file).title == "one"
    assert find(str(file)) == load(file)
    assert find("healthy") == builtin("healthy")
    with pytest.raises(ScenarioError, match="no such file or scenario"):
        find("unheard_of")
    with pytest.raises(ScenarioError, match="no such file; there are bearing, "):
        find(str(tmp_path / "missing.toml"))
    with pytest.raises(ScenarioError, match="not TOML"):
        parse_text("title = ")
    (tmp_path / "binary.toml").write_bytes(b"\xff\xfe")
    with pytest.raises(ScenarioError, match="cannot be read"):
        load(tmp_path / "binary.toml")


def test_others_are_the_drives_no_event_names():
    s = parse({**MINIMAL, "event": [{"at_s": 0, "drive": 2, "kind": "silent"}]})
    assert s.drives_of("others") == (1, 3)
    assert s.drives_of("all") == (1, 2, 3)
    assert s.drives_of(2) == (2,)


def test_paper_section_5_loads():
    s = builtin("paper_section5")
    k = np.arange(20001)
    t = k * 125e-6
    healthy = Profile(s, 4).at(t)[2]
    load_1 = healthy * Schedule(s, BENCH).carry(t, healthy)[:, 0]
    assert healthy[7000] == pytest.approx(10.0)
    assert healthy[8000] == pytest.approx(15.0)
    assert healthy[8030] == pytest.approx(10 + 10 * 0.841345, rel=1e-4)
    assert healthy[20000] == pytest.approx(30.0)
    np.testing.assert_array_equal(load_1[500:1500], 0.0)
    np.testing.assert_array_equal(load_1[10000:12000], 0.0)
    window = 30.0 - 10.0 * np.sin(np.pi * (k[17000:18000] - 17000) / 1000)
    np.testing.assert_allclose(load_1[17000:18000], window, atol=1e-9)
    rest = np.ones(20001, bool)
    for a, b in ((500, 1500), (10000, 12000), (17000, 18000)):
        rest[a:b] = False
    np.testing.assert_array_equal(load_1[rest], healthy[rest])
    np.testing.assert_array_equal(Schedule(s, BENCH).carry(t, healthy)[:, 1:], 1.0)


def test_speed_profile():
    s = parse({**MINIMAL, "motion": {"profile": [[1, 0], [3, 600]], "unit": "rpm"}})
    w, slope, _ = Profile(s, 4).at(np.array([0.0, 1.5, 2.0, 5.0]))
    np.testing.assert_allclose(w, np.array([0, 150, 300, 600]) * np.pi / 30)
    np.testing.assert_allclose(slope, [0, 10 * np.pi, 10 * np.pi, 0])
    w, _, _ = Profile(parse(MINIMAL), 4).at(np.zeros(1))
    assert w[0] == 25.0


def test_ramped_loss_lies_inside_its_event():
    event = {"at_s": 1.0, "for_s": 1.0, "drive": 1, "kind": "adhesion_loss", "depth": 0.8,
             "ramp_s": 0.2}  # fmt: skip
    s = Schedule(parse({**MINIMAL, "duration_s": 3.0, "event": [event]}), BENCH)
    t = np.array([0.99, 1.1, 1.2, 1.5, 1.9, 2.0])
    carry = s.carry(t, np.full(6, 18.0))
    np.testing.assert_allclose(carry[:, 0], [1, 0.6, 0.2, 0.2, 0.6, 1], atol=1e-9)
    np.testing.assert_array_equal(carry[:, 1], 1.0)
    assert [bool(s.losing(float(x))[0]) for x in t] == [False, True, True, True, True, False]


def test_random_scenarios_are_reproducible_and_cover_their_ranges():
    runs = [random_scenario(seed) for seed in range(60)]
    assert runs == [random_scenario(seed) for seed in range(60)]
    speeds = np.array([r.motion.speed for r in runs])
    loads = np.array([r.load.torque_nm for r in runs])
    depths = np.array([r.event[0].depth for r in runs])
    lengths = np.array([r.event[0].for_s for r in runs])
    for sample, low, high in ((np.abs(speeds), 40, 250), (np.abs(loads), 8, 30),
                              (depths, 0.2, 1.0), (lengths, 0.1, 2.0)):  # fmt: skip
        assert low <= sample.min() < low + 0.15 * (high - low)
        assert high - 0.15 * (high - low) < sample.max() <= high
    for sign in (speeds > 0, loads > 0):
        assert 0.25 < sign.mean() < 0.75
    assert {r.event[0].drive for r in runs} == {1, 2, 3}


@pytest.mark.parametrize(
    ("extra", "said"),
    [
        (
            {"event": [{"at_s": 5, "kind": "silent"}]},
            "event[0].at_s: 5 s is not a tick (0.01 s) before",
        ),
        (
            {"expect": [{"flag": "comm", "is": "bad", "after_s": 7, "never": True}]},
            "expect[0].after_s: 7 s is not a tick (0.01 s) before the end at 5 s: it would have no",
        ),
        (
            {"event": [{"at_s": 1, "for_s": 1e-9, "kind": "silent"}]},
            "event[0].for_s: expected 0.001",
        ),
        (
            {"event": [{"at_s": 1, "kind": "overheating", "value": 1e300}]},
            "event[0].value: expected -1000000 to 1000000, got 1e+300",
        ),
        ({"bus": {"bitrate": 5}}, "bus.bitrate: expected 10000 to 1000000 bit/s, got 5"),
        ({"load": {"share": 0.0}}, "load.share: expected 0.01 to 100, got 0.0"),
        ({"load": {"share": [1, 1, 1e9]}}, "load.share[2]: expected 0.01 to 100"),
        ({"motion": {"profile": [[0, 1e9]]}}, "motion.profile[0][1]: expected -1000000 to"),
        ({"thermal": {"start": 1e6}}, "expected -60 to 300 degC, got 1000000.0"),
        ({"duration_s": 1e9}, "duration_s: expected 0.01 to 10000000 s"),
        ({"seed": 2**70}, "seed: expected 0 to "),
        # Of drives that are unlike, and of slip limiters and brakes.
        ({"mismatch": {"R_s": [1.0, 2.0]}}, "mismatch.R_s: 2 numbers for 3 drives"),
        ({"load": {"share": [1.0]}}, "load.share: 1 numbers for 3 drives"),
        ({"mismatch": {"L_s": -1.0}}, "mismatch.L_s: expected 0.01 to 100, got -1.0"),
        ({"mismatch": {"J": 1.0}}, "mismatch.J: unknown key"),
        ({"load": {"share_within": 1.0}}, "load.share_within: "),
        ({"load": {"curve": [{"drive": 4, "at_s": 0, "for_s": 1, "amount": 0}]}}, "load.curve[0]"),
        ({"traffic": "slow", "load": {"share": 1.1}}, "traffic = 'slow' does not support"),
        ({"traffic": "slow", "event": [{"at_s": 0, "kind": "phase_open"}]}, "does not support"),
        ({"event": [{"at_s": 0, "kind": "phase_open", "depth": 1.0}]}, "takes neither"),
        ({"slip_limiter": "off"}, "slip_limiter: "),
        ({"slip_limiter": "none", "load": {"kind": "preset"}}, "need a wheel on the rail"),
        ({"slip_limiter": "slow", "traffic": "slow"}, "need a wheel on the rail"),
        (
            {"event": [{**BRAKE, "value": 5.0}], "load": {"kind": "preset"}},
            "need a wheel on the rail",
        ),
        ({"event": [{**BRAKE, "value": 5.0}], "traffic": "slow"}, "need a wheel on the rail"),
        (
            {"event": [{**BRAKE, "value": -1.0}]},
            "event[0].value: expected more than 0, got -1: friction drives no wheel",
        ),
        ({"event": [BRAKE]}, "event[0]: friction_brake needs depth or value"),
        (
            {"event": [{**BRAKE, "value": 5.0, "depth": 0.5}]},
            "event[0]: friction_brake needs depth or value",
        ),
        (
            {"event": [{**BRAKE, "value": "dry"}]},
            "event[0].value: expected a number for friction_brake, got 'dry'",
        ),
        # Whatever the words are.
        ({"motor": {"name": "none"}}, ""),
        ({"load": {"rail": "ice"}}, ""),
        ({"load": {"profile": [[0, 1], [0, 2]]}}, ""),
        ({"load": {"disturbance": [{"drive": 1, "at_s": 0, "for_s": 1, "amplitude_nm": 1}]}}, ""),
        ({"motion": {"profile": [[1, 1], [0, 2]]}}, ""),
        ({"drives": 17}, ""),
        ({"expect": [{"flag": "comm", "is": "good", "drive": 9}]}, ""),
        ({"thermal": {"start": "hot"}}, ""),
    ],
)
def test_tables_that_make_no_sense_are_refused(extra, said):
    assert said in "\n".join(problems({**MINIMAL, "duration_s": 5, **extra}))


@pytest.mark.parametrize(("table", "message"), [
    ({"nodes": []}, "nodes: expected 1 or more entries"),
    ({"nodes": [5, 5]}, "nodes: expected 2 different numbers"),
    ({"nodes": [5, 7], "drives": 3}, "nodes: expected 3 different numbers"),
    ({"nodes": [0]}, "nodes[0]: expected 1 to 16"),
    ({"nodes": list(range(1, 18))}, "nodes[16]: expected 1 to 16"),
    ({"nodes": 5}, "nodes: expected a list"),
    ({"drives": "x"}, "drives: expected a whole number"),
    ({"nodes": [5, 7], "load": {"curve": [{"drive": 1, "at_s": 0.0, "for_s": 0.5, "amount": 0.1}]}},
     "load.curve[0].drive: 1 is not one of the nodes 5, 7"),
])  # fmt: skip
def test_nodes_that_make_no_sense_are_refused_in_one_line(table, message):
    (line,) = problems({**MINIMAL, **table})
    assert message in line
