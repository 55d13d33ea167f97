"""What the kernel can do for punctual ticks: a real-time priority, and memory that stays.

A thread started later by a library would inherit the priority and could keep the loop from ever
running again; so reset-on-fork is always set. systemd can do both before the program starts
(`CPUSchedulingPolicy=fifo`, `LimitMEMLOCK=`), which needs no privilege here.
"""

from __future__ import annotations

import ctypes
import os
from typing import Final

from gateway.config import ConfigError

_CURRENT, _FUTURE = 1, 2
LEAST: Final = 1
MOST: Final = 99


def be_realtime(priority: int) -> None:
    """SCHED_FIFO with `priority` (1 to 99) for this thread, and all memory locked.

    ConfigError, with what to do, where the kernel does not allow it.
    """
    problems = []
    if not LEAST <= priority <= MOST:
        problems.append(f"priority {priority} is not {LEAST} to {MOST}")
    else:
        try:
            policy = os.SCHED_FIFO | os.SCHED_RESET_ON_FORK
            os.sched_setscheduler(0, policy, os.sched_param(priority))
        except OSError as error:
            problems.append(
                f"SCHED_FIFO {priority} refused ({error.strerror}): run with CAP_SYS_NICE, raise "
                "`ulimit -r`, or let systemd set CPUSchedulingPolicy=fifo"
            )
    if ctypes.CDLL(None, use_errno=True).mlockall(_CURRENT | _FUTURE) != 0:
        why = os.strerror(ctypes.get_errno())
        problems.append(f"memory cannot be locked ({why}): raise `ulimit -l`, or LimitMEMLOCK=")
    if problems:
        be_ordinary()
        raise ConfigError("--realtime", problems)


def be_ordinary() -> None:
    """Undo `be_realtime`, for what comes after the loop."""
    ctypes.CDLL(None).munlockall()
    if os.sched_getscheduler(0) & ~os.SCHED_RESET_ON_FORK == os.SCHED_FIFO:
        os.sched_setscheduler(0, os.SCHED_OTHER, os.sched_param(0))


def is_realtime() -> bool:
    """Whether this thread has a real-time priority."""
    return os.sched_getscheduler(0) & ~os.SCHED_RESET_ON_FORK in (os.SCHED_FIFO, os.SCHED_RR)
