"""Speed of replay and start, against references in the same run."""

from __future__ import annotations

import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from importlib.util import find_spec
from pathlib import Path

import can
import cantools

from bench import restart
from gateway.cli import main
from gateway.settings.config import shipped_dbc

SECONDS = 60.0
FLAGS_ID = 0x1A0
"""`Gateway_Adhesion`."""


def best(task: Callable[[], object], times: int = 3) -> float:
    """Shortest of a few runs, s: the least disturbed one."""
    spent = []
    for _ in range(times):
        began = time.perf_counter()
        task()
        spent.append(time.perf_counter() - began)
    return min(spent)


def quiet(*words: str) -> None:
    """One command of ours in this process, its output dropped."""
    import contextlib
    import io

    with contextlib.redirect_stdout(io.StringIO()), contextlib.redirect_stderr(io.StringIO()):
        code = main(list(words))
    assert code == 0, words


def library_decode(log: Path) -> None:
    """What a user writes with the libraries alone: read and decode, no estimation."""
    database = cantools.database.load_file(shipped_dbc("traction.dbc"))
    known = {message.frame_id: message for message in database.messages}
    for frame in can.LogReader(log):
        message = known.get(frame.arbitration_id)
        if message is not None:
            message.decode(frame.data)


def as_installed() -> dict[str, str]:
    """The environment, in which Python keeps our bytecode, as `pip install` makes it.

    Where `PYTHONDONTWRITEBYTECODE` is set our sources would be compiled in each start.
    """
    return {k: v for k, v in os.environ.items() if k != "PYTHONDONTWRITEBYTECODE"}


def child(*words: str) -> float:
    """A whole process of ours, s."""
    command = [sys.executable, "-m", "gateway", *words]
    began = time.perf_counter()
    subprocess.run(command, check=True, capture_output=True, env=as_installed())
    return time.perf_counter() - began


def first_flag() -> float | None:
    """s from the start of the process `run` to its first flag on a bus; None without one.

    The bus is python-can's over UDP: every machine has it.
    """
    channel = "239.74.163.9"
    words = ("run", "-i", "udp_multicast", "-c", channel, "--quiet", "--duration", "0.3")
    try:
        bus = can.Bus(interface="udp_multicast", channel=channel)
    except (can.CanError, OSError):
        return None
    with bus:
        while bus.recv(0.3):
            pass
        began = time.perf_counter()
        command = [sys.executable, "-m", "gateway", *words]
        with subprocess.Popen(
            command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL, env=as_installed()
        ):
            while (message := bus.recv(5.0)) is not None:
                if message.arbitration_id == FLAGS_ID:
                    return time.perf_counter() - began
    return None


def rows() -> list[tuple[str, ...]]:
    with tempfile.TemporaryDirectory() as folder:
        log = Path(folder) / "minute.log"
        quiet("sim", "healthy", "--duration", str(SECONDS), "-o", str(log))
        out = [Path(folder) / f"out{k}.log" for k in range(2)]
        ours = best(lambda: quiet("replay", str(log), "-o", str(out[0])))
        quiet("replay", str(log), "-o", str(out[1]))
        same = out[0].read_bytes() == out[1].read_bytes()
        theirs = best(lambda: library_decode(log), 2)
        simulate = best(lambda: quiet("sim", "healthy", "-o", str(Path(folder) / "s.log")), 1)
    bare = best(lambda: subprocess.run([sys.executable, "-c", "pass"], check=True), 5)
    usage = best(lambda: child("--help"), 5)
    verb = best(lambda: child("replay", "--help"), 3)
    first_flag()  # which keeps bytecode
    flags = [seconds for _ in range(5) if (seconds := first_flag()) is not None]
    # python-can would load it for its file formats.
    peer = "; asammdf is installed" if find_spec("asammdf") else ""
    flag_row = (
        f"`run`, from its start to its first flag, bytecode cached{peer}",
        f"{min(flags):.2f} s" if flags else "no multicast here",
        f"bare Python {bare * 1e3:.0f} ms",
        f"{min(flags) / bare:.0f}" if flags else "",
    )
    return [
        (f"replay of {SECONDS:.0f} s, 3 drives, estimation and detection included",
         f"{ours:.2f} s", f"real time {SECONDS:.0f} s", f"{SECONDS / ours:.1f} x"),
        ("the same against LogReader + cantools (read and decode only)",
         f"{ours:.2f} s", f"{theirs:.2f} s", f"{theirs / ours:.2f} x"),
        ("two replays of one log", "byte-identical" if same else "DIFFERENT", "", ""),
        ("simulation of 10 s into a log", f"{simulate:.2f} s", "real time 10 s",
         f"{10 / simulate:.1f} x"),
        ("`--help`, whole process", f"{usage * 1e3:.0f} ms", f"bare Python {bare * 1e3:.0f} ms",
         f"{usage / bare:.1f}"),
        ("`replay --help`, whole process", f"{verb * 1e3:.0f} ms", "", ""),
        flag_row,
        restart.row(as_installed()),
    ]  # fmt: skip
