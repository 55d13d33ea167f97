"""Plain-English meaning of counters and reasons, for reports."""

from __future__ import annotations

from typing import Final

from gateway.core.codes import REJECTED, Reason

COUNTS: Final = {
    "received": "frames that came in, of any kind; of mapped inverters those made of theirs",
    "translated": "frames of a mapped inverter, of whose signals ours are made",
    "decoded": "drives' frames whose content was used",
    "canopen": "heartbeats, emergencies and other CANopen frames that supervision reads",
    "own": "frames with the gateway's own identifiers: in a log its earlier words, left out",
    "unknown_id": "frames with an identifier that the DBC does not have: none of our business",
    "error_frame": "error frames: the controller saw a fault on the wire",
    "remote": "remote frames: they ask for data and carry none",
    "error": "wrong checksum: bits changed on the way, or somebody who does not protect",
    "repeated": "the same counter as the frame before: sent twice, or the sender hangs",
    "wrong_sequence": "the counter jumped by more than can be bridged, or two senders speak",
    "wrong_length": "more or fewer bytes than the DBC says, or the wrong kind of CAN frame",
    "not_yet_valid": "right in itself, but too few right ones before it to be believed: after a "
    "start, a silence or an error",
    "not_available": "the drive itself says that it has no value (the code for not available)",
    "range": "a value outside of what is possible: saturated, or not a measurement",
    "time_back": "the time stamp lies before an earlier frame's, or in the future",
    "lost": "frames that never came, by the gaps in their counters (they are not in `received`)",
    "unpaired": "currents without the voltages of the same instant, or the reverse: not used",
    "late": "a sample's second half came too late to be its half: not used",
    "left_out": "samples that never came though no counter says so: all later ones come later",
}
"""By the name of the counter."""
NOT_USED: Final = (*REJECTED, "error_frame", "remote", "lost", "unpaired", "late", "left_out")
"""Those that say that something was wrong, in the order of the table."""
REASONS: Final = {
    Reason.STARTING: "not enough was seen yet, since the start or since the drive turns",
    Reason.STALE: "the newest data are older than their limit, or the drive is silent",
    Reason.CORRUPTED: "checksums were wrong",
    Reason.SEQUENCE: "frames were missing, repeated or out of order",
    Reason.RANGE: "values were impossible, or contradicted one another",
    Reason.NOT_AVAILABLE: "the drive said that it has no value, or there is none to compare with",
    Reason.DIVERGED: "the estimator lost the motor and starts anew",
    Reason.TOO_FEW_DRIVES: "too few drives are known to compare them",
    Reason.OVERRUN: "the gateway itself was late",
    Reason.INTRUDER: "somebody else sends with the gateway's identifiers",
    Reason.CONFIG: "the configuration does not give what this flag needs (such as a calibration)",
}
"""Why a flag says unknown."""
