"""The words of the message set are those of the DBC, number by number."""

from functools import cache

import cantools
import numpy as np
import pytest

from gateway.core.codes import (
    NEVER,
    RANKS,
    REJECTED,
    FaultClass,
    FaultSensor,
    Flag,
    GatewayState,
    Health,
    Reason,
)
from gateway.core.receiving import NAMES
from gateway.settings.config import shipped_dbc

PLACES = (
    (Reason, "Gateway_Adhesion", "Reason"),
    (Reason, "Gateway_Faults", "Reason"),
    (Health, "Drive1_Estimate", "Health"),
    (FaultClass, "Drive1_Thermal", "FaultClass"),
    (FaultSensor, "Drive1_Thermal", "FaultSensor"),
    (GatewayState, "Gateway_Status", "State"),
)
NOT_AVAILABLE = 15


@cache
def database(file):
    return cantools.database.load_file(shipped_dbc(file))


def choices(file, message, signal):
    found = database(file).get_message_by_name(message).get_signal_by_name(signal).choices
    return {number: str(name) for number, name in found.items()}


@pytest.mark.parametrize("file", ["traction.dbc", "traction_fd.dbc"])
@pytest.mark.parametrize(("words", "message", "signal"), PLACES)
def test_the_numbers_are_the_message_sets(file, words, message, signal):
    wanted = {n: w for n, w in choices(file, message, signal).items() if n != NOT_AVAILABLE}
    said = {w.value: "".join(part.title() for part in w.name.split("_")) for w in words}
    assert said == wanted


@pytest.mark.parametrize(
    ("message", "signal", "words"),
    [
        ("Gateway_Adhesion", "Adhesion1", {0: "Unknown", 1: "Adhering", 2: "AdhesionLost"}),
        ("Gateway_Faults", "Thermal1", {0: "Unknown", 1: "NoFault", 2: "Fault"}),
    ],
)
def test_flags_are_antivalent_as_the_message_set_says(message, signal, words):
    found = choices("traction.dbc", message, signal)
    assert {n: found[n] for n in (0, 1, 2)} == words
    assert {f.name: f.value for f in Flag} == {"UNKNOWN": 0, "GOOD": 1, "BAD": 2}
    # No flipped bit turns bad into good, and all-zero or all-one says unknown.
    assert Flag.GOOD ^ Flag.BAD == 3


def test_the_priority_is_the_contracts_and_names_every_reason():
    worst_first = sorted(Reason, key=RANKS.__getitem__)
    assert [int(r) for r in worst_first] == [11, 10, 9, 3, 4, 5, 7, 2, 6, 8, 1, Reason.NONE]


def test_what_counts_as_rejected_is_counted_somewhere():
    assert set(REJECTED) <= set(NAMES)
    assert len(set(REJECTED)) == len(REJECTED)
    used = {"decoded", "lost", "own", "remote", "error_frame", "unknown_id", "canopen"}
    assert set(NAMES) - set(REJECTED) == used


def test_never_is_no_stamp_and_no_age_that_there_can_be():
    assert np.iinfo(np.int64).min == NEVER
