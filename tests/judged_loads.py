"""Adhesion alone, as `gateway/core/tick.c` does it: for tests that give it whatever they like."""

from __future__ import annotations

from _traction_core import lib

from dbc.frame import Nanos
from dbc.records import Records, pointer
from estimators.detect import Opinion
from gateway.core.adhesion import AdhesionMonitor


def detect(
    monitor: AdhesionMonitor, estimates: Records, inputs: Records, drives: Records, status: Records,
    now: Nanos,
) -> Opinion:  # fmt: skip
    """One tick. estimates, inputs, drives, status: records of N drives."""
    mine, received = (
        pointer("struct adhesion", monitor.record),
        pointer("struct drive_input", drives),
    )
    flags = pointer("struct drive_status", status)
    given = (
        mine, pointer("struct drive_estimate", estimates), pointer("struct input_status", inputs),
        received, flags, now,
    )  # fmt: skip
    if monitor.in_core:
        lib.detect_loss(*given)
    else:
        lib.adhesion_prepare(*given)
        monitor.ask_detector(estimates)
        lib.adhesion_fuse(mine, received, flags, now)
    return monitor.opinion
