"""Torque against response: what one drive's load says without any other drive.

A train is heavy: what a drive is commanded its rail carries, less the few percent that accelerate
its own rotor. A load that stays behind the command is a wheel that does not carry. This sees
what no comparison between drives can: all wheels lost together, and a drive alone.

Commands come late (every 100 ms). A load that falls may follow a command that has not been heard
yet; so a deficit counts only once a command sent after its begin still stands, or where it is
sudden, large, and has set the rotor free: a load that falls first leaves a torque that accelerates
the wheel, a torque that falls first does not. Until then the verdict is kept open (`OPEN`). Not in
paper `adhesion`.

NumPy forms, which `estimators/detect/command_response.c` is compared with.
"""

from __future__ import annotations

import math
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from estimators.detect.protocol import Opinion
from tests.reference import load_reference as reference
from tests.reference.load_reference import Reference

Array = NDArray[np.float64]
Flags = NDArray[np.bool_]

THRESHOLD: Final = 0.12
"""Share of the command that must be missing."""
LEAST_COMMAND: Final = 0.1
"""Per unit of rated torque; with less, a wheel carries nothing that could be missing."""
OPEN: Final = 0.7
"""Probability while it is not known whether the command has changed: no flag changes at it."""
CLEAR: Final = 0.9
"""Probability from which on a deficit stands: a lesser one may be noise before a new command."""
LARGE: Final = 0.5
SUDDEN_S: Final = 0.015
"""So much gone so soon after a deficit was first seen: no train's load is that fast."""
FREED: Final = 0.25
"""Share of the missing load that must be found in the rotor's acceleration: a speed control is
quick to take the torque back."""
FOR_GOOD_S: Final = 1e6
"""As good as confirmed by a command, for as long as the deficit stands."""
LAG_S: Final = 0.01
"""A command sent this long after a deficit was first seen is younger than its cause."""
STEADY: Final = 0.05
"""Commands that differ by less may be learnt from."""
CERTAINLY_GOOD: Final = 0.05
"""Response that outvotes a comparison, unless that is sure."""
VETOED: Final = 0.4
"""What is left of an accusation that the drive's own response contradicts: not enough to raise."""
SURE: Final = 0.99
"""A comparison that nothing outvotes."""


class Heard(NamedTuple):
    """N drives at one instant, per unit of rated torque, positive in the direction of the command.

    load, braked (the same if friction brakes slow the train), command, before (the command before
    that), all (N,); excess (N,): torque that accelerates
    the rotor, largest of the last two ticks, 0 where not wanted; age_s (N,): since the command was
    sent; usable (N,): load and command are known.
    """

    load: Array
    braked: Array
    excess: Array
    command: Array
    before: Array
    age_s: Array
    usable: Flags


class Memory(NamedTuple):
    """reference: load over command in health; since_s (N,): how long a deficit stands, 0 none;
    braked (N,): friction brakes may be its cause; lack, sigma (N,): load that is missing where a
    response means something."""

    reference: Reference
    since_s: Array
    braked: Flags
    lack: Array
    sigma: Array


def start(n: int, spread: float) -> Memory:
    """Nothing heard yet; `spread` per unit of rated torque."""
    return Memory(
        reference.start(n, spread), np.zeros(n), np.zeros(n, dtype=np.bool_), *np.zeros((2, n))
    )


