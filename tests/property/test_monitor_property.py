"""Whatever comes over the bus: the observer never raises, and says nothing it was not told."""

import json

from hypothesis import given, settings
from hypothesis import strategies as st

from dbc.e2e import protect
from dbc.frame import Frame
from gateway.monitor.model.observer import Observer
from gateway.monitor.model.snapshot import as_json
from tests.monitored import config_of
from tests.simrun import codec
from tests.strategies import frames

MS = 1_000_000
SPECS = [spec for spec in codec().messages if spec.node <= 3]


@st.composite
def spoilt(draw):
    """A message of the set, well protected or not, with any content and length."""
    spec = draw(st.sampled_from(SPECS))
    data = bytearray(draw(st.binary(min_size=8, max_size=8)))
    if draw(st.booleans()):
        protect(spec, data, draw(st.integers(0, 15)))
    size = draw(st.sampled_from([8, 8, 8, 8, 7, 0]))
    return Frame(0, spec.can_id, bytes(data[:size]))


@st.composite
def traffic(draw):
    """Frames in order of time, some seconds at most."""
    any_frame = frames() | spoilt() | spoilt()
    now = draw(st.integers(0, 10**18))
    out = []
    for frame in draw(st.lists(any_frame, max_size=40)):
        now += draw(st.sampled_from([0, 1, 500_000, 10 * MS, 10 * MS, 150 * MS]))
        out.append(frame._replace(t_ns=now))
    return out


@st.composite
def series(draw):
    """Well protected messages of the gateway, in sequence, with any content."""
    names = [s for s in SPECS if s.is_gateway]
    out = []
    chosen = st.lists(st.sampled_from(names), min_size=1, max_size=3, unique_by=lambda s: s.name)
    for spec in draw(chosen):
        for k in range(8):
            data = bytearray(draw(st.binary(min_size=8, max_size=8)))
            protect(spec, data, k)
            out.append(Frame(k * 10 * MS, spec.can_id, bytes(data)))
    return sorted(out, key=lambda f: f.t_ns)


def shown_by(observer, cuts, end):
    for cut in cuts:
        if cut:
            observer.add_frames(cut, cut[-1].t_ns)
    shown = observer.snapshot(end)
    assert all(row.age_s is None or row.age_s >= 0 for row in shown.drives)
    assert shown.t_s >= 0
    times = [event.t_s for event in shown.events]
    assert all(t <= shown.t_s for t in times)
    return json.dumps([as_json(shown), shown.history], allow_nan=False)


@settings(max_examples=25, deadline=None)
@given(traffic(), st.integers(1, 7), st.booleans())
def test_nothing_that_comes_raises_and_cuts_change_nothing(sent, size, shadow):
    end = (sent[-1].t_ns if sent else 0) + 50 * MS
    whole = shown_by(Observer(codec(), config_of(), show_shadow=shadow), [sent], end)
    parts = [sent[k : k + size] for k in range(0, len(sent), size)]
    assert shown_by(Observer(codec(), config_of(), show_shadow=shadow), parts, end) == whole


@settings(max_examples=25, deadline=None)
@given(series())
def test_any_content_of_good_frames_is_shown_or_unknown(sent):
    end = sent[-1].t_ns
    assert shown_by(Observer(codec(), config_of()), [sent], end)
