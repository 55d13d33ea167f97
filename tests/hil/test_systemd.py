"""The units under a systemd that runs: user-mode-linux boots into it, with vcan and udev.

The guest is told what to do by `systemd_story.py`, once; each test looks at a chapter. What takes
how long there says nothing of a machine: the guest has one processor and slow system calls.
"""

import json
import os
import re
import shlex
import shutil
import sys
import time
from pathlib import Path

import _traction_core
import pytest

import gateway
from gateway.hil.vcan.job import Job
from gateway.hil.vcan.ways import guest, way
from tests.hil.inside import environment

ROOT = Path(gateway.__path__[0]).parent
HIL = Path(__file__).parent
OPT = Path("/opt/traction-gateway")
SYSTEMD = Path("/lib/systemd/systemd")
LIMIT_S = 360.0
FIFO_RESET_ON_FORK = os.SCHED_FIFO | os.SCHED_RESET_ON_FORK
BUS = "vcan0"
PACKAGES = ("dbc", "estimators", "gateway", "sim")

pytestmark = pytest.mark.thorough


def _program(path, text):
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(text, encoding="utf-8")
    path.chmod(0o755)


def _lay_out(job):
    """What goes to /opt and /etc in the guest, instead of what pip would install."""
    opt, base = job / "opt", Path(sys.base_prefix)
    # A service sees no homes, where an interpreter may live.
    own = OPT / "base" if not base.is_relative_to("/usr") else base
    name = f"python{sys.version_info.major}.{sys.version_info.minor}"
    (opt / "bin").mkdir(parents=True)
    (opt / "bin/start.py").write_text(
        f"import sys\nsys.path.insert(0, '{OPT}/src')\n"
        "from gateway.cli import program\nprogram()\n",
        encoding="utf-8",
    )
    _program(
        opt / "bin/traction-gateway",
        f"#!/bin/sh\nexport LD_LIBRARY_PATH={own}/lib\n"
        f'exec {OPT}/bin/python {OPT}/bin/start.py "$@"\n',
    )
    (opt / "bin/python").symlink_to(own / "bin" / name)
    (opt / "pyvenv.cfg").write_text(f"home = {own}/bin\n", encoding="utf-8")
    script = (ROOT / "gateway/service/links.sh").read_text(encoding="utf-8")
    _program(opt / "libexec/links.sh", script)
    (opt / "src").mkdir()
    shutil.copy(_traction_core.__file__, opt / "src")
    binds = [(ROOT / package, f"src/{package}") for package in PACKAGES]
    binds += [(Path(sys.prefix) / "lib", "lib")] + [(base, "base")] * (own != base)
    (job / "binds").write_text("".join(f"{a} {b}\n" for a, b in binds), encoding="utf-8")
    shutil.copytree(ROOT / "gateway/service", job / "units", ignore=shutil.ignore_patterns("*.sh"))
    (job / "units/can0.env").unlink()
    # A guest is slow, a tick in it may be late by more than the half second of the unit.
    unit = job / "units/traction-gateway@.service"
    text, found = re.subn(r"^WatchdogSec=.*$", "WatchdogSec=2", unit.read_text("utf-8"), flags=re.M)
    assert found == 1
    unit.write_text(text, "utf-8")
    (job / "etc").mkdir()
    (job / f"etc/{BUS}.env").write_text("TYPE=vcan\n", encoding="utf-8")
    (job / f"etc/{BUS}.toml").write_text("", encoding="utf-8")
    needed = {path for path in (ROOT, Path(sys.prefix), base) if path.is_relative_to("/tmp")}
    (job / "paths").write_text("\n".join(map(str, sorted(needed))), encoding="utf-8")


@pytest.fixture(scope="module")
def story(request, tmp_path_factory):
    why = guest().reason
    if not why and not (SYSTEMD.exists() and shutil.which("udevadm")):
        why = "systemd and udev are not installed (apt-get install systemd udev)"
    # Who has vcan without a guest need not have one for this.
    obliged = request.config.getoption("--require-vcan") and not way().prefix
    if why:
        (pytest.fail if obliged else pytest.skip)(why)
    folder = tmp_path_factory.mktemp("systemd")
    _lay_out(folder)
    command = [sys.executable, str(HIL / "systemd_story.py"), str(folder / "story.json")]
    job = Job([shlex.join(command)], folder, environment(folder), boot=HIL / "uml/systemd.sh")
    try:
        deadline = time.monotonic() + LIMIT_S
        while job.running() and time.monotonic() < deadline:
            time.sleep(0.2)
        assert job.exit_code() == 0, job.tail(80)
    finally:
        job.stop()
    return json.loads((folder / "story.json").read_text(encoding="utf-8"))


def test_both_units_start(story):
    told = story["started"]
    assert told["gateway"] == {
        "ActiveState": "active", "SubState": "running", "NRestarts": "0",
        "StatusText": f"runs on socketcan {BUS}",
    }  # fmt: skip
    assert told["links"] == {"ActiveState": "inactive", "Result": "success"}
    assert ",UP," in told["link"]
    assert "qlen 16" in told["link"]
    assert told["rmem_max"] >= 8 << 20


@pytest.mark.parametrize("chapter", ["started", "with_a_key"])
def test_it_is_nobody_with_a_priority_and_no_rights(story, chapter):
    told = story[chapter]["identity"]
    assert len(set(told["Uid"])) == 1
    assert 61184 <= int(told["Uid"][0]) <= 65519, "systemd's dynamic users"
    assert {int(told[f"Cap{kind}"][0], 16) for kind in ("Eff", "Prm", "Bnd")} == {0}
    assert (told["NoNewPrivs"], told["Seccomp"]) == (["1"], ["2"])
    # The priority is given before the sandbox is closed, and does not pass on to children.
    assert (told["policy"], told["priority"]) == (FIFO_RESET_ON_FORK, 50)
    assert int(told["VmLck"][0]) > 100_000, "kB"


def test_a_stopped_process_says_nothing_and_is_replaced(story):
    told = story["stopped"]
    assert told["frames"] == []
    assert told["gateway"] == {"ActiveState": "active", "NRestarts": "1"}
    assert "Watchdog timeout" in told["journal"]


def test_an_interface_that_is_plugged_in_again_is_set_up(story):
    told = story["unplugged"]
    assert told["waits"]["ActiveState"] == "active"
    assert told["waits"]["StatusText"].startswith(f"waits: {BUS} is ")
    assert told["same"]


def test_a_key_that_only_root_can_read_comes_as_a_credential(story):
    told = story["with_a_key"]
    assert len(told["lines"]) == 2
    assert told["flags"] > 10
    assert told["tags"] >= told["flags"]
    assert int(told["trip"]) == 1


def test_a_configuration_that_cannot_be_used_is_not_tried_again(story):
    told = story["misconfigured"]
    assert told["gateway"] == {
        "ActiveState": "failed", "Result": "exit-code", "ExecMainStatus": "2", "NRestarts": "0"
    }  # fmt: skip
    assert "loop.period_ms: unknown key" in told["journal"]


def test_after_five_deaths_in_a_minute_it_stays_down(story):
    told = story["killed"]
    assert told["deaths"] == 5
    assert told["silent"]
    assert told["gateway"]["ActiveState"] == "failed"


def test_it_ends_in_order(story):
    told = story["ended"]
    assert told["gateway"] == {
        "ActiveState": "inactive", "Result": "success", "ExecMainStatus": "0"
    }  # fmt: skip
    assert told["frames"] == 0
