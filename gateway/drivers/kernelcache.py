"""Where compiled kernels are kept, and that a place which is read-only stops nobody.

numba looks for a folder that it can write to: `__pycache__` beside the code, else one at home;
with neither the first import of a kernel fails. An installed service has neither. It gets a folder
that was prepared (`traction-gateway warm`) and copies it to a temporary one of its own: what was
prepared stays read-only, and what is missing in it is compiled, and said. To be made before
anything that imports numba.
"""

from __future__ import annotations

import atexit
import logging
import os
import shutil
import tempfile
from pathlib import Path
from typing import Final

import gateway

log = logging.getLogger(__name__)

VARIABLE: Final = "NUMBA_CACHE_DIR"
CURE: Final = "`traction-gateway warm -o DIR`, and `run --kernels DIR`"


class Kernels:
    """The folder in use, removed at the end of the program if it is a temporary one."""

    def __init__(self, prepared: Path | None = None) -> None:
        """Take those in `prepared`, if given; else wherever numba can write."""
        self._own: Path | None = None
        self._before = 0
        if prepared is None and _can_keep():
            return
        self._own = Path(tempfile.mkdtemp(prefix="traction-gateway-"))
        atexit.register(shutil.rmtree, self._own, ignore_errors=True)
        os.environ[VARIABLE] = str(self._own)
        if prepared is None:
            log.warning("compiled code cannot be kept, so every start compiles: see %s", CURE)
            return
        try:
            _copy(prepared, self._own)
        except OSError as error:
            log.warning("compiled code cannot be used: %s", error)
        self._before = count(self._own)

    def tell(self) -> None:
        """After the warm-up: say what had to be compiled; a service should have nothing to."""
        if self._own is None:
            return
        new = count(self._own) - self._before
        if new:
            log.warning("%d of %d kernels were compiled in this start, which is slow: see %s",
                        new, new + self._before, CURE)  # fmt: skip
        else:
            log.info("%d kernels were ready", self._before)


def make(folder: Path) -> None:
    """Have everything that is compiled from now on kept in `folder`. Raises OSError."""
    folder.mkdir(parents=True, exist_ok=True)
    os.environ[VARIABLE] = str(folder.resolve())


def _copy(prepared: Path, own: Path) -> None:
    """Contents only: what was prepared may be read-only, and numba writes beside what is new."""
    for folder in sorted(prepared.iterdir()):
        (own / folder.name).mkdir()
        for file in sorted(folder.iterdir()):
            shutil.copyfile(file, own / folder.name / file.name)


def count(folder: Path) -> int:
    """Compiled functions in a folder."""
    return sum(1 for _ in folder.rglob("*.nbc"))


def _can_keep() -> bool:
    """Whether numba finds a folder by itself."""
    beside = Path(gateway.__path__[0]) / "__pycache__"
    home = os.environ.get("XDG_CACHE_HOME") or os.path.expanduser("~/.cache")  # noqa: PTH111 - never raises
    named = os.environ.get(VARIABLE)
    places = [beside, Path(home) / "numba", *([Path(named)] if named else [])]
    return any(map(_writable, places))


def _writable(folder: Path) -> bool:
    """Whether files can be made in it, or it can be made."""
    while not folder.exists() and folder != folder.parent:
        folder = folder.parent
    return folder.is_dir() and os.access(folder, os.W_OK | os.X_OK)
