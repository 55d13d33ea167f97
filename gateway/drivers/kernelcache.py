"""A folder of kernels that were compiled ahead (`warm`), for a service that only reads it (`run`).

In it is one folder per program, named by a hash over everything that compiled code depends on. A
service takes the one of its own name or does not start: other code must never decide its flags.
How a compiled function is kept, and checked when it is read, is `dbc._kernelcache`.
"""

from __future__ import annotations

import hashlib
import logging
import re
import shutil
from pathlib import Path
from typing import Final

from gateway.drivers import leanstart

log = logging.getLogger(__name__)

KEPT: Final = 3
"""Programs in one folder: the newest, and some to go back to."""


def identity() -> str:
    """16 hex digits: of all sources, the versions of numba, llvmlite and NumPy, the processor."""
    leanstart.numba()
    from numba.core.registry import cpu_target

    import gateway
    from dbc._kernelcache import PRODUCT, VERSIONS, sources

    root = str(Path(gateway.__path__[0]).parent)
    processor = cpu_target.target_context.codegen().magic_tuple()
    total = hashlib.sha256(f"{VERSIONS} {processor}".encode())
    for package in PRODUCT:
        for module, file in sorted(sources(root, package).items()):
            digest = hashlib.sha256(Path(file).read_bytes()).hexdigest()
            total.update(f"\n{module} {digest}".encode())
    return total.hexdigest()[:16]


def make(folder: Path) -> Path:
    """Have everything that is compiled from now on kept in `folder`, and return where there.

    Of other programs' kernels the newest stay. Raises OSError.
    """
    from dbc._kernelcache import Settings

    Settings.folder = place = (folder / identity()).resolve()
    place.mkdir(parents=True, exist_ok=True)
    place.touch()
    old = sorted(_programs(folder), key=lambda path: path.stat().st_mtime_ns)
    for path in old[:-KEPT]:
        shutil.rmtree(path, ignore_errors=True)
    return place


def use(folder: Path) -> None:
    """Take compiled functions from what `make` left in `folder`, and write nothing.

    Raises ConfigError if that has nothing for this program.
    """
    from gateway.config import ConfigError

    wanted = identity()
    if not (folder / wanted).is_dir():
        others = ", ".join(sorted(path.name for path in _programs(folder))) or "nothing"
        raise ConfigError(str(folder), [
            f"no kernels of this program, numba, NumPy and processor ({wanted}; there: {others}): "
            f"make them with `traction-gateway warm -o {folder} [CONFIG]`"
        ])  # fmt: skip
    from dbc._kernelcache import Settings

    Settings.folder, Settings.write = folder / wanted, False


def tell() -> None:
    """After the warm-up: say what `use` had not; a service should have to compile nothing."""
    from dbc._kernelcache import Settings

    if Settings.folder is None:
        return
    if Settings.compiled:
        log.warning("%d kernels were compiled in this start, which is slow: they are missing or "
                    "damaged in %s; repeat `traction-gateway warm`",
                    Settings.compiled, Settings.folder)  # fmt: skip
    else:
        log.info("%d kernels were ready", count(Settings.folder))


def count(folder: Path) -> int:
    """Compiled functions in a folder."""
    return sum(1 for _ in folder.rglob("*.nbc"))


def lost() -> int:
    """Functions that were compiled and could not be kept."""
    from dbc._kernelcache import Settings

    return Settings.lost


def _programs(folder: Path) -> list[Path]:
    """What `make` left there, now or earlier."""
    if not folder.is_dir():
        return []
    return [path for path in folder.iterdir() if re.fullmatch("[0-9a-f]{16}", path.name)]
