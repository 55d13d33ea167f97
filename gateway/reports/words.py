"""Plain-English meaning of counters and reasons, for reports."""

from __future__ import annotations

from typing import Final

from gateway.core.codes import REJECTED, Reason

COUNTS: Final = {
    "received": "frames received, of any kind; of a mapped inverter its translated frames",
    "translated": "frames of a mapped inverter, translated into our message set",
    "decoded": "drives' frames whose content was used",
    "canopen": "heartbeats, emergencies and other CANopen frames that supervision reads",
    "own": "frames with the gateway's own identifiers: in a log those of an earlier run, left out",
    "unknown_id": "frames with an identifier that the DBC does not have: not used",
    "error_frame": "error frames: the controller reports a fault on the bus",
    "remote": "remote frames: they ask for data and carry none",
    "error": "wrong checksum: corrupted, or sent by another node without E2E protection",
    "repeated": "the same counter as the frame before: sent twice, or the sender hangs",
    "wrong_sequence": "the counter jumped by more than can be bridged, or two nodes send it",
    "wrong_length": "length other than in the DBC, or the wrong kind of CAN frame",
    "not_yet_valid": "correct, but too few correct frames before it: after a start, a silence or "
    "an error",
    "not_available": "the drive sent the code for `not available`",
    "range": "a value out of range: saturated, or not a measurement",
    "time_back": "a time stamp before that of an earlier frame, or in the future",
    "lost": "frames missing according to their counters (they are not in `received`)",
    "unpaired": "currents without voltages of the same instant, or the reverse: not used",
    "late": "the second frame of a sample came too late to be paired: not used",
    "left_out": "samples skipped by the sender without a counter step: seen by the delay of the "
    "next sample",
}
"""Meaning of a counter by its name."""
NOT_USED: Final = (*REJECTED, "error_frame", "remote", "lost", "unpaired", "late", "left_out")
"""Counters of frames that were not used because of a fault, in the order of the table."""
REASONS: Final = {
    Reason.STARTING: "too little data yet, since the start of the gateway or of the rotor",
    Reason.STALE: "the newest data are older than their limit, or the drive is silent",
    Reason.CORRUPTED: "checksums were wrong",
    Reason.SEQUENCE: "frames were missing, repeated or out of order",
    Reason.RANGE: "values were impossible or contradictory",
    Reason.NOT_AVAILABLE: "the drive sent `not available`, or does not send a value that is needed",
    Reason.DIVERGED: "the estimator no longer followed the motor, and restarts",
    Reason.TOO_FEW_DRIVES: "too few drives with a valid load to compare",
    Reason.OVERRUN: "the gateway missed its own cycle time",
    Reason.INTRUDER: "another node sends with the gateway's identifiers",
    Reason.CONFIG: "the configuration lacks what this flag needs (such as a calibration)",
}
"""Why a flag is unknown."""
