"""Thermal methods on labelled trains: simulate, fit on fault-free runs, judge runs with a fault.

One limit rule for all: the 99 % quantile of a method's statistic on a fault-free run that it was
not fitted on. Both are runs of the new train; then it ages, and the methods do not know of it.
"""

from __future__ import annotations

import functools
import time
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from typing import Any, Final, NamedTuple

import numpy as np

from dbc.arrays import Array
from estimators.thermal.hypotheses import KINDS as BELIEFS
from estimators.thermal.maisd_method import Filtering, Learnt, PaperMethod
from estimators.thermal.model_method import Calibrated, ModelMethod, Watching
from estimators.thermal.record import Record, join
from estimators.thermal.rivals import RIVALS
from estimators.thermal.sigma_mixed import Estimates, Lumps, lumps
from gateway.io.workers import mapped
from gateway.study import thermal_dataset, thermal_other
from gateway.study.thermal_dataset import BASES, CREEP, KINDS, SENSOR_KINDS, Base, Labelled
from gateway.study.thermal_scores import Diagnosis, Score, Truth, score_alarms

LIMIT: Final = 0.99
DEVELOPMENT: Final = range(30)
"""Seeds that anything may be tuned on."""
REPORTING: Final = range(1000, 1024)
"""Seeds that are not looked at before reporting."""
FIT_RUNS: Final = {"days": 1, "bench": 4}
"""Fault-free runs to learn from; the next one sets the limit."""
HEALTHY: Final = "none"
WORLDS: Final[dict[str, Callable[..., Labelled]]] = {
    "ours": thermal_dataset.train,
    "other": thermal_other.train,
}
"""Generators of labelled trains of different structure. The product was tuned on `ours`."""
ABLATION: Final[dict[str, dict[str, Any]]] = {
    "paper_raw": {"filtered": False, "degrades": False},
    "paper_ukf": {"mixing": 0.0, "degrades": False},
    "paper_mixed": {"degrades": False},
    "paper_acting": {"mixing": 1.0, "noise": 100.0},
}
"""Variants of the paper's method as printed: readings alone, with the filter, with mixing too; and
an interpretation in which the parts act: full mixing, a filter that follows the readings little."""
METHODS: Final[dict[str, dict[str, Any]]] = {
    base: {
        "model": ModelMethod(),
        "paper": PaperMethod(window),
        "paper_causal": PaperMethod(window, causal=True),
        "paper_sound": PaperMethod(window, causal=True, weighted=True, centred=True),
        **{name: PaperMethod(window, **parts) for name, parts in ABLATION.items()},
        **RIVALS[base],
    }
    for base, window in (("days", 3), ("bench", 60))
}
"""Methods by time base: the product's; the paper's as printed (it looks ahead), causal, and with
the mixture's own mean and centred motors; the paper's rivals. Tuned by `bench.thermal_rivals`."""
NAMES: Final = tuple(name for name in METHODS["days"] if name not in ABLATION)
"""Names of the methods, the same on every base."""
SHOWS: Final = {
    "overheating": ("overheating",),
    "cooling_loss": ("cooling_loss",),
    "bearing": ("bearing_de", "bearing_nde"),
    "winding_resistance": ("winding_resistance",),
    "sensor_bias": ("bias_stator", "bias_de", "bias_nde"),
    "intermittent": ("loose_stator", "loose_de", "loose_nde"),
    CREEP: ("bias_stator", "bias_de", "bias_nde"),
}
"""Hypotheses that name a kind of fault correctly."""
UNDECIDED: Final = "undecided"
"""Neither a hot motor nor a faulty sensor is certain."""
CLASS: Final = {
    belief: kind for kind, beliefs in SHOWS.items() if kind != CREEP for belief in beliefs
}


class Runs(NamedTuple):
    """Runs of one train: `healthy` to learn from, `limiting` for the limit, `judged` by kind."""

    healthy: list[Record]
    limiting: Record
    judged: dict[str, Labelled]


class Trial(NamedTuple):
    """One method on one run."""

    seed: int
    kind: str
    method: str
    score: Score
    named: dict[str, int]
    """Number of samples in the fault's interval and beyond the limit, by the kind that was named.

    Empty for methods that name no kind.
    """


def record_of(run: Labelled) -> Record:
    """Part of a run that a method may see."""
    return Record(run.temperature, run.at, run.current_square, run.speed, run.ambient, run.step_s)


def truth_of(run: Labelled, base: Base) -> Truth:
    """Truth by which a run is judged."""
    effect = np.abs(run.effect).max(axis=(1, 2))
    if run.fault is None:
        return Truth(run.faulty, effect, -1, 0, base.sample_s)
    loose = run.fault.kind == "intermittent"
    return Truth(run.faulty, effect, run.fault.motor, run.fault.begin, base.sample_s, loose)


def runs_of(seed: int, base: Base, kinds: Sequence[str], world: str = "ours") -> Runs:
    """A train's runs of these kinds (`KINDS` or `HEALTHY`); a pure function."""
    fits, train = FIT_RUNS[base.name], WORLDS[world]
    new = [record_of(train(seed, base, None, n, new=True)) for n in range(fits + 1)]
    judged = {
        kind: train(seed, base, None if kind == HEALTHY else kind, fits + 1 + n)
        for n, kind in enumerate((*KINDS, HEALTHY, CREEP))
        if kind in kinds
    }
    return Runs(new[:fits], new[fits], judged)


