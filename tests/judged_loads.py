"""Adhesion alone, as `gateway/core/tick.c` does it: for tests that give it whatever they like."""

from _traction_core import lib

from dbc.records import pointer


def detect(
    monitor, estimates, inputs, drives, status,
    now,
):  # fmt: skip
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
