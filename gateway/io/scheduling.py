"""Kernel settings for punctual ticks: a real-time priority, and locked memory.

A thread that a library starts later would inherit the priority and could keep the loop from ever
running again, so reset-on-fork is always set. systemd can grant both before the program starts
(`CPUSchedulingPolicy=fifo`, `LimitMEMLOCK=`); the program then needs no privilege.
"""

from __future__ import annotations

import ctypes
import logging
import os
import resource
from pathlib import Path
from typing import Final

from gateway.settings.config import ConfigError

log = logging.getLogger(__name__)

_CURRENT, _FUTURE, _ON_FAULT = 1, 2, 4
_POLICIES = ("OTHER", "FIFO", "RR", "BATCH", "", "IDLE", "DEADLINE")
LEAST: Final = 1
MOST: Final = 99


def be_realtime(priority: int) -> None:
    """Give this thread SCHED_FIFO with `priority` (1 to 99), and lock all memory.

    A real-time priority that the thread already has is kept. Raises ConfigError, which says what
    to do, if the kernel does not allow it.
    """
    problems = []
    given = is_realtime()
    if not LEAST <= priority <= MOST:
        problems.append(f"priority {priority} is not {LEAST} to {MOST}")
    elif given:
        log.info("--realtime %d is ignored: already started with %s", priority, _policy())
    else:
        try:
            policy = os.SCHED_FIFO | os.SCHED_RESET_ON_FORK
            os.sched_setscheduler(0, policy, os.sched_param(priority))
        except OSError as error:
            problems.append(
                f"SCHED_FIFO {priority} refused ({error.strerror}): run with CAP_SYS_NICE, raise "
                "`ulimit -r`, or let systemd set CPUSchedulingPolicy=fifo"
            )
    if why := _lock_memory():
        problems.append(f"memory cannot be locked ({why}): raise `ulimit -l`, or LimitMEMLOCK=")
    if problems:
        if given:
            ctypes.CDLL(None).munlockall()
        else:
            be_ordinary()
        raise ConfigError("--realtime", problems)


def use_given() -> None:
    """Lock memory if the thread was started with a real-time priority and there is no limit."""
    if not is_realtime():
        return
    limit, _ = resource.getrlimit(resource.RLIMIT_MEMLOCK)
    if limit != resource.RLIM_INFINITY and os.geteuid() != 0:
        why: str = f"the limit is {limit >> 10} KiB"
    else:
        why = _lock_memory()
    if why:
        log.warning("memory is not locked (%s): set LimitMEMLOCK=infinity", why)


def described() -> str:
    """Scheduling, processors and locked memory of this thread, in one line for the log."""
    processors = len(os.sched_getaffinity(0))
    return (
        f"{_policy()}, {processors} processor{'s' * (processors > 1)}, "
        f"{_locked_kib() >> 10} MiB locked"
    )


def _policy() -> str:
    number = os.sched_getscheduler(0)
    name = "SCHED_" + _POLICIES[number & ~os.SCHED_RESET_ON_FORK]
    reset = " reset on fork" if number & os.SCHED_RESET_ON_FORK else ""
    return f"{name} {os.sched_getparam(0).sched_priority}{reset}"


def _locked_kib() -> int:
    """Locked memory, KiB; 0 also if /proc does not show it."""
    try:
        text = Path("/proc/self/smaps_rollup").read_text(encoding="ascii", errors="replace")
    except OSError:
        return 0
    return next(
        (int(line.split()[1]) for line in text.splitlines() if line.startswith("Locked:")), 0
    )


def _lock_memory() -> str:
    """Lock every page from its first use on; return the error, empty if there is none.

    Not all pages at once, because libraries reserve memory that they never use: OpenBLAS 32 MB, a
    thread's stack 8 MB.
    """
    if ctypes.CDLL(None, use_errno=True).mlockall(_CURRENT | _FUTURE | _ON_FAULT) == 0:
        return ""
    return os.strerror(ctypes.get_errno())


def be_ordinary() -> None:
    """Undo `be_realtime`, once the loop has ended."""
    ctypes.CDLL(None).munlockall()
    if os.sched_getscheduler(0) & ~os.SCHED_RESET_ON_FORK == os.SCHED_FIFO:
        os.sched_setscheduler(0, os.SCHED_OTHER, os.sched_param(0))


def is_realtime() -> bool:
    """Whether this thread has a real-time priority."""
    return os.sched_getscheduler(0) & ~os.SCHED_RESET_ON_FORK in (os.SCHED_FIFO, os.SCHED_RR)
