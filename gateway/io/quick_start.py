"""A faster start: keep libraries from loading optional libraries that are not needed.

python-can loads asammdf for MF4 logs, which loads pandas and pyarrow: 1 s.

Use this at the beginning of a program, before it has threads: meanwhile, an import in another
thread would fail as well.
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
    """Make imports of these modules fail as if not installed, unless they are loaded already."""
    hidden = [name for name in names if name not in sys.modules]
    sys.modules.update(dict.fromkeys(hidden))  # type: ignore[arg-type] # None: what imports expect
    try:
        yield
    finally:
        for name in hidden:
            sys.modules.pop(name, None)


def python_can() -> None:
    """Load python-can without MF4 support; `dbc.logs.python_can.mf4_module` adds it later."""
    with absent("asammdf"):
        importlib.import_module("can")


def pydantic() -> None:
    """Disable plugins of pydantic: the search reads the metadata of all installed packages."""
    name = "pydantic.plugin._loader"
    if name not in sys.modules:
        none = ModuleType(name)
        vars(none)["get_plugins"] = tuple
        sys.modules[name] = none


def one_blas_thread() -> None:
    """Keep NumPy from starting threads for large matrices, which would busy-wait for work."""
    if "numpy" not in sys.modules:
        os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")


@contextmanager
def unsearched() -> Iterator[None]:
    """Disable garbage collection: what a start makes stays, and would be searched repeatedly.

    Afterwards these objects count as old, so that they are not searched at once either.
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
    """As `unsearched`, and exempt the objects made from later collections as well.

    `gc.unfreeze` ends the exemption; see `live.frozen_garbage`.
    """
    with unsearched():
        yield
        gc.freeze()
