"""Every test, before a release: run by `make test-all`.

    python -m tests.release [pytest arguments]

All tests, those marked `thorough` too, on a core with the sanitizers in it; those that cannot run
so (tests/core_variants.py) and those on a real bus, on the core as it is delivered; the golden logs
on other processors; 500 logs and 200 configurations with accidents; the fuzzer on a whole tick.

It takes two hours. A part that fails does not stop the others. What has passed is kept in
`out/release.json`: the next run goes on with what is left, if the commit is still the same. When
all have passed, the commit goes into `tests/test-all.passed`.
"""

import json
import subprocess
import sys
from pathlib import Path

from tests.core_variants import UNFIT

KEPT = Path("out/release.json")
PASSED = Path("tests/test-all.passed")
PYTEST = [sys.executable, "-m", "pytest"]
PARALLEL = ["-n", "auto", "--dist", "worksteal"]
FILES = 10
"""Test files of one part under the sanitizers."""


def git(*arguments):
    return subprocess.run(
        ["git", *arguments], capture_output=True, text=True, check=True
    ).stdout.strip()


def sanitized():
    """The test files that run under the sanitizers, by part."""
    files = sorted(str(path) for path in Path("tests").rglob("test_*.py"))
    files = [file for file in files if not file.startswith(("tests/hil", *UNFIT))]
    return [files[at : at + FILES] for at in range(0, len(files), FILES)]


def parts(arguments):
    """Command of each part, by name."""
    variants = [sys.executable, "-m", "tests.core_variants"]
    found = {
        f"sanitizers: {files[0]} to {files[-1]}":
            [*variants, "sanitize", *PARALLEL, "--timeout=3600", *arguments, *files]
        for files in sanitized()
    }  # fmt: skip
    return found | {
        "without sanitizers": [*variants, "unfit", *PARALLEL, *arguments],
        "real bus": [*PYTEST, "tests/hil", *arguments],
        "other processors": [sys.executable, "-m", "tests.other_processors"],
        "accidents": [sys.executable, "-m", "tests.foreign.mutated", "--logs", "500",
                      "--configurations", "200"],
        "fuzzer": ["make", "fuzz-tick", "ARGS="],  # those of pytest are none of its own
    }  # fmt: skip


def main(arguments):
    if git("status", "--porcelain", "--untracked-files=no"):
        sys.exit("commit first: what passes is written down by commit")
    commit = git("log", "-1", "--format=%H %cI")
    kept = json.loads(KEPT.read_text()) if KEPT.exists() else {}
    done, failed = kept.get(commit, []), []
    for name, command in parts(arguments).items():
        if name in done:
            print(f"{name}: passed before on this commit", flush=True)
            continue
        print(f"{name}: {' '.join(command)}", flush=True)
        if subprocess.run(command, check=False).returncode:
            failed.append(name)
            continue
        done.append(name)
        KEPT.parent.mkdir(exist_ok=True)
        KEPT.write_text(json.dumps({commit: done}, indent=1))
    if failed:
        sys.exit("failed: " + "; ".join(failed))
    PASSED.write_text(commit + "\n")


if __name__ == "__main__":
    main(sys.argv[1:])
