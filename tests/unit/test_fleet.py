"""Fleets of logs: rows, files, what is done again and what is not, workers that die."""

import csv
import gzip
import os
import shutil
import subprocess
import sys
import time
import tomllib

import numpy as np
import psutil
import pyarrow.parquet as pq
import pytest

from gateway.cli import main
from gateway.fleet import run as fleet
from gateway.fleet import task as fleet_task
from gateway.fleet.logs import FOLDER, find, job, settings_for
from gateway.fleet.table import BAD, DONE, Row, flat, metadata_of, per_drive, write_table
from gateway.settings.config import ConfigError, load
from tests.poison import kill_or_work
from tests.unit.test_cli import SCENARIO


@pytest.fixture(scope="module")
def logs(tmp_path_factory):
    """Two seconds with a loss and without, a log that is none, and the fleet's results."""
    here = tmp_path_factory.mktemp("fleet")
    (here / "lost.toml").write_text(SCENARIO)
    (here / "good.toml").write_text(SCENARIO.split("[[event]]")[0])
    (here / "logs" / "deep").mkdir(parents=True)
    for name, place in (("lost", "logs/deep"), ("good", "logs")):
        words = ["sim", str(here / f"{name}.toml"), "-o", str(here / place / f"{name}.log")]
        assert main(words) == 0
    (here / "logs" / "noise.bin").write_bytes(np.random.default_rng(1).bytes(5000))
    return here


@pytest.fixture(scope="module")
def ran(logs):
    """The command over all of them in two processes: its folder."""
    out = logs / "out"
    assert main(["fleet", f"{logs}/logs/**", "-o", str(out), "-j", "2"]) == 1
    return out


def rows(folder):
    return pq.read_table(folder / "fleet.parquet").to_pylist()


def settings(folder, config=None, channel=None):
    return settings_for(load(config), channel, folder)


def here(paths, folder, *, force=False, config=None, channel=None):
    """A fleet in this process: rows by name of the log, and how many were done before."""
    asked = settings(folder, config, channel)
    planned = fleet.plan(paths, asked, force=force)
    done = {one: fleet_task.one_log(one, asked) for one in planned.todo}
    table = {**planned.before, **done}
    return {one.path.name: table[one] for one in planned.jobs}, len(planned.before)


def test_two_good_logs_and_a_bad_one_are_three_rows(logs, ran):
    table = rows(ran)
    assert [(r["path"].rsplit("/", 1)[1], r["status"]) for r in table] == [
        ("lost.log", DONE), ("good.log", DONE), ("noise.bin", BAD),
    ]  # fmt: skip
    assert "is a frame as candump" in table[2]["error"]
    assert table[2]["frames"] is table[2]["drives"] is table[2]["adhering_s"] is None
    assert [r["adhesion_losses"] for r in table] == [1, 0, None]
    assert table[0]["size_bytes"] == (logs / "logs/deep/lost.log").stat().st_size
    text = list(csv.DictReader((ran / "fleet.csv").read_text().splitlines()))
    assert [r["status"] for r in text] == [DONE, DONE, BAD]
    assert text[2]["frames"] == ""
    assert sorted(p.name for p in (ran / FOLDER).iterdir()) == sorted(
        r["file"].split("/")[1] for r in table[:2]
    )