def trials(
    seed: int, base: str, kinds: Sequence[str], methods: Sequence[str], world: str = "ours"
) -> list[Trial]:
    """All methods on a train's runs of these kinds (`KINDS` or `HEALTHY`); a pure function.

    A method whose library is missing has no trials (the LSTM needs PyTorch).
    """
    at = BASES[base]
    healthy, limiting, runs = runs_of(seed, at, kinds, world)
    out = []
    shared = Shared(healthy)
    for name in methods:
        try:
            fitted = fit(METHODS[base][name], healthy, shared)
        except ModuleNotFoundError:
            continue
        limit = float(np.nanquantile(fitted(limiting), LIMIT))
        found = ((kind, judge(fitted, limit, runs[kind], at, shared)) for kind in kinds)
        out += [Trial(seed, kind, name, *scored) for kind, scored in found]
    return out


class Shared:
    """Results that variants of the paper's method share on one train, computed once.

    saved_s: filtering time saved so far, s; a method that ran by itself would need it.
    """

    def __init__(self, healthy: Sequence[Record]) -> None:
        self.saved_s = 0.0
        self._healthy = healthy
        self._learnt: dict[tuple[float, ...], Learnt] = {}
        self._found: dict[tuple[Any, ...], tuple[Estimates, float, Record]] = {}

    @functools.cached_property
    def _whole(self) -> Record:
        return join(self._healthy)

    @functools.cached_property
    def _model(self) -> Lumps:
        return lumps(self._whole)

    def fit(self, method: PaperMethod) -> Callable[[Record], Array]:
        """Fit as `method.fit` does, on the joined fault-free runs."""
        states = self._states(method)
        if method.learning not in self._learnt:
            self._learnt[method.learning] = method.learn(self._whole, self._model, states)
        return method.fit(self._whole, self._learnt[method.learning], states)

    def _states(self, method: PaperMethod) -> Filtering:
        def states(record: Record, known: Lumps, drift: Array | None) -> Estimates:
            # The record is kept with its result, so that no other array can get the same id.
            aged = None if drift is None else drift.tobytes()
            key = method.filtering, method.noise, id(record.temperature), aged
            if key in self._found:
                self.saved_s += self._found[key][1]
            else:
                began = time.perf_counter()
                found = method.states(record, known, drift)
                self._found[key] = found, time.perf_counter() - began, record
            return self._found[key][0]

        return states


def fit(
    method: Any, healthy: Sequence[Record], shared: Shared | None = None
) -> Callable[[Record], Array]:
    """Fit a method. All learn from the same runs; those without a model get them joined.

    shared: results on these runs, for variants of the paper's method.
    """
    if isinstance(method, ModelMethod) and len(healthy) > 1:
        return method.fit_runs(healthy)
    if isinstance(method, PaperMethod) and shared is not None:
        return shared.fit(method)
    fitted: Callable[[Record], Array] = method.fit(join(healthy))
    return fitted


def judge(
    fitted: Callable[[Record], Array], limit: float, run: Labelled, base: Base, shared: Shared
) -> tuple[Score, dict[str, int]]:
    """Judge one run; its time is the scoring time, with the time saved by shared results added."""
    names: dict[str, int] = {}
    record = record_of(run)
    began, saved_s = time.perf_counter(), shared.saved_s
    if isinstance(fitted, Calibrated | Watching):
        belief = fitted.believe(record)
        motor = belief.statistic.argmax(axis=1)
        statistic = belief.statistic.max(axis=1)
        kinds = belief.kind[np.arange(len(motor)), motor]
        kind = kinds.argmax(axis=1)
        sure = belief.side[np.arange(len(motor)), motor] != 0
        wanted = SHOWS[run.fault.kind] if run.fault is not None else ()
        named = sure & np.isin(kind, [BELIEFS.index(name) for name in wanted])
        diagnosis = Diagnosis(motor, named)
        flagged = run.faulty & (statistic > limit)
        names = dict(Counter(CLASS[BELIEFS[k]] for k in kind[flagged & sure].tolist()))
        names |= {UNDECIDED: int((flagged & ~sure).sum())} if (flagged & ~sure).any() else {}
    else:
        statistic, diagnosis = fitted(record), None
    seconds = time.perf_counter() - began + shared.saved_s - saved_s
    return score_alarms(statistic, limit, truth_of(run, base), diagnosis, seconds), names


def confused(found: Sequence[Trial]) -> tuple[float, float]:
    """Shares of confused and of undecided samples, among those in a fault and beyond the limit.

    Confused, of the samples with a class: heat is named for a faulty sensor, or the reverse.
    Undecided, of all: no class. NaN without samples.
    """
    wrong = named = undecided = 0
    for trial in found:
        own = trial.kind in SENSOR_KINDS
        for name, samples in trial.named.items():
            if name == UNDECIDED:
                undecided += samples
                continue
            named += samples
            wrong += samples if (name in SENSOR_KINDS) != own else 0
    every = named + undecided
    return (wrong / named if named else np.nan, undecided / every if every else np.nan)


def evaluate(
    seeds: Sequence[int], base: str, kinds: Sequence[str], methods: Sequence[str], jobs: int = 1,
    world: str = "ours",
) -> Iterator[list[Trial]]:  # fmt: skip
    """Yield the trials seed by seed, in order, computed in `jobs` processes."""
    each = functools.partial(
        trials, base=base, kinds=tuple(kinds), methods=tuple(methods), world=world
    )
    return mapped(each, seeds, jobs)
