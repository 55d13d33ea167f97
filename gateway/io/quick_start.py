"""A faster start: prevents libraries from loading optional libraries that are not needed.

python-can loads asammdf for MF4 logs, and that pandas and pyarrow: 1 s.

It is for the beginning of a program, before it has threads: an import in another thread
would fail meanwhile as well.
"""

from __future__ import annotations

import gc
import importlib
import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from types import ModuleType


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
    """Load python-can without MF4; `dbc.logs.python_can.mf4_module` makes up for it."""
    with absent("asammdf"):
        importlib.import_module("can")


def pydantic() -> None:
    """Load no plugins of it: to look for some it reads the names of all that is installed."""
    name = "pydantic.plugin._loader"
    if name not in sys.modules:
        none = ModuleType(name)
        vars(none)["get_plugins"] = tuple
        sys.modules[name] = none


def one_blas_thread() -> None:
    """NumPy starts no threads for large matrices: they would wait for work, busily."""
    if "numpy" not in sys.modules:
        os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")


@contextmanager
def unsearched() -> Iterator[None]:
    """No search for garbage meanwhile: what a start makes stays, and is searched repeatedly.

    Nor at once afterwards: all of it counts as old.
    """
    before = gc.isenabled()
    gc.disable()
    try:
        yield
    finally:
        if before:
            if not gc.get_freeze_count():
                gc.freeze()
                gc.unfreeze()
            gc.enable()


@contextmanager
def uncollected() -> Iterator[None]:
    """The same, nor later among what was made.

    `gc.unfreeze` ends that; see `live.frozen_garbage`.
    """
    with unsearched():
        yield
        gc.freeze()
