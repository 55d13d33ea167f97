"""Compiled kernels as `traction-gateway warm` leaves them, from those that are compiled already."""

from __future__ import annotations

import shutil
from pathlib import Path

from numba.core.caching import UserProvidedCacheLocator

PACKAGES = ("dbc", "estimators", "gateway", "sim")


def copy_kernels(root: Path, target: Path, seen_as: Path | None = None) -> None:
    """Fill a folder that nobody may write to.

    root: where the packages are; seen_as: where they will be for who uses the kernels.
    """
    for package in PACKAGES:
        for cache in (root / package).rglob("__pycache__"):
            beside = (seen_as or root) / cache.relative_to(root).parent / "x.py"
            name = UserProvidedCacheLocator.get_suitable_cache_subpath(str(beside))
            for file in cache.glob("*.nb?"):
                (target / name).mkdir(parents=True, exist_ok=True)
                shutil.copy(file, target / name)
    for path in (target, *target.rglob("*")):
        path.chmod(0o555 if path.is_dir() else 0o444)
