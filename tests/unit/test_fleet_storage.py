"""A fleet from object storage and into it: as on local paths, each log once; by day and train."""

import shutil
import sys
import threading

import psutil
import pyarrow.dataset as ds
import pyarrow.parquet as pq
import pytest

from gateway.cli import main
from gateway.fleet import run as fleet
from gateway.fleet.logs import FOLDER, find, settings_for
from gateway.fleet.storage import fresh, place
from gateway.fleet.table import DONE
from gateway.settings.config import ConfigError, load
from tests import s3
from tests.programs import loaded
from tests.unit.test_cli import SCENARIO
from tests.unit.test_fleet import is_worker


@pytest.fixture(scope="module")
def store():
    with pytest.MonkeyPatch.context() as patch, s3.server(patch) as files:
        yield files


@pytest.fixture(scope="module")
def logs(tmp_path_factory, store):
    """Two logs of two trains, a day apart, and one that is none; the same in the bucket."""
    here = tmp_path_factory.mktemp("storage")
    scenario = here / "lost.toml"
    scenario.write_text(SCENARIO)
    first = here / "logs" / "IC 1" / "a.log"
    first.parent.mkdir(parents=True)
    assert main(["sim", str(scenario), "-o", str(first)]) == 0
    second = here / "logs" / "RE-2" / "b.log"
    second.parent.mkdir()
    lines = first.read_text().splitlines()
    later = [f"({float(t[1:-1]) + 86400:.6f}) {rest}" for t, rest in
             (line.split(" ", 1) for line in lines)]  # fmt: skip
    second.write_text("\n".join(later) + "\n")
    (here / "logs" / "RE-2" / "noise.log").write_text("no log\n")
    store.put(f"{here}/logs", f"{s3.BUCKET}/logs", recursive=True)
    store.pipe(f"{s3.BUCKET}/logs/.hidden/c.log", first.read_bytes())
    return here


def rows(folder):
    with (place(str(folder)) / "fleet.parquet").open("rb") as file:
        table = pq.read_table(file).to_pylist()
    return [{k: v for k, v in row.items() if k not in ("took_s", "path", "file")} for row in table]


def files(folder):
    """Bytes by name of all estimates."""
    found = (fresh(place(str(folder))) / FOLDER).rglob("*")
    return {p.name: p.read_bytes() for p in found if p.is_file()}


def test_a_bucket_gives_what_a_folder_gives(logs, store, tmp_path, capsys):
    url, local = f"s3://{s3.BUCKET}", str(logs / "logs")
    assert main(["fleet", f"{local}/**/*.log", "-o", str(tmp_path / "out"), "-j", "1"]) == 1
    assert main(["fleet", f"{local}/**/*.log", "-o", f"{url}/out", "-j", "1"]) == 1
    assert files(tmp_path / "out") == files(f"{url}/out")
    assert len(files(f"{url}/out")) == 2
    capsys.readouterr()
    words = ["fleet", f"{url}/logs/**/*.log", "-o", f"{url}/far", "-j", "1"]
    assert main(words) == 1
    said = capsys.readouterr().out
    assert "3 logs: 2 done, 0 done before, 1 bad" in said
    assert f"bad: {url}/logs/RE-2/noise.log: not one of its 1 lines" in said
    wanted = rows(tmp_path / "out")
    for row in wanted:
        row["error"] = row["error"] and row["error"].replace(str(logs), url)
    assert rows(f"{url}/far") == wanted
    far = [pq.read_table(place(f"{url}/far/{FOLDER}/{name}").open("rb"))
           for name in sorted(files(f"{url}/far"))]  # fmt: skip
    near = [pq.read_table(tmp_path / "out" / FOLDER / name)
            for name in sorted(files(tmp_path / "out"))]  # fmt: skip
    assert all(a.equals(b) for a, b in zip(far, near, strict=True))
    before = files(f"{url}/far")
    assert main([*words[:2], f"{url}/logs", *words[2:]]) == 1
    assert "0 done, 2 done before, 1 bad" in capsys.readouterr().out
    store.pipe(f"{s3.BUCKET}/logs/IC 1/a.log", (logs / "logs/IC 1/a.log").read_bytes()[:-4000])
    try:
        assert main(words) == 1
        assert "1 done, 1 done before, 1 bad" in capsys.readouterr().out
        changed = [name for name, data in files(f"{url}/far").items() if data != before[name]]
        assert len(changed) == 1
    finally:
        store.put(f"{logs}/logs/IC 1/a.log", f"{s3.BUCKET}/logs/IC 1/a.log")
    assert main(["fleet-thresholds", f"{url}/far", "-o", str(tmp_path / "t"), "--force"]) == 0