def test_the_numbers_are_those_of_replay(logs, ran, capsys, tmp_path):
    assert main(["replay", str(logs / "logs/deep/lost.log"), "--results", str(tmp_path)]) == 0
    said = capsys.readouterr().out
    row = rows(ran)[0]
    assert f"received {row['frames']}" in said
    assert row["rejected"] == 0
    assert said.count("AdhesionLost") == row["adhesion_losses"] == 1
    flags = list(csv.DictReader((tmp_path / "flags.csv").read_text().splitlines()))
    for drive in row["drives"]:
        mine = [f for f in flags if f["drive"] == str(drive["drive"])]
        for word, name in (("AdhesionLost", "adhesion_lost_s"), ("Adhering", "adhering_s")):
            # Each tick stands for the time until the next; the last for none.
            assert drive[name] == pytest.approx(
                0.01 * sum(f["adhesion"] == word for f in mine[:-1])
            )
    estimates = list(csv.DictReader((tmp_path / "estimates.csv").read_text().splitlines()))
    by_key = {(e["t_s"], e["drive"]): e for e in estimates}
    flags_by_key = {(f["t_s"], f["drive"]): f for f in flags}
    table = pq.read_table(ran / row["file"]).to_pylist()
    assert len(table) >= 3 * 20
    for mine in table:
        t_s = f"{mine['t_ns'] // 10**9}.{mine['t_ns'] % 10**9:09d}"
        theirs = by_key[t_s, str(mine["drive"])]
        assert mine["health"] == theirs["health"]
        assert mine["adhesion"] == flags_by_key[t_s, str(mine["drive"])]["adhesion"]
        for name in ("speed_rad_s", "load_nm", "loss_probability", "mixed_c"):
            assert (mine[name] is None) == (theirs[name] == "")
            if mine[name] is not None:
                assert mine[name] == pytest.approx(float(theirs[name]), abs=6e-3)


def test_every_flag_change_has_its_row(logs, ran, capsys):
    main(["replay", str(logs / "logs/deep/lost.log")])
    said = [line.split() for line in capsys.readouterr().out.splitlines() if "  adhesion  " in line]
    row = rows(ran)[0]
    table = pq.read_table(ran / row["file"]).to_pylist()
    first = row["first_ns"]
    words = {(round((t["t_ns"] - first) / 1e9, 3), t["drive"]): t["adhesion"] for t in table}
    assert len(said) >= 6
    for seconds, _, _, drive, _, word in said:
        assert words[float(seconds), int(drive)] == word


def test_done_logs_are_not_done_again(logs, ran, tmp_path, capsys):
    out = tmp_path / "out"
    shutil.copytree(ran, out)

    def stamps():
        return {p.name: p.stat().st_mtime_ns for p in (out / FOLDER).iterdir()}

    before = stamps()
    assert len(before) == 2
    assert main(["fleet", f"{logs}/logs/**/*.log", "-o", str(out), "-j", "2"]) == 0
    assert "2 logs: 0 done, 2 done before, 0 bad" in capsys.readouterr().out
    assert stamps() == before
    assert rows(out) == [{**row, "took_s": None} for row in rows(ran)[:2]]


def test_what_a_result_rests_on_is_noticed(logs, tmp_path):
    log = tmp_path / "a.log"
    shutil.copy(logs / "logs" / "good.log", log)
    out = tmp_path / "out"
    first, _ = here([log], out)
    assert here([log], out) == ({"a.log": first["a.log"]._replace(took_s=None)}, 1)
    assert here([log], out, force=True)[1] == 0
    config = tmp_path / "c.toml"
    config.write_text('[adhesion]\ndetector = "median"\n')
    assert here([log], out, config=config)[1] == 0
    assert here([log], out, config=config, channel="vcan0")[1] == 0
    assert here([log], out)[1] == 0
    log.write_bytes(log.read_bytes()[:-2000])
    shorter, before = here([log], out)
    assert before == 0
    assert shorter["a.log"].frames < first["a.log"].frames
    (file,) = (out / FOLDER).iterdir()
    file.write_bytes(file.read_bytes()[:-100])
    assert here([log], out)[1] == 0
    log.write_text("no log any more")
    assert here([log], out)[0]["a.log"].status == BAD
    assert not list((out / FOLDER).iterdir())


