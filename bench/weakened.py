"""`python -m bench.weakened`: faults that the shipped scenarios notice, whole and weakened.

In 20 trials a random half of the expectations is left out, in 20 more a random half of the
scenarios. A quarter of an hour. Only faults that alter frames: each expectation is then checked
alone, on the recorded frames, and no trial needs a run of its own.
"""

from __future__ import annotations

import random

from gateway.hil.fitting import fitting
from gateway.hil.mutants import mutants
from gateway.hil.mutating import judged, record
from sim.scenario import builtin, builtin_names

TRIALS = 20


def main() -> None:
    """Print how many faults are noticed."""
    chosen = [one for one in mutants(60, 0) if one.settings is None]
    noticed: dict[tuple[str, int], set[str]] = {}
    for name in builtin_names():
        scenario = builtin(name)
        if not scenario.expect:
            continue
        run = record(name, scenario, *fitting(None, scenario))
        for k, expect in enumerate(scenario.expect):
            only = run._replace(scenario=scenario.model_copy(update={"expect": [expect]}))
            noticed[name, k] = {m.text for m in chosen if judged(m, [only]).noticed_by}
    print(f"whole: {len(set().union(*noticed.values()))} of {len(chosen)}")
    names = list(dict.fromkeys(name for name, _ in noticed))
    for what, keys in (("expectations", list(noticed)), ("scenarios", names)):
        found = []
        for seed in range(TRIALS):
            out = set(random.Random(seed).sample(keys, len(keys) // 2))
            kept = (v for key, v in noticed.items() if key not in out and key[0] not in out)
            found.append(len(set().union(*kept)))
        print(f"without half of the {what}: {sorted(found)}")


if __name__ == "__main__":
    main()
