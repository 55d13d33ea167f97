"""Delta debugging: which of many items can be left out while a condition still holds."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence

import numpy as np
from numpy.typing import NDArray

Mask = NDArray[np.bool_]


def minimise(groups: Sequence[Mask], count: int, holds: Callable[[Mask], bool]) -> Mask:
    """(count,) mask of the items that are left when no single one can be left out any more.

    First whole groups (each a mask of the items) are left out, then runs of consecutive items,
    half as long each time (Zeller and Hildebrandt, "Simplifying and Isolating Failure-Inducing
    Input", 2002, complements only). holds: whether the condition holds with these items; it must
    hold with all of them.
    """
    kept = np.ones(count, dtype=np.bool_)
    for group in groups:
        _leave_out(kept, group, holds)
    length = max(count // 2, 1)
    while True:
        removed = False
        for run in _runs(np.flatnonzero(kept), length):
            removed |= _leave_out(kept, run, holds)
        if length == 1 and not removed:
            return kept
        length = max(length // 2, 1)


def _leave_out(kept: Mask, items: Mask | NDArray[np.int64], holds: Callable[[Mask], bool]) -> bool:
    """Remove items from `kept` if the condition holds without them; return whether it did."""
    without = kept.copy()
    without[items] = False
    if (without == kept).all() or not holds(without):
        return False
    kept[:] = without
    return True


def _runs(items: NDArray[np.int64], length: int) -> Iterator[NDArray[np.int64]]:
    for first in range(0, len(items), length):
        yield items[first : first + length]