def respond(memory: Memory, heard: Heard, dt: float) -> tuple[Memory, Array, Flags]:
    """What every drive's response says, `dt` s after the last call.

    Gives the (N,) probabilities that a wheel does not carry its command, and where they mean
    something: not while it coasts, or the command is on its way through zero (`OPEN` there).
    """
    # Between two messages the command may have been anywhere on its way, or further along it.
    ways = np.stack([heard.command, heard.before, 2.0 * heard.command - heard.before])
    one_sign = np.all(ways > 0.0, axis=0) | np.all(ways < 0.0, axis=0)
    least = np.where(one_sign, np.abs(ways).min(axis=0), 0.0)
    sign = np.sign(heard.command)

    def behind(carried: Array) -> Array:
        missing = least * (1.0 - THRESHOLD) - memory.reference.referred(carried) * sign
        z = (missing / memory.reference.sigma(carried)).tolist()
        p = np.array([0.5 * math.erfc(-one / math.sqrt(2.0)) for one in z])
        return np.where((least >= LEAST_COMMAND) & heard.usable, p, 0.0)

    lost = behind(heard.load)
    # Friction brakes may slow the rotor, not a loss; not one that stood before they could.
    slowed = behind(heard.braked)
    braked = (lost > OPEN) & (slowed <= OPEN) & (memory.since_s == 0.0)
    lost = np.where(braked, slowed, lost)
    gone = least - sign * heard.load
    freed = (gone >= LARGE * least) & (sign * heard.excess >= FREED * gone)
    freed &= memory.since_s <= SUDDEN_S
    since = np.where(lost > CLEAR, memory.since_s + np.where(freed, FOR_GOOD_S, dt), 0.0)
    # Seen first in this tick: it may be a tick old, and the filter's lag older.
    confirmed = heard.age_s + LAG_S + dt <= since
    lost = np.where((lost > OPEN) & ~confirmed, OPEN, lost)
    meant = heard.usable & (least >= LEAST_COMMAND)
    carried = np.where(braked, heard.braked, heard.load)
    lack = least * (1.0 - THRESHOLD) - memory.reference.referred(carried) * sign
    sigma = memory.reference.sigma(carried)
    after = Memory(memory.reference, since, braked, lack, sigma)
    return after, np.where(meant, lost, OPEN), meant


def learn(memory: Memory, heard: Heard, healthy: Flags, dt: float) -> Memory:
    """Learn spread, and load over command of the `healthy` drives; every tick of `dt` s.

    Only in the tick in which a command came that is that of before: then it has not changed
    meanwhile, and the load is its answer; not while friction brakes may slow the rotor.
    """
    near = STEADY * np.maximum(np.abs(heard.command), LEAST_COMMAND)
    steady = heard.usable & (np.abs(heard.command - heard.before) <= near) & (heard.age_s < dt)
    steady &= np.abs(heard.braked - heard.load) <= near
    if not steady.any():
        return memory
    learnt = reference.watch(memory.reference, heard.load, heard.command, steady, relative=False)
    learnt = reference.learn(learnt, heard.load, heard.command, healthy & steady, relative=False)
    return memory._replace(reference=learnt)


def coasting(heard: Heard) -> Flags:
    """(N,) whether a drive is asked for nothing that could be missing, now and between messages."""
    ways = np.stack([heard.command, heard.before, 2.0 * heard.command - heard.before])
    coasts: Flags = np.abs(ways).max(axis=0) < LEAST_COMMAND
    return coasts


def fuse(opinion: Opinion, alone: Array, heard: Heard, away: Flags, meant: Flags) -> Opinion:
    """Comparison between drives, and each drive's own response to its command.

    Either may accuse a drive; a drive that certainly answers its command is accused by no
    comparison that is not `SURE`: it may have taken a slipping majority, or one that reads too
    much, for normal. Without a command, or other drives, there is only one of the two; a drive that
    coasts is judged by the comparison alone. While a command is on its way through zero, drives do
    not follow it at quite the same instant, and no comparison accuses; of a rotor that runs `away`
    (N,) none clears. alone, meant (N,): of `respond`.
    """
    outvoted = (alone < CERTAINLY_GOOD) & (opinion.lost <= SURE)
    vetoed = np.where(outvoted, np.minimum(opinion.lost, VETOED), opinion.lost)
    asked = heard.usable & ~coasting(heard)
    passing = np.where(away, np.maximum(opinion.lost, alone), np.minimum(opinion.lost, OPEN))
    compared = np.where(asked, passing, opinion.lost)
    both = np.where(meant, np.maximum(vetoed, alone), compared)
    known = opinion.known | asked
    return Opinion(np.where(opinion.known, both, alone), known, opinion.common)
