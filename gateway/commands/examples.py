"""`examples`: the examples that ship, as files: configurations, tests, CI, a container."""

from __future__ import annotations

import argparse
from pathlib import Path

from gateway.commands.common import GOOD, shown


def arguments(parser: argparse.ArgumentParser) -> None:
    """Options of the verb."""
    parser.add_argument("-o", "--output", type=Path, required=True, metavar="DIR",
                        help="a new folder")  # fmt: skip


def run(options: argparse.Namespace) -> int:
    """Write them. Raises ConfigError where something is there already, OSError."""
    import shutil

    from gateway.settings.config import ConfigError

    if options.output.exists():
        raise ConfigError(f"{options.output}: is there already", ["name a new folder"])
    shutil.copytree(
        shipped(), options.output, ignore=shutil.ignore_patterns("__pycache__"),
        copy_function=shutil.copyfile,
    )  # fmt: skip
    for path in sorted(options.output.iterdir()):
        print(f"written: {shown(path)}")
    return GOOD


def shipped() -> Path:
    """In the package where it is installed, beside it in a checkout."""
    import gateway

    package = Path(gateway.__path__[0])
    inside = package / "examples"
    return inside if inside.is_dir() else package.parent / "examples"
