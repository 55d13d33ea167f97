"""Storms by seed, in several processes; a seed that stands in the file is not run again.

    python -m tests.storm --seeds 0-99 --ticks 1000000 -j 2 -o tests/storm/soak.jsonl
    python -m tests.storm --seeds 2000-2999 --ticks 3000     # with wrong values, runaway wheels

Writes a line per seed, with the commit of the code that was loaded at the start, and prints what
all of them came to. Exit code 1 where a rule was broken.
"""

import argparse
import json
import sys
import time
from collections import Counter
from concurrent.futures import ProcessPoolExecutor, as_completed
from pathlib import Path

from tests.storm.bus_faults import BUS_KINDS, KINDS
from tests.storm.campaign import CODE, COMMIT, VALUE_SEEDS, in_calls, uncovered, weather
from tests.storm.oracle import COMMON, OF_ALL
from tests.storm.train import PHASES

STATES = ("unknown", "good", "bad")


def _line(result, seconds):
    return {
        "seed": result.seed,
        "commit": COMMIT,
        "code": CODE,
        "calls": in_calls(result.seed),
        "ticks": result.ticks,
        "frames": result.frames,
        "seconds": round(seconds, 1),
        "violations": [list(v) for v in result.found],
        "said": {f"{flag} {STATES[state]}": n for (flag, state), n in sorted(result.said.items())},
        "met": _by_phase(result.met),
        "counts": dict(sorted(result.rejected.items())),
    }


def _by_phase(met):
    """Ticks by fault and phase: the drives are summed up, a file of 100 seeds is kept."""
    out = Counter()
    for (kind, phase, *_), n in sorted(met.items()):
        out[f"{kind} {phase}"] += n
    return dict(out)


def _run(seed, ticks):
    began = time.perf_counter()
    return weather(seed, ticks), time.perf_counter() - began


def _code(line):
    """What ran: older lines know the commit alone."""
    return str(line.get("code") or line["commit"])


def _sum(lines, key):
    total = Counter()
    for line in lines:
        total.update(line[key])
    return total


def summary(lines):
    """Markdown: what was run, said, met and counted."""
    said, met, counts = (_sum(lines, key) for key in ("said", "met", "counts"))
    ticks = sum(line["ticks"] for line in lines)
    broken = [(line["seed"], v) for line in lines for v in line["violations"]]
    out = [
        f"{len(lines)} seeds, {ticks:,} ticks ({ticks / 360000:.0f} hours of the train), "
        f"{counts['received']:,} frames: **{len(broken)} violations**; code "
        + ", ".join(f"{code} {n}" for code, n in Counter(map(_code, lines)).most_common())
        + ".",
        "",
        "| flag | unknown | good | bad |",
        "|---|---|---|---|",
    ]
    for flag in ("adhesion", "thermal"):
        cells = " | ".join(f"{said[f'{flag} {state}']:,}" for state in STATES)
        out.append(f"| {flag}, ticks of all drives | {cells} |")
    # Of older lines only the drives' flags are known.
    for flag in (*OF_ALL, COMMON):
        cells = " | ".join(f"{said[f'{flag} {state}']:,}" for state in STATES)
        out.append(f"| {flag}, ticks | {cells} |")
    out += ["", "| ticks under | " + " | ".join(PHASES) + " |", "|---" * (1 + len(PHASES)) + "|"]
    for kind in _kinds(line["seed"] for line in lines):
        cells = [
            sum(n for key, n in met.items() if key.split()[:2] == [kind, phase]) for phase in PHASES
        ]
        out.append(f"| {kind} | " + " | ".join(f"{n:,}" for n in cells) + " |")
    out += ["", "Frames: " + ", ".join(f"{name} {n:,}" for name, n in counts.most_common()) + "."]
    return "\n".join(out + [f"- seed {seed}: {v}" for seed, v in broken])


def _kinds(seeds):
    """Kinds of faults that these seeds may bring."""
    return KINDS if any(seed in VALUE_SEEDS for seed in seeds) else BUS_KINDS


def main():
    """Run what is asked for and not done yet."""
    parser = argparse.ArgumentParser(prog="python -m tests.storm", description=__doc__)
    parser.add_argument("--seeds", default="0-19", help="first-last, or one")
    parser.add_argument("--ticks", type=int, default=100_000, help="of 10 ms, per seed")
    parser.add_argument("-j", type=int, default=1, help="processes")
    parser.add_argument("-o", type=Path, help="a line of JSON per seed")
    parser.add_argument("--anew", action="store_true", help="also seeds that other code has run")
    options = parser.parse_args()
    first, _, last = options.seeds.partition("-")
    wanted = range(int(first), int(last or first) + 1)
    kept = {}
    if options.o is not None and options.o.exists():
        kept = {row["seed"]: row for row in map(json.loads, options.o.read_text().splitlines())}
    # A seed that broke a rule ended early, and is run again.
    done = {
        seed
        for seed, row in kept.items()
        if row["ticks"] == options.ticks
        and not row["violations"]
        and not (options.anew and _code(row) != CODE)
    }
    with ProcessPoolExecutor(options.j) as pool:
        jobs = [pool.submit(_run, seed, options.ticks) for seed in wanted if seed not in done]
        for job in as_completed(jobs):
            result, seconds = job.result()
            kept[result.seed] = _line(result, seconds)
            done.add(result.seed)
            print(
                f"seed {result.seed}: {len(result.found)} violations, {seconds:.0f} s", flush=True
            )
            if result.found:
                print(result.text(), flush=True)
            if options.o is not None:
                options.o.parent.mkdir(parents=True, exist_ok=True)
                part = options.o.with_suffix(".part")
                part.write_text("".join(json.dumps(row) + "\n" for row in kept.values()))
                part.replace(options.o)
    lines = [kept[seed] for seed in wanted if seed in done]
    print(summary(lines))
    missing = uncovered(
        Counter({tuple(key.split()): n for x in lines for key, n in x["met"].items()}),
        _kinds(wanted),
    )
    if missing:
        print("never met:", ", ".join(f"{kind} in {phase}" for kind, phase in missing))
    return int(any(line["violations"] for line in lines))


if __name__ == "__main__":
    sys.exit(main())
