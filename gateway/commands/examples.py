"""`examples`: write the shipped examples as files: configurations, tests, CI, a container."""

from __future__ import annotations

import argparse
from pathlib import Path

from gateway.commands.common import GOOD, shown
from gateway.settings.config import ConfigError


def arguments(parser: argparse.ArgumentParser) -> None:
    """Options of the verb."""
    parser.add_argument("-o", "--output", type=Path, required=True, metavar="DIR",
                        help="a new folder")  # fmt: skip


def run(options: argparse.Namespace) -> int:
    """Write the examples. Raises ConfigError if the folder exists already, OSError."""
    from shutil import copyfile

    from gateway.io.whole_file import whole_folder

    if options.output.exists():
        raise ConfigError(f"{options.output}: already exists", ["name a new folder"])
    source = shipped()
    with whole_folder(options.output) as folder:
        for path in sorted(source.rglob("*")):
            if path.is_file() and path.parent.name != "__pycache__":
                target = folder / path.relative_to(source)
                target.parent.mkdir(parents=True, exist_ok=True)
                copyfile(path, target)
    for path in sorted(options.output.iterdir()):
        print(f"written: {shown(path)}")
    return GOOD


def shipped() -> Path:
    """Folder of the examples: inside the installed package, or beside it in a checkout."""
    import gateway

    package = Path(gateway.__path__[0])
    inside = package / "examples"
    return inside if inside.is_dir() else package.parent / "examples"