def test_bad_logs_of_every_kind(logs, tmp_path):
    good = (logs / "logs" / "good.log").read_bytes()
    other = good.replace(b" vcan0 ", b" vcan1 ")
    (tmp_path / "two.log").write_bytes(good[: good.index(b"\n") + 1] + other)
    (tmp_path / "cut.log.gz").write_bytes(gzip.compress(good)[:-9000])
    (tmp_path / "noise.csv").write_text("timestamp,arbitration_id\n1.0,nonsense\n")
    (tmp_path / "empty.log").touch()
    (tmp_path / "gone.log").symlink_to(tmp_path / "nowhere")
    paths = find([str(tmp_path / "*")], tmp_path / "out")
    table, _ = here(paths, tmp_path / "out")
    assert {name: row.status for name, row in table.items()} == {
        "two.log": BAD, "cut.log.gz": DONE, "noise.csv": BAD, "empty.log": BAD, "gone.log": BAD,
    }  # fmt: skip
    assert "--log-channel" in table["two.log"].error
    assert "cannot be read" in table["noise.csv"].error
    assert "no frame" in table["empty.log"].error
    assert "no such file" in table["gone.log"].error
    # What came before the cut counts, as in `replay`, and is said so.
    assert "early" in table["cut.log.gz"].warning
    assert table["cut.log.gz"].frames > 1000
    named, _ = here(paths, tmp_path / "out", channel="vcan1")
    assert named["two.log"].channel == "vcan1"
    write_table(tmp_path, list(table.values()), {})
    assert len(rows(tmp_path)) == 5


def test_a_worker_that_dies_takes_nothing_with_it(logs, tmp_path):
    folder = tmp_path / "logs"
    folder.mkdir()
    for name in ("a", "b", "once", "poison"):
        shutil.copy(logs / "logs" / "good.log", folder / f"{name}.log")
    asked = settings(tmp_path / "out")
    planned = fleet.plan(find([str(folder)], tmp_path / "out"), asked, force=False)
    ended = []
    fleet.run(planned, asked, 2, None, lambda one, row: ended.append((one, row)), kill_or_work)
    table = {one.path.name: row for one, row in ended}
    assert len(ended) == len(table) == 4
    assert {name: row.status for name, row in table.items()} == {
        "a.log": DONE, "b.log": DONE, "once.log": DONE, "poison.log": BAD,
    }  # fmt: skip
    assert "died" in table["poison.log"].error
    assert str(folder / "poison.log") == table["poison.log"].path
    files = sorted(p.name for p in (tmp_path / "out" / FOLDER).iterdir())
    assert files == sorted(one.name for one in planned.jobs if one.path.name != "poison.log")


def test_one_process_or_two_give_the_same(logs, ran, tmp_path):
    assert main(["fleet", f"{logs}/logs", "-o", str(tmp_path / "one"), "-j", "1"]) == 1

    def without_time(folder):
        return [{k: v for k, v in row.items() if k != "took_s"} for row in rows(folder)]

    assert without_time(tmp_path / "one") == without_time(ran)
    for row in rows(ran)[:2]:
        assert pq.read_table(ran / row["file"]).equals(
            pq.read_table(tmp_path / "one" / row["file"])
        )


def test_thresholds_of_a_healthy_fleet_only(logs, ran, tmp_path, capsys, refused):
    fragment = tmp_path / "t.toml"
    assert main(["fleet-thresholds", str(ran), "-o", str(fragment)]) == 2
    said = capsys.readouterr().err
    assert "not healthy" in said
    assert "lost.log" in said
    assert main(["fleet-thresholds", str(ran), "-o", str(fragment), "--force"]) == 0
    forced = tomllib.loads(fragment.read_text())["adhesion"]
    assert forced["raise_probability"] > 0.9
    out = tmp_path / "out"
    table, _ = here([logs / "logs" / "good.log"], out)
    write_table(out, list(table.values()), {"config": load(None).model_dump_json()})
    assert main(["fleet-thresholds", str(out), "-o", str(fragment)]) == 0
    assert capsys.readouterr().out.endswith(fragment.read_text())
    assert tomllib.loads(fragment.read_text())["adhesion"] == {
        "raise_probability": 0.9, "clear_probability": 0.5, "spread_nm": 0.7,
    }  # fmt: skip
    load(fragment)
    assert "no results of a fleet" in refused("fleet-thresholds", tmp_path, "-o", fragment)


