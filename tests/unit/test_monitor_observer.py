"""The observer by law: what it says must be what was said, and never more than is known."""

import itertools
import json
from collections import Counter, deque

import pytest

from dbc.e2e import protect
from dbc.frame import ERROR, Frame
from gateway.core.codes import Flag, Health, Reason
from gateway.io.wire import BusState
from gateway.monitor.model import incidents as happenings
from gateway.monitor.model import traces
from gateway.monitor.model.observer import Observer
from gateway.monitor.model.schedule import Schedule
from gateway.monitor.model.snapshot import as_json
from tests.monitored import TICK, config_of, play, recorded, shadow_views
from tests.simrun import by_tick, codec

ADHESION, FAULTS = 0x1A0, 0x2A0
MS = 1_000_000
END = 3_000 * MS


@pytest.fixture
def run():
    return recorded()


def texts(shown):
    return [event.text for event in shown.events]


def without(frames, *ids):
    return [f for f in frames if f.can_id not in ids]


def test_flags_and_estimates_are_those_that_the_gateway_sent(run):
    observer, seen = run.observer(), Counter()
    ticks = by_tick(run.frames, [view.t_ns for view in run.views])
    for view, (_, frames) in zip(run.views, ticks, strict=True):
        observer.add_frames(frames, view.t_ns)
        shown = observer.snapshot(view.t_ns)
        if view.t_ns < 50 * MS:
            continue
        assert shown.gateway.alive
        assert shown.gateway.source == "bus"
        assert shown.gateway.reason is view.adhesion_reason
        ages = [d.age_ns for d in view.drives if d.age_ns is not None]
        assert shown.gateway.age_ms == (max(ages) // MS if len(ages) == 3 else None)
        for row, drive in zip(shown.drives, view.drives, strict=True):
            assert row.adhesion is drive.adhesion
            seen[row.adhesion] += 1
    assert min(seen[Flag.GOOD], seen[Flag.BAD], seen[Flag.UNKNOWN]) > 10
    row, drive = shown.drives[1], run.views[-1].drives[1]
    assert row.health is drive.health is Health.TRACKING
    assert row.speed_rad_s == pytest.approx(drive.speed_rad_s, abs=0.03)
    assert row.measured_speed_rad_s == pytest.approx(drive.speed_rad_s, abs=1.0)
    assert row.load_nm == pytest.approx(drive.load_nm, abs=1.0)
    assert row.mixed_c == pytest.approx(drive.mixed_c, abs=0.3)
    assert shown.gateway.bus_load_pct == pytest.approx(shown.link.bus_load_pct, abs=2)
    losses = [e for e in shown.events if e.drive == 2 and "adhesion" in e.text]
    assert [e.text for e in losses][-2:] == ["adhesion AdhesionLost", "adhesion Adhering"]
    assert 1.2 < losses[-2].t_s < 1.26
    assert losses[-2].level == "error"


def test_the_cut_into_calls_changes_nothing(run):
    shown = [play(run.observer(), run.frames, END, step) for step in (3 * MS, 10 * MS, 317 * MS)]
    assert shown[0].history[0].t_s
    assert shown[0] == shown[1] == shown[2]


def test_drives_in_another_order_are_the_same_rows_in_that_order(run):
    # The hash names the configuration, in which the order differs.
    frames = without(run.frames, codec().by_name["Gateway_Info"].can_id)
    plain = play(run.observer(), frames, END)
    other = play(Observer(codec(), config_of((3, 1, 2))), frames, END)
    assert [row.node for row in other.drives] == [3, 1, 2]
    for row in other.drives:
        same = plain.drives[row.node - 1]
        assert row.load_sigma_nm == pytest.approx(same.load_sigma_nm, rel=1e-6)
        assert row._replace(load_sigma_nm=None) == same._replace(load_sigma_nm=None)
    assert Counter(other.events) == Counter(plain.events)
    assert other.gateway == plain.gateway
    assert other.link == plain.link


def test_the_uncertainty_is_the_shadows_where_it_agrees_and_nothing_where_not(run):
    observer = run.observer()
    shown = play(observer, run.frames, END)
    for row, drive in zip(shown.drives, run.views[-1].drives, strict=True):
        assert row.load_sigma_nm == pytest.approx(drive.load_sigma_nm, rel=0.05)
    other = config_of(motor={"bench": {
        "R_s": 0.28, "L_s": 3.465e-3, "psi_pm": 0.25, "pole_pairs": 4, "J": 0.04,
        "I_rated": 25.0, "T_rated": 30.0}})  # fmt: skip
    shown = play(Observer(codec(), other), run.frames, END)
    assert [row.load_sigma_nm for row in shown.drives] == [None] * 3
    assert [row.load_nm is not None for row in shown.drives] == [True] * 3
    assert any("no sigma is shown" in text for text in texts(shown))


def test_what_is_too_old_is_unknown(run):
    observer = run.observer()
    shown = play(observer, run.frames, END)
    assert shown.gateway.alive
    shown = observer.snapshot(END + 90 * MS)
    assert shown.gateway.alive
    assert shown.drives[0].adhesion is Flag.GOOD
    shown = observer.snapshot(END + 130 * MS)
    assert not shown.gateway.alive
    assert shown.gateway.present
    assert {row.adhesion for row in shown.drives} == {Flag.UNKNOWN}
    assert shown.gateway.reason is None
    assert "gateway's flags no longer received" in texts(shown)
    shown = observer.snapshot(END + 4_000 * MS)
    row = shown.drives[0]
    assert (row.health, row.heartbeat) == (Health.UNKNOWN, "Silent")
    known = row._replace(node=0, age_s=None, rejected=0, adhesion=0, thermal=0, health=0,
                         heartbeat=None, fault_class=0)  # fmt: skip
    assert not any(known)
    gone = shown.gateway
    assert (gone.state, gone.bus_load_pct, gone.config_hash, gone.rejected) == (None,) * 4
    assert (shown.link.bus_load_pct, shown.link.frames_s) == (0.0, 0.0)
    assert texts(shown).count("heartbeat lost") == 3


def test_without_a_gateway_nothing_is_known_and_nothing_is_made_up(run):
    shown = play(run.observer(), run.drives, END)
    assert not shown.gateway.present
    assert shown.gateway.source == "none"
    for row in shown.drives:
        assert (row.adhesion, row.thermal, row.health) == (Flag.UNKNOWN, Flag.UNKNOWN, 0)
        assert row.load_nm is row.load_sigma_nm is row.loss_probability is None
        assert row.stator_c is not None
        assert row.measured_speed_rad_s is not None
    assert not [e for e in shown.events if "adhesion" in e.text]


def test_a_shadow_is_what_replay_says_and_is_marked(run):
    shown = play(run.observer(show_shadow=True), run.drives, END)
    views = shadow_views(run)
    at = views[int((END - run.drives[0].t_ns) // TICK)]
    assert shown.gateway.source == "shadow"
    assert not shown.gateway.alive
    for row, drive in zip(shown.drives, at.drives, strict=True):
        assert (row.adhesion, row.health) == (drive.adhesion, drive.health)
        assert (row.load_nm, row.load_sigma_nm) == (drive.load_nm, drive.load_sigma_nm)
    assert "adhesion AdhesionLost (shadow)" in texts(shown)
    # With a gateway on the bus the bus is shown.
    assert play(run.observer(show_shadow=True), run.frames, END).gateway.source == "bus"


def corrupted(frame, byte):
    data = bytearray(frame.data)
    data[byte] ^= 0x41
    return frame._replace(data=bytes(data))


@pytest.mark.parametrize("byte", [0, 1, 7], ids=["checksum", "counter", "flags"])
def test_corrupted_flag_frames_are_not_believed(run, byte):
    """From 1 s on every flag frame is spoilt, and the loss that follows stays unheard."""
    frames = [
        corrupted(f, byte) if f.can_id == ADHESION and f.t_ns > 1_000 * MS else f
        for f in run.frames
    ]
    observer = run.observer()
    shown = play(observer, frames, 1_500 * MS)
    assert {row.adhesion for row in shown.drives} == {Flag.UNKNOWN}
    assert not shown.gateway.alive
    assert "adhesion AdhesionLost" not in texts(shown)
    assert sum(shown.link.rejected.values()) == 50
    # One that is good again is not enough; then they are believed again.
    shown = play(observer, [f for f in run.frames if f.t_ns > 1_500 * MS], 1_510 * MS)
    assert {row.adhesion for row in shown.drives} == {Flag.UNKNOWN}


def test_a_played_back_flag_frame_is_not_believed(run):
    good = next(f for f in run.gateway if f.can_id == ADHESION and f.t_ns >= 1_000 * MS)
    old = [good._replace(t_ns=t) for t in range(2_000 * MS, 3_000 * MS, TICK)]
    early = [f for f in run.frames if f.t_ns <= 1_100 * MS or f.can_id != ADHESION]
    shown = play(run.observer(), early + old, END)
    assert {row.adhesion for row in shown.drives} == {Flag.UNKNOWN}
    assert shown.link.rejected["repeated"] > 90


def test_two_senders_of_the_flags_are_told_and_neither_is_believed(run):
    spec = codec().by_name["Gateway_Adhesion"]
    forged = []
    for k, t_ns in enumerate(range(2_003 * MS, 3_000 * MS, TICK)):
        payload = codec().encode(spec, {f"Adhesion{n}": 1 for n in (1, 2, 3)})
        protect(spec, payload, k + 7)
        forged.append(Frame(t_ns, ADHESION, bytes(payload)))
    shown = play(run.observer(), run.frames + forged, END)
    assert {row.adhesion for row in shown.drives} == {Flag.UNKNOWN}
    assert "two nodes send Gateway_Adhesion: both are rejected" in texts(shown)


def test_wrong_lengths_and_formats_are_counted_against_their_drive(run):
    short = [Frame(t, 0x182, b"\0" * 3) for t in range(1_000 * MS, 1_100 * MS, TICK)]
    shown = play(run.observer(), run.frames + short, END)
    assert shown.drives[1].rejected == 10
    assert shown.drives[0].rejected == 0
    assert shown.link.rejected == {"wrong_length": 10}


def test_frames_from_the_future_and_before_time_are_counted_and_not_believed(run):
    observer = run.observer()
    play(observer, run.frames, END)
    late = run.gateway[-1]
    observer.add_frames([late._replace(t_ns=END + 5_000 * MS), late._replace(t_ns=-5)], END)
    assert observer.snapshot(END).link.rejected == {"time_back": 2}


def test_a_flood_with_one_stamp_is_bounded_and_counted(run, monkeypatch):
    monkeypatch.setattr("gateway.monitor.model.observer.MOST_HELD", 50)
    observer = run.observer()
    play(observer, run.frames, END)
    before = observer.counts["unknown_id"]
    for _ in range(20):
        observer.add_frames([Frame(END, 0x555, b"")] * 10, END)
    assert observer.snapshot(END + TICK).link.rejected == {"flood": 150}
    assert observer.counts["unknown_id"] == before + 50


def test_error_frames_move_the_bus_state(run):
    off = Frame(END, 0x40, bytes(8), ERROR)
    shown = play(run.observer(), [*run.frames, off], END)
    assert (shown.link.state, shown.link.error_frames) == (BusState.BUS_OFF, 1)
    assert "bus bus-off" in texts(shown)


def test_emergencies_and_lost_heartbeats_are_told(run):
    emergency = Frame(1_000 * MS, 0x082, bytes.fromhex("1023010000000000"))
    ours = Frame(1_500 * MS, 0x0A0, bytes.fromhex("5081010000000000"))
    silent = without(run.frames, 0x703)
    beat = [f for f in run.frames if f.can_id == 0x703 and not 500 * MS < f.t_ns < 2_500 * MS]
    shown = play(run.observer(), [*silent, *beat, emergency, ours], END)
    told = [(e.drive, e.level, e.text) for e in shown.events]
    assert (2, "error", "emergency 2310, register 01") in told
    assert (None, "error", "gateway emergency 8150, register 01") in told
    assert (3, "error", "heartbeat lost") in told
    assert told[-1] == (3, "info", "heartbeat: Operational")


def size_of(item, seen):
    """Members of all containers that an object holds on to."""
    if id(item) in seen or isinstance(item, type):
        return 0
    seen.add(id(item))
    if isinstance(item, dict):
        inner = list(itertools.chain(item, item.values()))
    elif isinstance(item, list | tuple | set | frozenset | deque):
        inner = list(item)
    elif hasattr(item, "nbytes"):
        return item.nbytes
    else:
        slots = [getattr(item, n, None) for n in getattr(type(item), "__slots__", ())]
        inner = [*slots, *getattr(item, "__dict__", {}).values()]
        return sum(size_of(part, seen) for part in inner)
    return len(inner) + sum(size_of(part, seen) for part in inner)


def hostile(start_ns, seconds):
    """Every identifier there is, emergencies, forged flags, error frames: 2000 a second."""
    for k in range(round(seconds * 2000)):
        t_ns = start_ns + k * 500_000
        yield Frame(t_ns, k * 37 % 0x800, bytes([k & 0xFF] * (k % 9)), ERROR if k % 11 == 0 else 0)


def test_memory_is_bounded_whatever_comes(run, monkeypatch):
    monkeypatch.setattr(traces, "POINTS", 50)
    monkeypatch.setattr(happenings, "KEPT", 30)
    observer = run.observer()
    constant = {id(codec()), id(run.config)}
    sizes = []
    for k in range(3):
        start = END + k * 70_000 * MS
        play(observer, [*run.frames, *hostile(start, 2.0)] if not k else hostile(start, 2.0),
             start + 2_000 * MS)  # fmt: skip
        shown = observer.snapshot(start + 69_000 * MS)
        sizes.append(size_of(vars(observer), set(constant)))
    assert len(shown.events) == 30
    assert len(shown.history[0].t_s) == 50
    assert sizes[2] <= sizes[1] * 1.02


def test_a_long_silence_is_skipped_and_gives_what_waiting_gives(run):
    later = [f._replace(t_ns=f.t_ns + 600_000 * MS) for f in run.frames]
    patient, hasty = run.observer(), run.observer()
    a = play(hasty, run.frames + later, later[-1].t_ns, step_ns=600_000 * MS)
    play(patient, run.frames, END)
    for minute in range(1, 10):
        patient.add_frames((), END + minute * 60_000 * MS)
    b = play(patient, later, later[-1].t_ns)
    assert a == b
    assert a.t_s == pytest.approx(603.0, abs=0.02)


def test_a_copy_goes_its_own_way(run):
    observer = run.observer()
    half = play(observer, [f for f in run.frames if f.t_ns <= 1_500 * MS], 1_500 * MS)
    copy = observer.copy()
    whole = play(observer, [f for f in run.frames if f.t_ns > 1_500 * MS], END)
    assert copy.snapshot(1_500 * MS) == half
    assert play(copy, [f for f in run.frames if f.t_ns > 1_500 * MS], END) == whole


def test_what_flutters_does_not_push_everything_else_out(run):
    spec = codec().by_name["Drive1_Estimate"]
    own = without(run.frames, spec.can_id)
    flutter = []
    for k, t_ns in enumerate(range(500 * MS, 3_000 * MS, 20 * MS)):
        payload = codec().encode(spec, {"Health": Health.TRACKING if k % 2 else Health.CONVERGING})
        protect(spec, payload, k)
        flutter.append(Frame(t_ns, spec.can_id, bytes(payload)))
    shown = play(run.observer(), own + flutter, END)
    told = [e.text for e in shown.events if e.drive == 1 and e.text.startswith("health")]
    assert 4 <= len(told) <= 16
    assert any("earlier ones suppressed" in text for text in told)
    assert "adhesion AdhesionLost" in texts(shown)


def test_json_has_the_dbcs_words_and_no_nan(run):
    shown = play(run.observer(), run.frames, END)
    plain = as_json(shown)
    again = json.loads(json.dumps(plain, allow_nan=False))
    assert again == plain
    assert plain["drives"][0]["adhesion"] == "Adhering"
    assert plain["drives"][0]["health"] == "Tracking"
    assert plain["gateway"]["common_mode"] == "NotDetected"
    assert plain["gateway"]["comm_fault"] == "NoFault"
    assert plain["gateway"]["reason"] == "None"
    assert "history" not in plain
    trace = shown.history[1]
    assert Flag.BAD in trace.adhesion
    assert len(trace.t_s) == len(trace.load_nm) == 31
    odd = shown._replace(t_s=float("nan"), drives=(shown.drives[0]._replace(nis=float("inf")),))
    assert as_json(odd)["t_s"] is as_json(odd)["drives"][0]["nis"] is None


def test_every_reason_has_its_word():
    words = {Reason.NOT_AVAILABLE: "NotAvailable", Reason.TOO_FEW_DRIVES: "TooFewDrives"}
    for reason, text in words.items():
        shown = recorded().observer().snapshot(0)
        shown = shown._replace(gateway=shown.gateway._replace(reason=reason))
        assert as_json(shown)["gateway"]["reason"] == text


def test_lateness_is_the_delay_that_was_put_in_and_drift_is_none():
    schedule = Schedule(10 * MS)
    delays = [0, 100_000, 0, 900_000, 0, 5_000_000] * 50
    for k, delay in enumerate(delays):
        # The sender's clock is 50 ppm slower than ours.
        schedule.observe(round(k * 10 * MS * (1 + 50e-6)) + delay, k % 16)
    late = schedule.lateness()
    assert late.total == len(delays) - 1
    assert sum(late.counts) == late.total
    assert len(late.edges_us) == len(late.counts) + 1

    def between(low, high):
        rows = zip(late.edges_us, late.edges_us[1:], late.counts, strict=False)
        return sum(n for a, b, n in rows if a >= low and b <= high)

    assert between(4096, 8192) == 50
    assert between(512, 1024) == 50
    assert between(64, 128) == 50
    assert 4900 <= late.largest_us <= 5000


def test_lateness_starts_anew_after_a_gap():
    schedule = Schedule(10 * MS)
    for k in range(100):
        schedule.observe(k * 10 * MS, k % 16)
    for k in range(100):  # a gateway that was started again, on a grid of its own
        schedule.observe(5_003 * MS + k * 10 * MS, k % 16)
    assert schedule.lateness().largest_us == 0
