"""Which code a long run's row in a file of results is of."""

import hashlib
import subprocess
import sys
from pathlib import Path
from typing import Final

from core_build import DEPENDS, SOURCES

RESULTS: Final = (
    "tests/storm/soak.jsonl",
    "tests/fuzzing/executions.jsonl",
    "tests/soak/results.json",
    "tests/hil/campaign.jsonl",
    "tests/mutation/outcomes.json",
)
"""They grow by each run, and are no code."""
ENVIRONMENT: Final = ".venv"
CORE: Final = "_traction_core.abi3.so"


def commit_of(folder):
    """Which commit the code in a repository is of, `-dirty` if it was changed since."""

    def git(*words):
        done = subprocess.run(
            ["git", "-C", str(folder), *words], capture_output=True, text=True, check=False
        )
        return done.stdout.strip()

    paths = ":/", *(f":(top,exclude){name}" for name in RESULTS)
    changed = git("status", "--porcelain", "--untracked-files=no", "--", *paths)
    return (git("rev-parse", "--short", "HEAD") or "unknown") + ("-dirty" if changed else "")


def code_of(folder):
    """Hash of the modules below a folder that this process has loaded: commits may share it.

    Of the compiled core its sources, which are the same in every clone. Without what cannot change
    a result: the program that was started, which only hands out work, this file, and the
    environment, which is locked.
    """
    started = sys.modules["__main__"]  # multiprocessing gives it a second name
    loaded = [module for module in list(sys.modules.values()) if module is not started]
    files = {Path(getattr(module, "__file__", None) or "/") for module in loaded}
    inside = sorted(path.relative_to(folder) for path in files if path.is_relative_to(folder))
    mine = [path for path in inside if path.parts[0] != ENVIRONMENT]
    if Path(CORE) in mine:
        mine.remove(Path(CORE))
        mine += [Path(name) for name in (*DEPENDS, *SOURCES)]
    here = Path(__file__)
    named = (f"{p}\n".encode() + (folder / p).read_bytes() for p in mine if folder / p != here)
    return hashlib.sha256(b"\0".join(named)).hexdigest()[:12]