def test_the_spread_is_that_of_noise_not_of_lasting_differences():
    from gateway.fleet.thresholds import _steps

    random = np.random.default_rng(3)
    load = 10.0 + np.array([0.0, 1.0, -1.0]) + 0.5 * random.standard_normal((4000, 3))
    samples = {
        "t_ns": np.repeat(np.arange(4000) * 100_000_000, 3),
        "drive": np.tile([1, 2, 3], 4000),
        "load_nm": load.ravel(),
    }
    total, count = _steps(samples, (1, 2, 3), np.full(3, 30.0))
    assert 30.0 * np.sqrt(total / count) == pytest.approx(0.5, rel=0.03)


def test_without_the_extra_it_says_what_to_install(monkeypatch, capsys, refused, logs, tmp_path):
    monkeypatch.setitem(sys.modules, "distributed", None)
    assert main(["fleet", str(logs / "logs"), "-o", str(tmp_path)]) == 2
    said = capsys.readouterr().err
    assert said.startswith("traction-gateway: needs distributed: pip install")
    assert said.count("\n") == 1
    monkeypatch.setitem(sys.modules, "pyarrow", None)
    assert "pyarrow" in refused("fleet-thresholds", tmp_path, "-o", tmp_path / "t.toml")


def test_patterns_folders_and_files(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    for name in ("a/x.log", "a/b/y.log", "a/.hidden.log", "a/[odd].log", "out/estimates/z.parquet"):
        file = tmp_path / name
        file.parent.mkdir(parents=True, exist_ok=True)
        file.touch()
    for name in ("fleet.parquet", "fleet.csv", "mine.log", "estimates/.z.parquet.1.part"):
        (tmp_path / "out" / name).touch()
    (tmp_path / "a" / "link.log").symlink_to(tmp_path / "a" / "x.log")
    out = tmp_path / "out"

    def names(*patterns):
        return [str(p.relative_to(tmp_path)) for p in find(patterns, out)]

    three = ["a/[odd].log", "a/b/y.log", "a/link.log"]
    assert len(names("a")) == 3
    assert names("a/**") == names("a") == names("a", "a/**", str(tmp_path / "a/**/*.log"))
    assert set(names("a")) <= {*three, "a/x.log"}
    assert names("a/[odd].log") == ["a/[odd].log"]
    assert names("**/mine.log") == names("out") == ["out/mine.log"]
    assert names("a/b/y.log", "missing.log") == ["a/b/y.log", "missing.log"]
    with pytest.raises(ConfigError, match=r"none/\*\*.*; no log matches 'missing.log'"):
        find(["none/**", "missing.log"], out)


def test_names_of_files_tell_logs_apart(tmp_path):
    odd = tmp_path / "é \udcff:x.log.gz"
    assert job(odd).name.endswith(".parquet")
    assert job(odd).name.isascii()
    assert job(tmp_path / "a" / "x.log").name != job(tmp_path / "b" / "x.log").name
    row = fleet_task.bad(job(odd), "why")
    write_table(tmp_path, [row], {"settings": "s"})
    assert rows(tmp_path)[0]["path"].endswith("é \\xff:x.log.gz")
    assert metadata_of(tmp_path / "fleet.parquet")["settings"] == "s"
    assert metadata_of(tmp_path / "none") == metadata_of(tmp_path / "fleet.csv") == {}


def test_a_row_survives_its_file():
    row = Row("p", counts={"received": 3, "repeated": 2}, drives=per_drive([], (1, 2), 5))
    assert Row.of_json(row.to_json()) == row
    assert flat(row)["rejected"] == flat(row)["rejected_repeated"] == 2
    assert flat(row)["adhering_s"] == 0.0


def test_a_state_holds_until_the_next_change():
    changes = [
        (0, 1, "adhesion", "Unknown"), (2_000_000_000, 1, "adhesion", "AdhesionLost"),
        (3_000_000_000, 1, "adhesion", "Adhering"), (9_000_000_000, 1, "adhesion", "AdhesionLost"),
    ]  # fmt: skip
    (drive,) = per_drive(changes, (1,), 10_000_000_000)
    assert (drive["adhesion_unknown_s"], drive["adhering_s"], drive["adhesion_lost_s"]) == (2, 6, 2)
    assert drive["adhesion_losses"] == 2


def test_bad_settings_are_refused_before_anything_is_done(logs, tmp_path, refused):
    config = tmp_path / "c.toml"
    config.write_text('[dbc]\nfile = "none.dbc"\n')
    words = ["fleet", str(logs / "logs"), "-o", str(tmp_path / "out"), "--config", str(config)]
    assert "none.dbc" in refused(*words, "-j", "1")
    assert not (tmp_path / "out" / "fleet.parquet").exists()
    assert "--scheduler" in refused(*words, "--scheduler", "wrong://host")


def test_nobody_else_reaches_the_local_processes():
    """Who does runs code as their user, and loopback is there for every account of the machine."""
    from distributed import Client, Security

    from gateway.fleet.cluster import _client

    with _client(1, None) as client:
        workers = client.scheduler_info()["workers"]
        nannies = [worker["nanny"] for worker in workers.values()]
        address = client.scheduler.address
        assert len(workers) == 1
        for place in (address, *workers, *nannies):
            assert place.startswith("tls://127.0.0.1:")
        with pytest.raises(OSError, match=r"closed|reset"):
            Client(address.replace("tls:", "tcp:"), timeout=120)
        with pytest.raises(TypeError, match="TLS"):
            Client(address, timeout=120)
        with pytest.raises(OSError, match="certificate"):
            Client(address, security=Security.temporary(), timeout=120)
        assert client.submit(sum, (1, 2)).result() == 3


def test_a_named_scheduler_is_used_as_its_owner_secured_it(logs, tmp_path, capsys):
    import dask
    from distributed import LocalCluster, Security

    security = Security.temporary()
    certificate = security.get_tls_config_for_role("client")
    log, out = str(logs / "logs" / "good.log"), str(tmp_path / "out")
    with LocalCluster(
        n_workers=1, threads_per_worker=1, security=security, dashboard_address="127.0.0.1:0",
        scheduler_kwargs={"dashboard": False}, silence_logs=50,
    ) as cluster:  # fmt: skip
        words = ["fleet", log, "-o", out, "--scheduler", cluster.scheduler_address]
        assert main(words) == 2
        said = capsys.readouterr().err
        assert "needs certificates" in said
        assert said.count("\n") == 1
        assert not list((tmp_path / "out" / FOLDER).iterdir())
        tls = "distributed.comm.tls"
        owners = {
            f"{tls}.ca-file": certificate["ca_file"],
            f"{tls}.client.cert": certificate["cert"],
            f"{tls}.client.key": certificate["key"],
        }
        with dask.config.set(owners):
            assert main(words) == 0
    assert "1 done" in capsys.readouterr().out


def is_worker(process):
    """Not one that has been killed already."""
    try:
        return "spawn_main" in str(process.cmdline())
    except psutil.Error:
        return False


@pytest.mark.parametrize("seed", [0, pytest.param(1, marks=pytest.mark.thorough)])
def test_workers_that_are_killed_at_any_moment_cost_nothing(logs, ran, tmp_path, seed):
    import random
    import threading

    folder = tmp_path / "logs"
    folder.mkdir()
    for k in range(6):
        shutil.copy(logs / "logs" / ("good.log" if k % 2 else "deep/lost.log"), folder / f"{k}.log")
    asked = settings(tmp_path / "out")
    planned = fleet.plan(find([str(folder)], tmp_path / "out"), asked, force=False)
    draw, over, killed = random.Random(seed), threading.Event(), []

    def kill():
        """So few that no log could be suspected for good, at moments that nobody chose."""
        while len(killed) < 5 and not over.wait(draw.uniform(0.1, 4.0)):
            workers = [p for p in psutil.Process().children() if is_worker(p)]
            if workers:
                victim = draw.choice(workers)
                victim.kill()
                killed.append(victim.pid)

    killer = threading.Thread(target=kill)
    killer.start()
    ended = []
    try:
        fleet.run(planned, asked, 2, None, lambda one, row: ended.append((one, row)))
    finally:
        over.set()
        killer.join()
    assert sorted(one.name for one, _ in ended) == sorted(one.name for one in planned.jobs)
    wanted = rows(ran)
    for one, row in ended:
        like = wanted[int(one.path.stem) % 2]
        assert (row.status, row.frames) == (DONE, like["frames"])
        assert row.total("adhesion_losses") == like["adhesion_losses"]
        mine = pq.read_table(tmp_path / "out" / FOLDER / one.name)
        assert mine.equals(pq.read_table(ran / like["file"]))
    assert sorted(p.name for p in (tmp_path / "out" / FOLDER).iterdir()) == sorted(
        one.name for one in planned.jobs
    )


def test_a_local_process_that_dask_gave_up_is_started_again():
    """One that is lost again 15 s after it died, or fails to start: its nanny is closed."""
    from gateway.fleet.cluster import _client

    with _client(1, None) as client:
        (nanny,) = client.cluster.workers.values()
        client.sync(nanny.close)
        assert client.submit(sum, (1, 2)).result(timeout=300) == 3


def test_a_command_that_is_killed_leaves_no_process_and_goes_on_where_it_was(logs, ran, tmp_path):
    folder, out = tmp_path / "logs", tmp_path / "out"
    folder.mkdir()
    for k in range(16):
        os.link(logs / "logs" / "good.log", folder / f"{k}.log")
    words = ["fleet", str(folder), "-o", str(out), "-j", "1"]
    with subprocess.Popen([sys.executable, "-m", "gateway", *words]) as command:
        while not list((out / FOLDER).glob("*.parquet")):
            time.sleep(0.005)
        children = psutil.Process(command.pid).children(recursive=True)
        command.kill()
    assert psutil.wait_procs(children, timeout=120)[1] == []
    assert not (out / "fleet.parquet").exists()
    before = {path: path.stat().st_mtime_ns for path in (out / FOLDER).glob("*.parquet")}
    assert main(words) == 0
    table = rows(out)
    files = {out / row["file"] for row in table}
    assert [row["status"] for row in table] == [DONE] * 16
    assert files == {path for path in (out / FOLDER).iterdir() if path.is_file()}
    assert {path: path.stat().st_mtime_ns for path in before} == before
    wanted = pq.read_table(ran / rows(ran)[1]["file"])
    assert all(pq.read_table(path).equals(wanted) for path in files)


def test_a_log_of_which_much_was_dropped_counts_and_is_told(logs, tmp_path, capsys):
    lines = (logs / "logs" / "good.log").read_text().splitlines()
    lines[2000:2000] = ["no line of a log"] * (len(lines) // 40)
    log = tmp_path / "half.log"
    log.write_text("\n".join(lines) + "\n")
    out = tmp_path / "out"
    for said in ("1 done, 0 done before", "0 done, 1 done before"):  # the next time as well
        assert main(["fleet", str(log), "-o", str(out), "-j", "1"]) == 1
        told = capsys.readouterr()
        assert said in told.out
        assert "2.4 % of the input was dropped" in told.err
    (row,) = rows(out)
    assert row["status"] == DONE
    assert "faulty_lines" in row["warning"]
