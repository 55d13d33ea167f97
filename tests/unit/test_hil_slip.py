"""`hil --slip-bench`: its table, its page, a device on a bus, and words that it refuses."""

from __future__ import annotations

from argparse import Namespace

import pytest

from dbc.e2e import protect
from dbc.frame import MS, Frame
from gateway import cli
from gateway.hil import slip_bench
from gateway.hil.slip_bench import configured, ride_on_bus
from gateway.hil.slip_rails import AXLES, LIBRARY


def test_the_table_and_the_page(tmp_path, capsys):
    words = ["hil", "--slip-bench", "dry", "seed_3", "--controller", "creep", "-o", str(tmp_path)]
    assert cli.main(words) == 0
    out = capsys.readouterr().out
    for track in ("dry", "seed_3"):
        rows = [line.split() for line in out.splitlines() if line.split()[:1] == [track]]
        assert [row[1] for row in rows] == ["creep", "oracle", "none"]
        assert float(rows[1][2]) >= 97.0
        assert (tmp_path / f"{track}.svg").stat().st_size > 10_000
    page = (tmp_path / "report.html").read_text(encoding="utf-8")
    assert page.count("data:image/svg+xml") == 3
    assert "track of seed 3" in page
    assert "creep scores" in page


def test_a_score_that_is_expected_and_a_function_of_ones_own(tmp_path, capsys):
    mine = tmp_path / "mine.py"
    mine.write_text("def half(seen):\n    return 0.5 + 0.0 * seen.wheel_m_s\n")
    words = ["hil", "--slip-bench", "dry", "--controller", f"{mine}:half"]
    assert cli.main(words) == 0
    assert "half: " in capsys.readouterr().out
    assert cli.main([*words, "--expect-score", "90"]) == 1


@pytest.mark.parametrize(
    ("words", "cure"),
    [
        (["ice"], "one of dry, wet"),
        (["dry", "--controller", "nobody"], "FILE.py:FUNCTION"),
        (["dry", "--controller", "no.py:f"], "no Python file"),
        (["dry", "--controller", f"{__file__}:no"], "no function"),
        (["dry", "--controller", "creep", "-i", "virtual", "-c", "x"], "flags control the torque"),
    ],
)
def test_what_is_not_understood_is_refused_with_a_cure(words, cure, refused):
    assert cure in refused("hil", "--slip-bench", *words)


def test_hil_without_a_scenario_is_refused(refused):
    assert "no scenario: name one, such as `hil wet_one`, or of bearing, " in refused("hil")


def test_the_flags_of_a_device_on_the_bus_act_on_the_torque(monkeypatch):
    _, codec = configured(LIBRARY["dry"])
    spec = codec.by_name["Gateway_Adhesion"]

    def device(simulation, transport, _seconds, after_step, stop):
        """Every axle is lost for two seconds, on a clock that this machine can keep."""
        transport.close()
        for tick in range(1200):
            data = codec.encode(spec, {f"Adhesion{n}": 2 for n in range(1, AXLES + 1)})
            protect(spec, data, tick)
            flags = [Frame(10 * MS * tick, spec.can_id, bytes(data))] if tick < 200 else []
            simulation.step(flags, 10 * MS * tick)
            after_step()
            if stop.requested:
                return

    monkeypatch.setattr(slip_bench, "run_on_bus", device)
    run = ride_on_bus(LIBRARY["dry"], Namespace(interface="virtual", channel="slip"))
    at = {round(m.t_s, 2): m for m in run.moments}
    assert (at[1.9].flag == 2).all()
    assert (at[0.9].limit < 0.7).all()
    assert (at[2.5].flag == 0).all()
    assert (run.moments[-1].limit > 0.9).all()
    assert run.controller == "device"
    assert run.moments[-1].train_m_s < 2.2
