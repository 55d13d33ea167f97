"""A start without what it does not need: libraries load others of theirs wherever these are there.

python-can loads asammdf for MF4 logs, and that pandas and pyarrow: 1 s. numba loads scipy.linalg
for products of matrices, and cffi and coverage for what nobody here does: 0.2 s.

All of it is for the beginning of a program, before it has threads: an import in another thread
would fail meanwhile as well.
"""

from __future__ import annotations

import gc
import importlib
import sys
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from importlib.util import find_spec
from types import ModuleType
from typing import Final

_NUMBAS: Final = ("cffi", "coverage")
_LOOKING: Final = ("numba", "numba.core.typing.cffi_utils", "numba.np.arraymath")
"""What looks for them; the first compiled function loads the last two anyway."""
_BLAS: Final = "scipy.linalg.cython_blas"


@contextmanager
def absent(*names: str) -> Iterator[None]:
    """Importing these fails meanwhile, as if they were not installed; not if they are loaded."""
    hidden = [name for name in names if name not in sys.modules]
    sys.modules.update(dict.fromkeys(hidden))  # type: ignore[arg-type] # None: what imports expect
    try:
        yield
    finally:
        for name in hidden:
            sys.modules.pop(name, None)


def python_can() -> None:
    """Load python-can without MF4; `dbc.otherlogs.mf4_module` makes up for it."""
    with absent("asammdf"):
        importlib.import_module("can")


def numba() -> None:
    """Load numba and what it has compiled functions call, without what these do not need.

    It looks whether scipy.linalg is there by loading it. A stand-in says so; the real one is loaded
    by the first product of matrices, if any: who compiles or calls one asks for it again.
    """
    if "numba" in sys.modules:
        return
    with absent(*_NUMBAS), _seemingly_loaded(_BLAS):
        for name in _LOOKING:
            with suppress(ImportError):
                importlib.import_module(name)


@contextmanager
def _seemingly_loaded(name: str) -> Iterator[None]:
    if name in sys.modules or find_spec(name.partition(".")[0]) is None:
        yield
        return
    stand_in = ModuleType(name)
    sys.modules[name] = stand_in
    try:
        yield
    finally:
        if sys.modules.get(name) is stand_in:
            del sys.modules[name]


@contextmanager
def uncollected() -> Iterator[None]:
    """No search for garbage meanwhile, nor later among what was made: nearly all of it stays.

    `gc.unfreeze` ends that; see `live.frozen_garbage`.
    """
    before = gc.isenabled()
    gc.disable()
    try:
        yield
        gc.freeze()
    finally:
        if before:
            gc.enable()
