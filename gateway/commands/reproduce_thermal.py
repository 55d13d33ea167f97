"""`reproduce thermal`: Table 2 and Figures 4-8 of paper `thermal`, on labelled trains."""

from __future__ import annotations

import json
import os
from collections.abc import Callable, Iterable, Iterator, Sequence
from importlib.metadata import version
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from gateway.study.thermal_figures import Train
from gateway.study.thermal_report import Outcome
from gateway.study.thermal_scores import Score

TRAINS: Final = 20
FIRST_SEED: Final = 2000
"""These seeds are neither tuned on nor kept for the benchmark's reporting."""
KIND: Final = "overheating"
BASE: Final = "days"
"""Time base of the figures, that of the paper."""
BASES: Final = ("days", "bench")
STEPS: Final = 4
"""Progress steps of `reproduce` beside the trains of both bases."""
MOST_JOBS: Final = 4
FILE: Final = "trains.jsonl"
"""Finished trials, train by train, from which a stopped reproduction continues."""
_Row = tuple[str, Score]
"""Method and score."""


def reproduce(
    folder: Path,
    step: Callable[[str], None],
    trains: int = TRAINS,
    *,
    resume: bool = False,
    show: Callable[[str], None] = lambda _table: None,
) -> Outcome:
    """Write everything into `folder`; `step(what)` is called 2 `trains` + STEPS times.

    A base's table is written, and passed to `show`, before the next base begins. resume: trains
    with results in `folder` are not run again. Raises OSError if `folder` cannot be written.
    """
    from gateway.study import thermal_figures as figures
    from gateway.study import thermal_report as report
    from gateway.study.thermal_trials import ABLATION, NAMES, evaluate

    folder.mkdir(parents=True, exist_ok=True)
    seeds = range(FIRST_SEED, FIRST_SEED + trains)
    jobs = min(os.cpu_count() or 1, MOST_JOBS, trains)
    scores: dict[str, dict[str, list[Score]]] = {}
    done = Done(folder / FILE, version("traction-gateway"), resume=resume)
    outcome = Outcome(KIND, list(seeds), scores, [])
    for base in BASES:
        names = (*NAMES, *ABLATION) if base == BASE else NAMES
        left = done.missing(base, seeds)
        step(f"{base} base: {len(left)} trains, {len(names)} methods, {jobs} processes")
        for seed in seeds:
            if seed not in left:
                step(f"train {seed}, {base} base: done before")
        for seed, rows in zip(left, evaluate(left, base, (KIND,), names, jobs), strict=True):
            step(f"train {seed}, {base} base")
            done.add_rows(base, seed, ((row.method, row.score) for row in rows))
        scores[base] = done.scores(base, seeds, names)
        missing = [name for name, own in scores[base].items() if not own]
        outcome = outcome._replace(missing=missing)
        text = report.table(outcome, base)
        if base == BASE:
            text += f"\n\n{report.ablation(outcome)}"
        (folder / f"table2_{base}.md").write_text(text + "\n", encoding="utf-8")
        show(text)
    step("figures")
    train, flags = picture(FIRST_SEED)
    figures.states(folder / "figure4", train)
    figures.errors(folder / "figure5", train)
    figures.jumps(folder / "figure6", train)
    figures.motors(folder / "figure7", train)
    figures.detection(folder / "figure8", train, flags)
    step("report")
    report.write(folder, outcome)
    return outcome