def test_files_by_day_and_train(logs, tmp_path, capsys):
    out = tmp_path / "out"
    words = ["fleet", str(logs / "logs"), "-o", str(out), "-j", "1"]
    assert main(words) == 1
    flat = files(out)
    assert main([*words, "--partition", "day,train"]) == 1
    capsys.readouterr()
    assert main([*words, "--partition", "day,train"]) == 1
    assert "0 done, 2 done before" in capsys.readouterr().out
    assert files(out).keys() == flat.keys()
    found = sorted(p.relative_to(out / FOLDER).parts[:2] for p in (out / FOLDER).rglob("*.parquet"))
    first = rows(out)[0]["first_ns"] // 10**9
    from datetime import UTC, datetime

    days = [f"day={datetime.fromtimestamp(first + k * 86400, UTC):%Y-%m-%d}" for k in (0, 1)]
    assert found == [(days[0], "train=IC%201"), (days[1], "train=RE-2")]
    table = ds.dataset(out / FOLDER, partitioning="hive")
    assert table.count_rows(filter=ds.field("train") == "IC 1") > 0
    assert len(list(table.get_fragments(filter=ds.field("train") == "RE-2"))) == 1
    assert main(words) == 1
    assert sorted(p.name for p in (out / FOLDER).rglob("*.parquet")) == sorted(flat)
    with pytest.raises(SystemExit):
        main([*words, "--partition", "hour"])


def test_a_log_whose_day_changes_has_one_file(logs, tmp_path):
    log, out = tmp_path / "x.log", tmp_path / "out"
    words = ["fleet", str(log), "-o", str(out), "-j", "1", "--partition", "day"]
    for name in ("IC 1/a.log", "RE-2/b.log"):
        shutil.copy(logs / "logs" / name, log)
        assert main(words) == 0
        assert len(files(out)) == len(list((out / FOLDER).rglob("*.parquet"))) == 1


@pytest.mark.thorough  # test_fleet.py kills workers for every change
def test_workers_that_are_killed_leave_each_object_once(logs, store):
    folder, url = f"{s3.BUCKET}/many", f"s3://{s3.BUCKET}"
    for k in range(6):
        store.put(f"{logs}/logs/IC 1/a.log", f"{folder}/{k}.log")
    out = place(f"{url}/killed")
    asked = settings_for(load(None), None, out, ("day", "train"))
    planned = fleet.plan(find([f"{url}/many"], out), asked, force=False)
    ended, first, killed = [], threading.Event(), []

    def kill():
        """Two workers, one after the other, once a log is done and there is more to do."""
        first.wait(120)
        for process in [p for p in psutil.Process().children() if is_worker(p)][:2]:
            process.kill()
            killed.append(process.pid)

    def after(one, row):
        ended.append((one, row.status))
        first.set()

    thread = threading.Thread(target=kill)
    thread.start()
    fleet.run(planned, asked, 2, None, after)
    thread.join()
    assert killed
    assert sorted(ended) == sorted((one, DONE) for one in planned.jobs)
    names = [path.rsplit("/", 1)[1] for path in store.find(f"{s3.BUCKET}/killed")]
    assert sorted(names) == sorted(one.name for one in planned.jobs)
    wanted = files(f"{url}/killed")
    again = place(f"{url}/quiet")
    asked = settings_for(load(None), None, again, ("day", "train"))
    fleet.run(fleet.plan(find([f"{url}/many"], again), asked, force=False), asked, 1, None, after)
    assert files(f"{url}/quiet") == wanted


def test_what_is_not_there_is_one_line(store, capsys, tmp_path):
    out = str(tmp_path / "out")
    assert main(["fleet", "s3://nobucket/*.log", "-o", out]) == 2
    assert main(["fleet", "nosuch://b/*.log", "-o", out]) == 2
    said = capsys.readouterr().err
    assert said.count("\n") == 2
    assert "Traceback" not in said
    with pytest.raises(ConfigError, match="no log matches"):
        find([f"s3://{s3.BUCKET}/none/*.log"], tmp_path)


def test_without_the_libraries_it_says_what_to_install(monkeypatch, capsys, tmp_path):
    monkeypatch.setitem(sys.modules, "s3fs", None)
    assert main(["fleet", "s3://b/*.log", "-o", str(tmp_path)]) == 2
    said = capsys.readouterr().err
    assert "needs s3fs: pip install" in said


def test_a_local_fleet_imports_none_of_them(logs, tmp_path):
    text = """
from pathlib import Path
from gateway.fleet import run, work
from gateway.fleet.logs import find, settings_for
from gateway.settings.config import load
here = Path(sys.argv[2])
asked = settings_for(load(None), None, here)
planned = run.plan(find([sys.argv[1]], here), asked, force=False)
work.replayed(planned.todo[0], asked, 0.0)
"""
    assert not loaded(("fsspec", "s3fs", "upath"), text, logs / "logs", tmp_path / "out")
