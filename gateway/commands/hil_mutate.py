"""`hil --mutate N`: count how many faulty gateways these scenarios or tests would notice."""

from __future__ import annotations

import argparse
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import TYPE_CHECKING

from gateway.commands.common import FAILED, GOOD, names_bus
from gateway.commands.progress import track
from gateway.io.console import note
from gateway.reports.known import percentage
from gateway.settings.config import ConfigError

if TYPE_CHECKING:
    from gateway.hil.mutating import Recorded, Result
    from sim.scenario import Scenario


def arguments(parser: argparse.ArgumentParser) -> None:
    """Options of `hil` that are about mutants."""
    parser.add_argument("--mutate", type=int, metavar="N",
                        help="alter flags in N ways; count how many are noticed")  # fmt: skip
    parser.add_argument("--mutate-seed", type=int, default=0, metavar="SEED",
                        help="seed of the alterations (default: 0)")  # fmt: skip
    parser.add_argument("--expect-noticed", type=percentage, metavar="PERCENT",
                        help="exit 1 if less than PERCENT of these is noticed")  # fmt: skip


def run(options: argparse.Namespace, scenarios: list[tuple[str, Scenario]]) -> int:
    """Print which mutants the suite notices, and for the others a shipped scenario that does.

    Exit 1 if a scenario fails without a mutant, or if fewer mutants are noticed than expected.
    """
    from gateway.hil.mutants import mutants
    from gateway.hil.mutating import judged

    _refuse(options)
    suite = list(_recorded(options, scenarios))
    failing = [run.name for run in suite if not run.passed]
    if failing:
        print(f"FAIL without a mutant: {', '.join(failing)}")
        return FAILED
    chosen = mutants(options.mutate, options.mutate_seed)
    results = [judged(one, suite) for one in track(chosen, "mutants", len(chosen))]
    return _printed(options, results, {name for name, _ in scenarios})


def run_tests(options: argparse.Namespace) -> int:
    """As `run`, for test files and folders that pytest runs, once for each mutant.

    Exit 1 if pytest fails without a mutant. Raises ConfigError if it finds no test.
    """
    from gateway.hil.mutants import mutants
    from gateway.hil.mutating import Result, judged_by_tests

    _refuse(options)
    if options.config is not None:
        why = "--config is for scenarios; a test names its own: @pytest.mark.hil(config=..)"
        raise ConfigError("--mutate", [why])
    if failing := judged_by_tests(options.scenario):
        print(f"FAIL without a mutant: {failing}")
        return FAILED
    results = []
    chosen = mutants(options.mutate, options.mutate_seed)
    for number, mutant in enumerate(track(chosen, "mutants", len(chosen)), 1):
        word = f"{number}:{options.mutate_seed}"
        results.append(Result(mutant, judged_by_tests(options.scenario, word), alters=True))
    return _printed(options, results, set())


def is_tests(name: str) -> bool:
    """Whether this is a folder or a file of tests in Python, and no scenario."""
    path = Path(name.partition("::")[0])
    return path.is_dir() or path.suffix == ".py"


def _refuse(options: argparse.Namespace) -> None:
    """Raise ConfigError for options that do not go together with mutants."""
    if names_bus(options) or options.mutate < 1:
        raise ConfigError("--mutate", ["needs N of at least 1, and no bus: it has a virtual clock"])


def _printed(options: argparse.Namespace, results: list[Result], known: set[str]) -> int:
    """Print the result for each mutant, and cures; return the exit code."""
    if len(results) < options.mutate:
        note(f"only {len(results)} different mutants exist; all are run")
    for result in results:
        print(f"{_word(result):12} {result.mutant.text}")
    missed = [result for result in results if result.noticed_by is None]
    share = 100.0 * (1.0 - len(missed) / len(results))
    print(f"{len(results) - len(missed)} of {len(results)} mutants noticed ({share:.0f} %)")
    for line in _cures(options, missed, known):
        print(line)
    return FAILED if options.expect_noticed is not None and share < options.expect_noticed else GOOD


def _word(result: Result) -> str:
    return result.noticed_by or ("NOT NOTICED" if result.alters else "NO EFFECT")


def _recorded(
    options: argparse.Namespace, scenarios: Iterable[tuple[str, Scenario]]
) -> Iterator[Recorded]:
    """Recordings of the correct gateway in each scenario."""
    from gateway.hil.fitting import fitted
    from gateway.hil.mutating import record

    every = list(scenarios)
    for name, scenario in track(every, "scenarios", len(every)):
        yield record(name, *fitted(options.config, scenario, options))


def _cures(options: argparse.Namespace, missed: list[Result], known: set[str]) -> Iterator[str]:
    """Lines naming the shipped scenario that notices each missed mutant, shortest first."""
    from gateway.hil.mutating import judged
    from sim.scenario import builtin, builtin_names

    shipped = [(name, builtin(name)) for name in builtin_names() if name not in known]
    shipped = sorted(
        ((name, one) for name, one in shipped if one.expect), key=lambda pair: pair[1].duration_s
    )
    left = [result.mutant for result in missed]
    for run in _recorded(options, shipped) if left else ():
        for mutant in list(left):
            if judged(mutant, [run]).noticed_by:
                yield f"`{run.name}` would have noticed: {mutant.text}"
                left.remove(mutant)
        if not left:
            return
    yield from (f"no shipped scenario notices: {mutant.text}" for mutant in left)
