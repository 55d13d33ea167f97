"""One target under atheris: coverage by instrumented Python, inputs by libFuzzer and `mutate`.

Started by `python -m tests.fuzzing`, in a process of its own: what is instrumented is decided
before anything is imported, and libFuzzer ends the process.
"""

import json
import os
import random
import shutil
import sys
import time
from pathlib import Path

PACKAGES = {
    "candump": ["dbc"],
    "readers": ["dbc"],
    "frames": ["dbc", "gateway", "tests"],
    "tick": ["tests.fuzzing.tick"],  # and the core in C, which is built for it
    "values": ["gateway", "sim", "tests"],
    "dbc": ["dbc", "cantools", "textparser"],
    "config": ["gateway", "tomllib"],
    "scenario": ["sim", "tomllib"],
}
"""Whose code is looked at for coverage, by target."""
PART = 1 << 10


def _dictionary(tokens, report):
    """A file of words as libFuzzer reads them."""
    path = Path(report).with_suffix(".dict")
    words = ("".join(f"\\x{byte:02x}" for byte in token) for token in tokens if len(token) <= 64)
    path.write_text("".join(f'"{word}"\n' for word in words))
    return str(path)


def main():
    """Arguments: target, seconds, most executions, seed, longest input (0: the target's), output
    folder, report."""
    name, seconds, runs, seed, longest, out, report = sys.argv[1:]
    import atheris  # in a folder of its own, see the Makefile

    with atheris.instrument_imports(PACKAGES[name]):
        from tests.fuzzing.mutate import mutate
        from tests.fuzzing.targets import CORPUS, TARGETS
        from tests.fuzzing.texts import FOLDER
    target = TARGETS[name]
    kept = target.corpus()
    state = {"executions": 0, "items": 0, "found": 0}
    began = time.monotonic()
    end, most = began + float(seconds), int(runs)

    def tell():
        line = {**state, "seconds": round(time.monotonic() - began, 1)}
        Path(report).write_text(json.dumps(line))

    def once(data):
        state["executions"] += 1
        try:
            state["items"] += target.run(data)
        except BaseException:
            # libFuzzer saves the input and ends the process.
            state["found"] += 1
            tell()
            shutil.rmtree(FOLDER, ignore_errors=True)
            raise
        if state["executions"] % PART == 0 or state["executions"] >= most:
            tell()
            if state["executions"] >= most or time.monotonic() >= end:
                # libFuzzer has no other way to be stopped from here without calling it a crash.
                shutil.rmtree(FOLDER, ignore_errors=True)
                sys.stderr.flush()
                os._exit(0)

    def other(data, most, seed):
        if seed & 1:
            return atheris.Mutate(data, most)
        return mutate(data, random.Random(seed), target.tokens, kept, most)

    found = Path(out)
    found.mkdir(parents=True, exist_ok=True)
    atheris.Setup(
        [
            sys.argv[0], str(found), str(CORPUS / name), f"-seed={seed}", "-timeout=60",
            f"-max_len={int(longest) or target.longest}", f"-artifact_prefix={report}.",
            "-rss_limit_mb=4096", "-reload=0", "-verbosity=0",
            f"-dict={_dictionary(target.tokens, report)}",
        ],
        once,
        **({"custom_mutator": other} if target.is_slow else {}),
    )  # fmt: skip
    atheris.Fuzz()


if __name__ == "__main__":
    main()
