"""Real-time priority and locked memory: asked for, refused, undone."""

from __future__ import annotations

import os
import subprocess
import sys

import pytest

from gateway.io import scheduling
from gateway.settings.config import ConfigError

REAL = """
import os, threading
from gateway.settings.config import ConfigError
from gateway.io.scheduling import be_ordinary, be_realtime, is_realtime
try:
    be_realtime(10)
except ConfigError as error:
    assert not is_realtime()
    print("refused", error)
else:
    kinds = []
    one = threading.Thread(target=lambda: kinds.append(os.sched_getscheduler(0)))
    one.start(), one.join()
    reset = bool(os.sched_getscheduler(0) & os.SCHED_RESET_ON_FORK)
    print("real", is_realtime(), reset, kinds == [os.SCHED_OTHER])
    be_ordinary()
    print("ordinary", not is_realtime())
"""

GIVEN = """
import os
from gateway.io import scheduling
try:
    os.sched_setscheduler(0, os.SCHED_FIFO | os.SCHED_RESET_ON_FORK, os.sched_param(10))
except OSError as error:
    print("refused", error)
else:
    def refuse(*given):
        raise SystemExit("asked for a priority")
    os.sched_setscheduler = refuse
    scheduling.use_given()
    print(scheduling.described())
    scheduling.be_realtime(50)
    print(scheduling.described())
"""


def test_what_was_given_from_outside_is_used_and_not_asked_for() -> None:
    done = subprocess.run([sys.executable, "-c", GIVEN], capture_output=True, text=True, check=True)
    if done.stdout.startswith("refused"):
        assert os.geteuid() != 0
        return
    for line in done.stdout.splitlines():
        assert line.startswith("SCHED_FIFO 10 reset on fork, ")
        assert int(line.split()[-3]) > 0, "MiB locked"
    assert len(done.stdout.splitlines()) == 2


def test_an_ordinary_start_is_described() -> None:
    assert scheduling.described().startswith("SCHED_OTHER 0, ")


def test_a_thread_started_later_never_inherits_the_priority() -> None:
    done = subprocess.run([sys.executable, "-c", REAL], capture_output=True, text=True, check=True)
    if done.stdout.startswith("refused"):
        assert "CAP_SYS_NICE" in done.stdout or "ulimit -l" in done.stdout
    else:
        assert done.stdout == "real True True True\nordinary True\n"


def test_what_the_kernel_refuses_is_said_with_its_cure(monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse(*_: object) -> None:
        raise PermissionError(1, "Operation not permitted")

    monkeypatch.setattr(os, "sched_setscheduler", refuse)
    with pytest.raises(ConfigError, match=r"SCHED_FIFO 50 refused.*CAP_SYS_NICE"):
        scheduling.be_realtime(50)
    assert not scheduling.is_realtime()


@pytest.mark.parametrize("priority", [0, 100, -1])
def test_a_priority_that_is_none_is_refused(priority: int) -> None:
    with pytest.raises(ConfigError, match=f"priority {priority} is not 1 to 99"):
        scheduling.be_realtime(priority)
    assert not scheduling.is_realtime()
