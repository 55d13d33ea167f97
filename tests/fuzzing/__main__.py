"""Fuzz the eight targets with atheris: `make fuzz-deep SECONDS=600`.

    python -m tests.fuzzing --seconds 600 -j 2 -o tests/fuzzing/executions.jsonl

A process per target and run; a line of JSON per run in the file, which grows. An execution is one
call with one input. What is found is saved below `--work` and printed; then that target stops.
Exit code 1 where anything was found.
"""

import argparse
import json
import os
import subprocess
import sys
import threading
from concurrent.futures import ThreadPoolExecutor
from importlib.util import find_spec
from pathlib import Path

from tests.core_variants import build
from tests.provenance import commit_of

UNITS = {
    "candump": "lines", "readers": "lines", "frames": "frames", "tick": "ticks", "values": "ticks",
    "dbc": "codecs", "config": "configurations", "scenario": "scenarios",
}  # fmt: skip
NAMES = tuple(UNITS)


def instrumented():
    """Environment in which the core is one that libFuzzer and the sanitizers watch."""
    spec = find_spec("atheris")
    if spec is None or spec.origin is None:
        sys.exit("fuzzing: the tick needs atheris, see `make fuzz-deep`")
    library = Path(spec.origin).parents[1] / "asan_with_fuzzer.so"
    paths = [str(build("libfuzzer")), *sys.path]
    return {
        "LD_PRELOAD": str(library), "PYTHONPATH": os.pathsep.join(filter(None, paths)),
        "ASAN_OPTIONS": "detect_leaks=0", "UBSAN_OPTIONS": "print_stacktrace=1",
    }  # fmt: skip


def _run(name, seed, options):
    """One process of one target; what it came to."""
    commit, work = commit_of(Path(__file__).parent), options.work / name
    work.mkdir(parents=True, exist_ok=True)
    report = work / f"{seed}.json"
    report.unlink(missing_ok=True)
    log = work / f"{seed}.txt"
    with log.open("wb") as out:
        code = subprocess.run(
            [sys.executable, "-m", "tests.fuzzing.engine", name, str(options.seconds),
             str(options.runs), str(seed), str(options.longest), str(work / "inputs"), str(report)],
            stdout=out, stderr=out, check=False, env={**os.environ, **options.environment[name]},
        ).returncode  # fmt: skip
    told = json.loads(report.read_text()) if report.exists() else {"executions": 0, "found": 0}
    if code:
        # Also what libFuzzer itself stops for: a hang, or memory.
        told["found"] = max(1, told["found"])
        print(f"{name}, seed {seed}: stopped, see {log} and {report}.*", flush=True)
    return {"target": name, "seed": seed, "commit": commit, **told}


def summary(lines):
    """Markdown: a row per target, over all runs."""
    out = [
        "| target | runs | executions | a second | inside the inputs | found |",
        "|---|---|---|---|---|---|",
    ]
    for name in NAMES:
        mine = [line for line in lines if line["target"] == name]
        if not mine:
            continue
        runs, items, found = (
            sum(line.get(key, 0) for line in mine) for key in ("executions", "items", "found")
        )
        seconds = sum(line.get("seconds", 0) for line in mine) or 1
        out.append(
            f"| {name} | {len(mine)} | {runs:,} | {runs / seconds:,.0f} | {items:,} {UNITS[name]} "
            f"| {found} |"
        )
    total = sum(line["executions"] for line in lines)
    return "\n".join([*out, "", f"{total:,} executions."])


def main():
    """Run what is asked for, and add it to the file."""
    parser = argparse.ArgumentParser(prog="python -m tests.fuzzing", description=__doc__)
    parser.add_argument("--targets", nargs="+", choices=NAMES, default=list(NAMES))
    parser.add_argument("--seconds", type=float, default=600, help="per target and seed")
    parser.add_argument("--runs", type=int, default=1 << 60, help="most executions, the same")
    parser.add_argument("--seeds", default="1", help="first-last, or one")
    parser.add_argument("--longest", type=int, default=0, help="bytes of an input; 0: the target's")
    parser.add_argument("-j", type=int, default=1, help="processes")
    parser.add_argument("--work", type=Path, default=Path("out/fuzz"), help="inputs and finds")
    parser.add_argument("-o", type=Path, help="a line of JSON per run is added to this file")
    options = parser.parse_args()
    options.environment = {name: {} for name in NAMES}
    if "tick" in options.targets:
        options.environment["tick"] = instrumented()
    first, _, last = options.seeds.partition("-")
    seeds = range(int(first), int(last or first) + 1)
    lock = threading.Lock()
    lines = []

    def one(job):
        line = _run(job[1], job[0], options)
        with lock:
            lines.append(line)
            print(json.dumps(line), flush=True)
            if options.o is not None:
                with options.o.open("a") as file:
                    file.write(json.dumps(line) + "\n")

    with ThreadPoolExecutor(options.j) as pool:
        list(pool.map(one, [(seed, name) for seed in seeds for name in options.targets]))
    if options.o is not None:
        lines_kept = [json.loads(line) for line in options.o.read_text().splitlines()]
        print(summary(lines_kept))
    else:
        print(summary(lines))
    return int(any(line["found"] for line in lines))


if __name__ == "__main__":
    sys.exit(main())
