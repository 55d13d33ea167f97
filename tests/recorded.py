"""Arrays that take long to make, kept in `out/recorded` while what they are made of is the same.

A pure function of its sources gives the same arrays as long as these are the same: their digest is
in the file's name.
"""

import hashlib
import os
import sys
from pathlib import Path

import numpy as np

ROOT = Path(__file__).parents[1]
KEPT = ROOT / "out" / "recorded"
SUFFIXES = {".py", ".c", ".h", ".dbc", ".toml"}


def recorded(name, make, sources, *arguments):
    """What `make` gives. sources: files and folders that it depends on, and its arguments."""
    digest = hashlib.sha256(repr((sys.version, np.__version__, arguments)).encode())
    for source in sources:
        files = sorted(source.rglob("*")) if source.is_dir() else [source]
        for file in files:
            if file.suffix in SUFFIXES:
                digest.update(file.relative_to(ROOT).as_posix().encode() + file.read_bytes())
    path = KEPT / f"{name}-{digest.hexdigest()[:32]}.npz"
    if not path.is_file():
        _write(path, make())
    with np.load(path) as file:
        return dict(file)


def _write(path, arrays):
    """Whole or not at all: several processes may write the same."""
    KEPT.mkdir(parents=True, exist_ok=True)
    part = path.with_name(f".{os.getpid()}-{path.name}")
    np.savez(part, **arrays)
    part.replace(path)
