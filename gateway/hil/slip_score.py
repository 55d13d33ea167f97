"""The score of a run on the slip-protection bench."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from gateway.hil.slip_plant import LEAD_IN_S, LOCKED, RISE_S, Moment, creep_of
from gateway.hil.slip_rails import Track

STEP_S: Final = 0.01
SLIDES: Final = 1.05
"""Creep relative to the rail's best above which a wheel slides in the ground truth."""
TOUCHED: Final = 0.98
"""A limit below this is an intervention."""
LOST: Final = 2
SOON_S: Final = 0.5
"""An intervention is false if for this time before it the rail could carry the demand and the wheel
did not slide."""


class Score(NamedTuple):
    """Score of one run over all controlled axles, or the worst; delays also of a stuck axle.

    utilisation: work of the brakes over what rail and demand allowed, 0..1; locked_s: the
    longest time of an axle; false_interventions: their number; delay_s: from the onset of sliding
    to the first cut or flag, median, NaN if no wheel slid.
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
    """Score the moments after the brake's rise. Raises ValueError for a run that ends before."""
    run = [m for m in moments if m.t_s >= LEAD_IN_S + RISE_S]
    if not run:
        raise ValueError("the run ends before the brake is applied")
    axles = range(len(track.wheel))
    obeying = [k for k in axles if k not in (track.stuck, track.cut_out)]
    v = np.array([m.train_m_s for m in run])[:, None]
    asked = np.array([m.asked_nm for m in run])[:, None]
    peak = np.stack([m.peak_nm for m in run])
    creep = np.stack([creep_of(m) for m in run])
    allowed = np.minimum(asked, peak)
    work = allowed * v
    used = np.clip(np.stack([m.load_nm for m in run]), 0.0, allowed) * v
    slides = creep > SLIDES * np.stack([m.peak_creep for m in run])
    needed = slides | (asked > peak)
    flag = np.stack([m.flag for m in run])
    acts = (np.stack([m.limit for m in run]) < TOUCHED) | (flag == LOST)
    delays = [d for k in axles if k != track.cut_out for d in _delays(slides[:, k], acts[:, k])]
    return Score(
        float(used[:, obeying].sum() / work[:, obeying].sum()),
        float(creep[:, obeying].max()),
        STEP_S * float((creep[:, obeying] > LOCKED).sum(axis=0).max()),
        sum(_false(acts[:, k], needed[:, k]) for k in obeying),
        float(np.median(delays)) if delays else float("nan"),
        run[-1].way_m,
        STEP_S * len(run),
    )


def onsets(active: NDArray[np.bool_]) -> NDArray[np.int64]:
    """Indices at which `active` (n,) becomes true."""
    return np.flatnonzero(active & ~np.concatenate([[False], active[:-1]]))


def _false(acts: NDArray[np.bool_], needed: NDArray[np.bool_]) -> int:
    """Number of an axle's interventions that were not needed in `SOON_S` before them."""
    before = round(SOON_S / STEP_S)
    return sum(not needed[max(k - before, 0) : k + 1].any() for k in onsets(acts))


def _delays(slides: NDArray[np.bool_], acts: NDArray[np.bool_]) -> list[float]:
    """Times from each onset of sliding to the next intervention, s; without one, to the end.

    0 for an axle that is cut or flagged already.
    """
    after = [acts[at:] for at in onsets(slides)]
    return [STEP_S * float(a.argmax() if a.any() else len(a)) for a in after]
