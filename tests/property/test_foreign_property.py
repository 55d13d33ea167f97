"""A mapped drive under hostile frames: good only on what really came, and nothing ever raises."""

from collections import Counter
from functools import cache

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from dbc.frame import ERROR, EXTENDED, FD, REMOTE, Frame
from gateway.core.codes import Flag
from gateway.core.gateway import Gateway
from gateway.mapping.plan import fitted, plans
from gateway.mapping.translate import Translator
from sim.simulation import Simulation
from tests.inverters import spoken
from tests.simrun import TICK, by_tick, codec, run, scenario
from tests.unit.test_foreign import FORMS, mapped

IDS = [0x600 + 16 * n + k for n in (1, 2, 3) for k in range(5)] + [0x181, 0x281, 0x381]
frames = st.builds(
    Frame,
    st.integers(-10, 3_000_000_000),
    st.sampled_from(IDS),
    st.binary(max_size=64),
    st.sampled_from([0, 0, 0, FD, REMOTE, ERROR, EXTENDED]),
    st.just(""),
    st.just(-1),
)


@pytest.fixture(scope="module")
def config_of(tmp_path_factory):
    """The configuration of each form."""
    return cache(lambda form: mapped(tmp_path_factory.mktemp("dbc"), form))


@pytest.fixture(scope="module")
def train(config_of):
    """What three drives send in each form, by the tick."""
    sent = run(Simulation(scenario(seed=3, duration_s=1.5, drives=3), codec()), 1.5)
    ticks = range(TICK, 1_500_000_000, TICK)
    return cache(lambda form: list(by_tick(spoken(config_of(form), sent), ticks)))


@given(st.sampled_from(sorted(FORMS)), st.lists(frames, max_size=60), st.data())
@settings(max_examples=60, deadline=None)
def test_anything_may_come(config_of, form, hostile, data):
    """Every frame ends in a counter, and what is made of it has a checksum that the core takes."""
    config = config_of(form)
    planned = plans(config)
    taken, counts = fitted(codec(), planned), Counter()
    now = data.draw(st.integers(0, 2_000_000_000))
    made = Translator(planned, taken).translate(hostile, now, counts)
    own = {spec.can_id for plan in planned for spec in plan.spec.values()}
    passed = [f for f in made.frames() if f.flags != FD or f.can_id not in own]
    assert len(passed) + sum(counts.values()) == len(hostile), "each is passed on or counted"
    assert all(f in hostile for f in passed)
    assert not [f for f in passed if not f.flags & (ERROR | EXTENDED) and f.can_id in own]
    gateway = Gateway(config, codec(), 0)
    gateway.step(hostile, now)
    assert all(drive.adhesion is Flag.UNKNOWN for drive in gateway.view.drives)


@given(
    st.sampled_from(sorted(FORMS)),
    st.sampled_from(["Cur", "Vol", "Mot"]),
    st.sampled_from(["silent", "garbage", "not available", "frozen"]),
    st.integers(60, 110),
)
@settings(max_examples=12, deadline=None)
def test_what_stops_coming_stops_being_good(config_of, train, form, message, how, tick):
    """From some tick on one message of drive 1 is silent, random, invalid or always the same."""
    can_id = 0x610 + ["Cur", "Vol", "Mot"].index(message)
    gateway, held, good = Gateway(config_of(form), codec(), 0), None, []
    for now, frames in train(form):
        batch = []
        for frame in frames:
            if frame.can_id == can_id and now > tick * TICK:
                held = held or frame
                if how == "silent":
                    continue
                changed = {
                    "garbage": bytes((frame.t_ns * 31 + 7 * n) % 251 for n in range(8)),
                    "not available": b"\xff\x7f" * 4,
                    "frozen": held.data,
                }[how]
                batch.append(frame._replace(data=changed))
            else:
                batch.append(frame)
        gateway.step(batch, now)
        good.append(gateway.view.drives[0].adhesion is Flag.GOOD)
    if tick > 80:
        assert any(good[:tick])
    if message != "Mot":
        assert not any(good[tick + 12 :]), "100 ms after it nothing is good any more"
