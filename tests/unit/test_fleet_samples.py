"""A log's table made from many ticks in a call, against one with a view of every tick."""

import re

import pyarrow.parquet as pq
import pytest

from dbc.codec import bind
from gateway.cli import main
from gateway.core.codes import REJECTED, FaultClass, FaultSensor, Health, Reason
from gateway.core.gateway import Gateway
from gateway.fleet.log_result import EVERY_NS
from gateway.fleet.logs import FOLDER, job, settings_for
from gateway.fleet.table import per_drive
from gateway.fleet.work import prepare, replayed
from gateway.io.log_file import OneChannel, open_log
from gateway.io.replay import replay
from gateway.reports.record import ADHESION, FAULT, Changes, camel
from gateway.settings.config import load
from tests.storm.campaign import CALIBRATION


class Plain:
    """The rows that are due, from a view per tick."""

    def __init__(self):
        self.rows, self.next_ns, self.last_ns = [], None, None
        self.flags, self.peak = {}, {}

    def add_view(self, view):
        self.last_ns = view.t_ns
        due = self.next_ns is None or view.t_ns >= self.next_ns
        if due:
            before = view.t_ns if self.next_ns is None else self.next_ns
            self.next_ns = before + EVERY_NS * (1 + (view.t_ns - before) // EVERY_NS)
        for d in view.drives:
            peak = self.peak.get(d.node)
            if d.loss_probability is not None and (peak is None or d.loss_probability > peak):
                self.peak[d.node] = d.loss_probability
            flags = d.adhesion, d.thermal, d.sensor, d.comm, d.estimator
            if due or self.flags.get(d.node) != flags:
                self.flags[d.node] = flags
                self.rows.append(self.row(view.t_ns, d, self.peak.pop(d.node, None)))

    @staticmethod
    def row(t_ns, d, peak):
        return {
            "t_ns": t_ns, "drive": d.node, "adhesion": ADHESION[d.adhesion],
            "thermal": FAULT[d.thermal], "sensor": FAULT[d.sensor], "comm": FAULT[d.comm],
            "estimator": FAULT[d.estimator],
            "reason": camel(Reason(d.adhesion_reason or d.thermal_reason).name),
            "health": camel(Health(d.health).name),
            "fault_class": camel(FaultClass(d.fault_class).name),
            "fault_sensor": camel(FaultSensor(d.fault_sensor).name),
            "speed_rad_s": d.speed_rad_s, "load_nm": d.load_nm, "load_sigma_nm": d.load_sigma_nm,
            "loss_probability": d.loss_probability, "nis": d.nis, "mixed_c": d.mixed_c,
            "maisd_k": d.maisd_k, "degradation_k_h": d.wear.rate_k_h,
            "degradation_sigma_k_h": d.wear.sigma_k_h, "hours_to_limit": d.wear.hours,
            "loss_probability_peak": peak,
        }  # fmt: skip


def same(log, folder, config=None):
    """The table and the row of a log, which are those of single steps."""
    settings = settings_for(load(config), None, folder)
    (folder / FOLDER).mkdir(parents=True, exist_ok=True)
    assert not prepare(settings)
    one = job(log)
    row = replayed(one, settings, 0.0)
    table = pq.read_table(folder / FOLDER / one.name).to_pylist()
    plain, recorder = Plain(), Changes()

    def sink(_now, _out, gateway):
        plain.add_view(gateway.view)
        recorder.add_view(gateway.view)

    used = settings.config
    codec = bind(used.dbc_path, used.nodes)
    blocks = OneChannel(open_log(log, strict=False).blocks, None)
    done = replay(blocks, lambda at: Gateway(used, codec, at), used.loop.period_ns, sink)
    assert table == plain.rows
    assert row.drives == per_drive(recorder.changes, used.nodes, plain.last_ns)
    assert row.counts == done.gateway.inbox.counts
    assert (row.first_ns, row.last_ns, row.frames) == (done.first_ns, done.last_ns, done.frames)
    return table, row


@pytest.fixture(scope="module")
def logs(tmp_path_factory):
    """Losses; a hot motor; the first with holes, silence, damage and time that goes back."""
    here = tmp_path_factory.mktemp("logs")
    for name, until_s in (("demo", ()), ("overheating", ("--duration", "30"))):
        assert main(["sim", name, *until_s, "-o", str(here / f"{name}.log")]) == 0
    lines = (here / "demo.log").read_text().splitlines(keepends=True)
    first = stamp(lines[0])
    odd = []
    for k, line in enumerate(lines):
        t = stamp(line) - first
        if 3.0 < t < 4.2 and re.search(r" [0-9A-F]{2}2#", line):
            continue
        if 5.5 < t < 5.9:
            continue
        # A hole that is skipped, and one that is not.
        t += 40.0 * (t > 7.0) + 3.0 * (t > 9.0) - 0.02 * (k % 997 == 0)
        text = line.split(" ", 1)[1]
        if k % 501 == 0:
            text = text.replace("#0", "#1")
        odd.append(f"({first + t:.6f}) {text}")
    (here / "odd.log").write_text("".join(odd))
    return here


def stamp(line):
    return float(line[1 : line.index(")")])


def test_losses_are_the_same_in_few_calls(logs, tmp_path, monkeypatch):
    calls = []
    real = Gateway.run

    def run(self, block, ends, now):
        out = real(self, block, ends, now)
        calls.append(out[0])
        return out

    monkeypatch.setattr(Gateway, "run", run)
    table, row = same(logs / "demo.log", tmp_path)
    assert row.total("adhesion_losses") > 0
    peaks = [r for r in table if (r["loss_probability_peak"] or 0) > (r["loss_probability"] or 0)]
    assert len(peaks) > 20
    assert sum(calls) > 1150
    assert len(calls) < 220


def test_a_hot_motor_is_the_same_with_either_method(logs, tmp_path):
    for method in ("maisd", "model"):
        config = tmp_path / f"{method}.toml"
        config.write_text(f'[thermal]\ncalibration = "{CALIBRATION}"\nmethod = "{method}"\n')
        _, row = same(logs / "overheating.log", tmp_path / method, config)
        assert row.total("thermal_faults") > 0


@pytest.mark.parametrize(
    "text", ["", '[estimator]\nkind = "ukf"\n', '[adhesion]\ndetector = "median"\n'],
    ids=["ekf", "ukf", "median"],
)  # fmt: skip
def test_holes_silence_and_damage_are_the_same(logs, tmp_path, text):
    config = tmp_path / "c.toml"
    config.write_text(text)
    table, row = same(logs / "odd.log", tmp_path / "out", config)
    assert row.counts["time_back"] > 5
    assert sum(row.counts.get(cause, 0) for cause in REJECTED) > 0
    for flag in ("comm", "estimator"):
        assert len({r[flag] for r in table}) > 1
    # Some rows are of one drive alone.
    ticks = [r["t_ns"] for r in table]
    assert any(ticks.count(t) < 3 for t in set(ticks))
