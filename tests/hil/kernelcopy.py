"""Compiled kernels for a guest, in which numba is six times slower."""

from __future__ import annotations

import shutil
import subprocess
import sys
from pathlib import Path

from gateway.drivers.kernelcache import identity

PACKAGES = ("dbc", "estimators", "gateway", "sim")


_WARM_UP = """
from dbc.codec import bind
from gateway.commands.common import scenario_thermal
from gateway.config import parse
from gateway.drivers.warm import warm_up
for name in ("traction.dbc", "traction_fd.dbc"):
    config = parse({"dbc": {"file": name}, "thermal": scenario_thermal()})
    warm_up(config, bind(config.dbc_path, config.nodes))
"""


def compile_kernels() -> None:
    """Outside, where they are kept beside the sources: a guest then only loads them."""
    subprocess.run([sys.executable, "-c", _WARM_UP], check=True)


def copy_kernels(root: Path, target: Path) -> None:
    """Fill a folder that nobody may write to, as `traction-gateway warm` would.

    root: where the packages are.
    """
    place = target / identity()
    place.mkdir(parents=True)
    for package in PACKAGES:
        for file in (root / package).rglob("*.nbc"):
            shutil.copy(file, place)
    for path in (target, *target.rglob("*")):
        path.chmod(0o555 if path.is_dir() else 0o444)
