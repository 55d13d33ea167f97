"""What a run on the slip-protection bench is worth."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from gateway.hil.slip_plant import LEAD_IN_S, LOCKED, RISE_S, Moment, creep_of
from gateway.hil.slip_rails import Track

Array = NDArray[np.float64]
STEP_S: Final = 0.01
SLIDES: Final = 1.05
"""Creep over the rail's best from which on a wheel is lost in the truth."""
TOUCHED: Final = 0.98
"""A limit below it is an intervention."""
LOST: Final = 2
SOON_S: Final = 0.5
"""An intervention is false where its wheel was not asked for more than the rail carries, and did
not slide, for so long."""


class Score(NamedTuple):
    """Of one run; the axles that obey, all of them or the worst.

    utilisation: work of the brakes over what rail and demand allowed, 0..1; locked_s: the
    longest time of an axle; false_interventions: how many; delay_s: from the onset of sliding to
    the first cut or flag, median, NaN where nothing slid.
    """

    utilisation: float
    worst_creep: float
    locked_s: float
    false_interventions: int
    delay_s: float
    stopping_m: float
    duration_s: float

    @property
    def score(self) -> float:
        """0..1: utilisation times the share of time in which no axle is locked."""
        return self.utilisation * (1.0 - min(self.locked_s / self.duration_s, 1.0))


def score(track: Track, moments: Sequence[Moment]) -> Score:
    """Of all from the end of the rise on. Raises ValueError for a run that ends before it."""
    run = [m for m in moments if m.t_s >= LEAD_IN_S + RISE_S]
    if not run:
        raise ValueError("the run ends before the brake is applied")
    obeying = [k for k in range(len(track.wheel)) if k not in (track.stuck, track.cut_out)]
    v = np.array([m.train_m_s for m in run])[:, None]
    load, peak, creep, best, limit = (
        np.stack(rows)[:, obeying]
        for rows in (
            [m.load_nm for m in run], [m.peak_nm for m in run], [creep_of(m) for m in run],
            [m.peak_creep for m in run], [m.limit for m in run],
        )
    )  # fmt: skip
    asked = np.array([m.asked_nm for m in run])[:, None]
    allowed = np.minimum(asked, peak)
    used = (np.clip(load, 0.0, allowed) * v).sum() / (allowed * v).sum()
    slides = creep > SLIDES * best
    needed = slides | (asked > peak)
    flag = np.stack([m.flag for m in run])[:, obeying]
    acts = (limit < TOUCHED) | (flag == LOST)
    last = run[-1]
    return Score(
        float(used), float(creep.max()), STEP_S * float((creep > LOCKED).sum(axis=0).max()),
        sum(_false(acts[:, k], needed[:, k]) for k in range(len(obeying))),
        float(np.median(delays)) if (delays := _delays(slides, acts)) else float("nan"),
        last.way_m, STEP_S * len(run),
    )  # fmt: skip


def onsets(active: NDArray[np.bool_]) -> NDArray[np.int64]:
    """Indices at which (n,) turns true."""
    return np.flatnonzero(active & ~np.concatenate([[False], active[:-1]]))


def _false(acts: NDArray[np.bool_], needed: NDArray[np.bool_]) -> int:
    """Interventions of an axle without need in the time before them."""
    before = round(SOON_S / STEP_S)
    return sum(not needed[max(k - before, 0) : k + 1].any() for k in onsets(acts))


def _delays(slides: NDArray[np.bool_], acts: NDArray[np.bool_]) -> list[float]:
    """S from each onset of sliding to the axle's next intervention; of those without, to the end.

    An axle on which somebody acts already counts with 0.
    """
    found = []
    for k in range(slides.shape[1]):
        for at in onsets(slides[:, k]):
            after = acts[at:, k]
            found.append(STEP_S * float(after.argmax() if after.any() else len(after)))
    return found
