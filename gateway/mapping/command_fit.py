"""Check whether `TorqueCommand` is the train's command or has passed the drive's slip control.

The detector finds a loss because a drive carries less load than its command asks for. A command
that is taken after the drive's own slip control, or that repeats the measured torque, falls with
the load and hides the loss.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from itertools import combinations
from typing import Final, NamedTuple

import numpy as np

from dbc.arrays import Array
from gateway.mapping.fit import Finding

LEAST: Final = 30
"""Fewest commands that can be compared."""
NOISY: Final = 0.3
"""Share of the commands at which the torque must be noisy."""
NOISE: Final = 3.0
"""Second differences of the torque above this many of its resolution steps count as noise."""
REPEATED: Final = 0.8
"""A command with the torque's noise in more than this share of noisy samples repeats the torque."""
STEP_S: Final = 0.1
FALL_S: Final = 0.3
FALL: Final = 0.2
"""Fall of one drive's command in FALL_S, over rated torque, while the other commands hold."""
OTHERS: Final = 0.05
DIFFER: Final = 0.15
"""Difference of two commands, over rated torque, that shows whose torque follows which."""
FEWEST_DIFFER: Final = 5
"""Fewest points, STEP_S apart, at which they must differ."""
FEWEST: Final = 3
"""Fewest drives with which a fall of one drive alone can be found."""


class Commanded(NamedTuple):
    """Data of one drive: times s, commands Nm and torques Nm at these times (K,), rated torque."""

    node: int
    t: Array
    command: Array
    torque: Array
    rated_nm: float


def repeats_torque(one: Commanded) -> Iterator[Finding]:
    """Yield at most one finding: the command has the noise of the measured torque."""
    known = np.isfinite(one.command) & np.isfinite(one.torque)
    if np.count_nonzero(known) < LEAST:
        return
    asked, made = np.diff(one.command[known], 2), np.diff(one.torque[known], 2)
    levels = np.diff(np.unique(one.torque[known]))
    if not len(levels):
        return
    noisy = np.abs(made) > NOISE * float(levels.min())
    if np.count_nonzero(noisy) < NOISY * len(made):
        return
    same = np.abs(asked - made)[noisy] < 0.3 * np.abs(made[noisy])
    if np.mean(same) > REPEATED:
        yield Finding(
            False,
            "TorqueCommand repeats Torque with its noise: map what the train asks for, before the "
            "drive's slip control, or leave it out",
        )


def fell_alone(drives: Sequence[Commanded]) -> dict[int, Finding]:
    """By node, the first fall of a drive's command and torque while the other commands held."""
    used = [one for one in drives if np.count_nonzero(np.isfinite(one.command)) >= LEAST]
    if len(used) < FEWEST:
        return {}
    t = np.arange(max(one.t[0] for one in used), min(one.t[-1] for one in used), STEP_S)
    back = round(FALL_S / STEP_S)
    if len(t) <= back:
        return {}
    # Shares of rated torque, without their sign: driving and braking alike.
    command = np.array([_on(t, one.t, np.abs(one.command)) / one.rated_nm for one in used])
    torque = np.array([_on(t, one.t, np.abs(one.torque)) / one.rated_nm for one in used])
    fall = command[:, :-back] - command[:, back:]
    with_it = (torque[:, :-back] - torque[:, back:]) > 0.5 * fall
    found = {}
    for k, one in enumerate(used):
        others = np.median(np.delete(fall, k, axis=0), axis=0)
        alone = np.flatnonzero((fall[k] > FALL) & (others < OTHERS) & with_it[k])
        if len(alone):
            at = alone[0]
            found[one.node] = Finding(
                None,
                f"only this drive's TorqueCommand fell, {t[at] - t[0]:.1f} s after the start, from "
                f"{command[k, at] * one.rated_nm:.3g} to {command[k, at + back] * one.rated_nm:.3g}"
                " Nm, and Torque with it. If the drive's slip control did that, map the command "
                "before it; if the train's control did, change nothing",
            )
    return found


def crossed(drives: Sequence[Commanded]) -> dict[int, Finding]:
    """By node, drives with each other's commands: where these differ, so do their torques."""
    used = [one for one in drives if len(one.t) >= LEAST]
    found = {}
    for one, other in combinations(used, 2):
        t = np.arange(max(one.t[0], other.t[0]), min(one.t[-1], other.t[-1]), STEP_S)
        rated_nm = min(one.rated_nm, other.rated_nm)
        command = [_on(t, each.t, each.command) for each in (one, other)]
        torque = [_on(t, each.t, each.torque) for each in (one, other)]
        differ = np.abs(command[0] - command[1]) > DIFFER * rated_nm
        if np.count_nonzero(differ) < FEWEST_DIFFER:
            continue
        straight = np.abs(torque[0] - command[0]) + np.abs(torque[1] - command[1])
        swapped = np.abs(torque[0] - command[1]) + np.abs(torque[1] - command[0])
        if np.median(swapped[differ]) < 0.5 * np.median(straight[differ]):
            for mine, its in ((one, other), (other, one)):
                found[mine.node] = Finding(
                    False,
                    f"where commands differ, Torque follows the TorqueCommand of drive {its.node}:"
                    " the commands of these two drives are crossed. A lost drive would never be"
                    " cleared: correct their mapping, or their node numbers",
                )
    return found


def _on(grid: Array, t: Array, values: Array) -> Array:
    """Interpolate the finite values at the times of a grid; NaN if no value is finite."""
    known = np.isfinite(values)
    if not known.any():
        return np.full(len(grid), np.nan)
    return np.interp(grid, t[known], values[known])