def picture(seed: int) -> tuple[Train, dict[str, tuple[NDArray[np.float64], float]]]:
    """Data of one train for the figures, and every method's statistic with its limit."""
    from estimators.thermal import degradation
    from estimators.thermal.maisd_method import LIMIT as QUANTILE
    from estimators.thermal.maisd_method import maisd, moving_average
    from estimators.thermal.rivals.dpca import Either
    from estimators.thermal.sigma_mixed import SigmaMixedFilter, lumps
    from gateway.study.thermal_dataset import BASES
    from gateway.study.thermal_trials import LIMIT, METHODS, NAMES, fit, record_of, runs_of

    base = BASES[BASE]
    healthy, limiting, judged = runs_of(seed, base, (KIND,))
    run = judged[KIND]
    assert run.fault is not None
    record = record_of(run)
    known, plain = lumps(healthy[0]), SigmaMixedFilter()
    estimates = plain.run(record, known)
    window = METHODS[BASE]["paper"].window
    spreads = [
        maisd(moving_average(states, window, causal=False))
        for states in (plain.run(healthy[0], known).state, estimates.state)
    ]
    m = run.fault.motor
    beyond = estimates.state[:, m, 0] - estimates.state[:, :, 0].mean(axis=1)
    per_day = 86_400.0 / base.sample_s
    shown = Train(
        days=np.arange(1, base.samples + 1) / per_day,
        fault=(run.fault.begin / per_day, run.fault.end / per_day),
        odd=m,
        reading=run.temperature,
        true=run.true,
        state=estimates.state,
        mixed=estimates.mixed,
        beyond=beyond,
        # Level 1 of the undecimated transform is the first difference, over the root of 2.
        detail=np.diff(beyond) / np.sqrt(2.0),
        jumps=degradation.jump_points(beyond),
        maisd=spreads[1],
        limit=np.quantile(spreads[0], QUANTILE, axis=0),
    )
    found: dict[str, tuple[NDArray[np.float64], float]] = {}
    for name in NAMES:
        method = METHODS[BASE][name]
        try:
            score = fit(method, healthy)
        except ModuleNotFoundError:
            continue
        limit = float(np.nanquantile(score(limiting), LIMIT))
        if isinstance(score, Either):
            for part, values in zip(score.names, score.each(record).T, strict=True):
                found[f"{name} {part}"] = values, limit
        else:
            found[name] = score(record), limit
    return shown, found


class Done:
    """Finished rows by base and seed; every train that is added is written at once."""

    def __init__(self, path: Path, program: str, *, resume: bool) -> None:
        """Read finished trains to resume; those of another `program` version are not used.

        Raises OSError.
        """
        self._path, self._program = path, program
        self._rows: dict[tuple[str, int], list[_Row]] = {}
        if resume and path.is_file():
            for line in path.read_text(encoding="utf-8").splitlines():
                self._read_line(line)
        path.write_text("".join(map(self._as_json, self._rows)), encoding="utf-8")

    def _read_line(self, line: str) -> None:
        """Read one line; one that is cut, or from another version of the program, is ignored."""
        try:
            found = json.loads(line)
            rows = [(str(method), Score(*map(float, score))) for method, score in found["rows"]]
            key = str(found["base"]), int(found["seed"])
        except (ValueError, TypeError, KeyError):
            return
        if found.get("program") == self._program:
            self._rows[key] = rows

    def _as_json(self, key: tuple[str, int]) -> str:
        base, seed = key
        row: dict[str, Any] = {"program": self._program, "base": base, "seed": seed}
        row["rows"] = [[method, [*score]] for method, score in self._rows[key]]
        return json.dumps(row) + "\n"

    def missing(self, base: str, seeds: Iterable[int]) -> list[int]:
        """Seeds of the trains that must still be run."""
        return [seed for seed in seeds if (base, seed) not in self._rows]

    def add_rows(self, base: str, seed: int, rows: Iterable[_Row]) -> None:
        """Add a train's rows. Raises OSError."""
        key = base, seed
        self._rows[key] = list(rows)
        with self._path.open("a", encoding="utf-8") as file:
            file.write(self._as_json(key))

    def scores(
        self, base: str, seeds: Sequence[int], names: Sequence[str]
    ) -> dict[str, list[Score]]:
        """Scores by method, in the order of the seeds."""
        out: dict[str, list[Score]] = {name: [] for name in names}
        for method, score in self._of(base, seeds):
            out[method].append(score)
        return out

    def _of(self, base: str, seeds: Sequence[int]) -> Iterator[_Row]:
        for seed in seeds:
            yield from self._rows[base, seed]
