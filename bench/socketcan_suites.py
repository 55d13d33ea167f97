"""`python -m bench.socketcan_suites`: tests of python-can, canopen, cantools where CAN is real.

Their sdists, of the versions that are installed, are unpacked and their own tests run twice: as
they are, and behind `traction-gateway vcan`. Printed is a table in Markdown: how many tests pass,
fail and are skipped, and how many of those that are skipped outside run and pass inside.
"""

from __future__ import annotations

import argparse
import os
import subprocess
import sys
import tarfile
import time
from importlib.metadata import version
from pathlib import Path
from typing import NamedTuple
from xml.etree import ElementTree as ET

PACKAGES = {"python-can": "test", "canopen": "test", "cantools": "tests"}
"""Name on the index, and the folder of its tests."""
TOOLS = ("parameterized==0.9.0", "freezegun==1.5.5", "pyserial==3.5")
"""What the tests need and this project does not."""
LINKS = "vcan0,vxcan0,slcan0"
"""Those that python-can's own script makes."""
HEAD = ("tests of", "outside: passed", "skipped", "failed", "inside: passed", "skipped", "failed",
        "skipped outside, passed inside", "failed inside only")  # fmt: skip


class Suite(NamedTuple):
    """Names of the tests by how they ended."""

    passed: frozenset[str]
    skipped: frozenset[str]
    failed: frozenset[str]

    def counts(self) -> list[str]:
        """In this order."""
        return [str(len(names)) for names in self]


def sources(name: str, folder: Path) -> Path:
    wanted = f"{name}=={version(name)}"
    command = [sys.executable, "-m", "pip", "download", "-q", "--no-deps", "--no-binary", ":all:"]
    subprocess.run([*command, "-d", str(folder), wanted], check=True)
    stem = f"{name.replace('-', '_')}-{version(name)}"
    with tarfile.open(folder / f"{stem}.tar.gz") as archive:
        archive.extractall(folder, filter="data")
    return folder / stem


def judged(report: Path) -> Suite:
    found: dict[str, set[str]] = {"passed": set(), "skipped": set(), "failed": set()}
    for case in ET.parse(report).iter("testcase"):
        name = f"{case.get('classname')}::{case.get('name')}"
        bad = case.find("failure") is not None or case.find("error") is not None
        kind = "failed" if bad else "skipped" if case.find("skipped") is not None else "passed"
        found[kind].add(name)
    return Suite(*(frozenset(found[kind]) for kind in Suite._fields))


def run(root: Path, tests: str, tools: Path, *, inside: bool) -> Suite:
    report = root / f"{'inside' if inside else 'outside'}.xml"
    # pytest of the project would read our options: theirs only.
    command = [sys.executable, "-m", "pytest", "-q", "-p", "no:cacheprovider", "-p",
               "no:traction_gateway", "-o", "addopts=", "--continue-on-collection-errors",
               "--junitxml", str(report), tests]  # fmt: skip
    if inside:
        vcan = [sys.executable, "-m", "gateway", "vcan", "--interfaces", LINKS, "--"]
        command = [*vcan, *command]
    path = os.pathsep.join([str(Path(sys.executable).parent), os.environ.get("PATH", "")])
    environment = {
        **os.environ, "PYTHONPATH": os.pathsep.join([str(tools), str(Path.cwd())]), "PATH": path,
        "TEST_SOCKETCAN": "true" if inside else "",
    }  # fmt: skip
    began = time.monotonic()
    subprocess.run(command, cwd=root, env=environment, check=False, capture_output=True)
    print(f"{root.name} {report.stem}: {time.monotonic() - began:.0f} s", file=sys.stderr)
    return judged(report)


def row(name: str, outside: Suite, inside: Suite) -> list[str]:
    gained = outside.skipped & inside.passed
    lost = inside.failed - outside.failed
    for test in sorted(lost):
        print(f"fails inside only: {test}", file=sys.stderr)
    return [f"{name} {version(name)}", *outside.counts(), *inside.counts(), str(len(gained)),
            str(len(lost))]  # fmt: skip


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("-o", "--output", type=Path, default=Path("out/suites"))
    parser.add_argument("packages", nargs="*", default=list(PACKAGES))
    options = parser.parse_args()
    folder = options.output.absolute()
    tools = folder / "tools"
    tools.mkdir(parents=True, exist_ok=True)
    pip = [sys.executable, "-m", "pip", "install", "-q", "--no-deps", "--target", str(tools)]
    subprocess.run([*pip, *TOOLS], check=True)
    table = [HEAD, ["---"] * len(HEAD)]
    for name in options.packages:
        root = sources(name, folder)
        outside, inside = (
            run(root, PACKAGES[name], tools, inside=where) for where in (False, True)
        )
        table.append(row(name, outside, inside))
    print("\n".join("| " + " | ".join(line) + " |" for line in table))


if __name__ == "__main__":
    main()
