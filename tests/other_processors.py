"""The golden logs on other processors, which must give the same bytes; run by `make test-all`.

    python -m tests.other_processors [x86-64-v2 x86-64-v3 x86-64-v4 aarch64]

Needs qemu-user. It has no AVX-512: x86-64-v4 is this machine if it is one; if not, the command says
that it was not run. The x86-64 ones run this environment as it is. For AArch64 a root is made in
`out/aarch64`: Debian's Python (apt), the wheels of `requirements.lock` (pip), the core by ziglang.
"""

from __future__ import annotations

import os
import re
import shutil
import subprocess
import sys
from collections.abc import Set
from pathlib import Path

V4 = "x86-64-v4"
FEATURES = {"avx512f", "avx512bw", "avx512cd", "avx512dq", "avx512vl"}
"""What makes a processor an x86-64-v4."""
TESTS = ["-m", "pytest", "-q", "-p", "no:cacheprovider", "-o", "timeout=3600", "tests/golden"]
X86 = {"x86-64-v2": "Nehalem", "x86-64-v3": "Haswell"}
"""Processors without AVX, and with AVX2 but without AVX-512."""
BLAS = {"OPENBLAS_CORETYPE": "Nehalem"}
"""It takes some of the emulated ones for others, with AVX."""
ROOT = Path("out/aarch64").absolute()
DEBIAN = ("python3", "libstdc++6")
WHEELS = {
    "annotated-types", "argparse-addons", "attrs", "bitstruct", "canopen", "cantools", "cffi",
    "crccheck", "cryptography", "diskcache", "hypothesis", "iniconfig", "markdown-it-py", "mdurl",
    "msgpack", "numpy", "packaging", "pluggy", "pycparser", "pydantic", "pydantic-core", "pygments",
    "pytest", "pytest-timeout", "python-can", "rich", "scipy", "sortedcontainers", "textparser",
    "typing-extensions", "typing-inspection", "wrapt",
}  # fmt: skip
"""What the golden tests import, and what that imports."""
PLATFORMS = ("manylinux2014", "manylinux_2_17", "manylinux_2_26", "manylinux_2_28")
MIRROR = "deb http://deb.debian.org/debian bookworm main\n"


def x86(processor: str) -> int:
    """Exit status of the golden tests on this processor."""
    return subprocess.run(
        [qemu("x86_64"), "-cpu", X86[processor], os.path.realpath(sys.executable), *TESTS],
        env={**os.environ, "PYTHONPATH": os.pathsep.join([".", *packages()]), **BLAS}, check=False,
    ).returncode  # fmt: skip


def native() -> int | None:
    """Exit status of the golden tests on this machine if it is an x86-64-v4, else None."""
    words = set(Path("/proc/cpuinfo").read_text().split())
    if not words >= FEATURES:
        return None
    return subprocess.run([sys.executable, *TESTS], check=False).returncode


def packages() -> list[str]:
    """Where this environment's libraries are: the interpreter itself is started without it."""
    return [path for path in sys.path if path.endswith("-packages")]


def qemu(name: str) -> str:
    """The emulator's path; ends the program where there is none."""
    path = shutil.which(f"qemu-{name}")
    if path is None:
        sys.exit(f"other processors: qemu-{name} is missing (Debian: apt-get install qemu-user)")
    return path


def aarch64() -> int:
    """Exit status of the golden tests on AArch64."""
    emulator = qemu("aarch64")
    debian()
    wheels()
    core()
    # Before the checkout, where the core of this machine lies.
    paths = ["-o", f"pythonpath={ROOT}/core {ROOT}/site ."]
    return subprocess.run(
        [emulator, "-L", f"{ROOT}/debian", f"{ROOT}/debian/usr/bin/python3.11", *TESTS, *paths],
        env={**os.environ, "PYTHONPATH": f"{ROOT}/core:{ROOT}/site"}, check=False,
    ).returncode  # fmt: skip


def debian() -> None:
    """Unpack Python for AArch64; apt's own state stays apart from this machine's."""
    if (ROOT / "debian/usr/bin/python3.11").exists():
        return
    state, cache = ROOT / "apt/state", ROOT / "apt/cache"
    (state / "lists/partial").mkdir(parents=True, exist_ok=True)
    (cache / "archives/partial").mkdir(parents=True, exist_ok=True)
    (state / "status").touch()
    (ROOT / "apt/sources.list").write_text(MIRROR)
    options = [
        f"Dir::State={state}", f"Dir::State::status={state / 'status'}", f"Dir::Cache={cache}",
        f"Dir::Etc::sourcelist={ROOT / 'apt/sources.list'}", "Dir::Etc::sourceparts=-",
        "APT::Architecture=arm64", "APT::Architectures=arm64", "APT::Sandbox::User=root",
    ]  # fmt: skip
    apt = ["apt-get", "-qq", *(f"-o{option}" for option in options)]
    subprocess.run([*apt, "update"], check=True)
    install = ["--no-install-recommends", "--download-only", "-y", "install", *DEBIAN]
    subprocess.run([*apt, *install], check=True)
    for package in sorted((cache / "archives").glob("*.deb")):
        subprocess.run(["dpkg-deb", "-x", str(package), str(ROOT / "debian")], check=True)


def locked(names: Set[str]) -> str:
    """These packages as the lock has them, hashes included."""
    lines = []
    for block in re.split(r"\n(?=[A-Za-z0-9])", Path("requirements.lock").read_text()):
        found = re.match(r"([\w.-]+)(\[[^\]]*\])?==", block)
        if found and found[1].lower() in names:
            lines.append(block.split("\n    # via")[0].replace(found[2] or "\0", ""))
    return "\n".join(lines) + "\n"


def wheels() -> None:
    """Install the libraries for AArch64."""
    wanted, held = locked(WHEELS), ROOT / "wheels.txt"
    if held.exists() and held.read_text() == wanted:
        return
    shutil.rmtree(ROOT / "site", ignore_errors=True)
    (ROOT / "wheels.lock").write_text(wanted)
    platforms = [word for one in PLATFORMS for word in ("--platform", f"{one}_aarch64")]
    subprocess.run(
        [sys.executable, "-m", "pip", "install", "-q", "--no-deps", "--require-hashes",
         "--only-binary=:all:", "--python-version", "3.11", "--implementation", "cp",
         "--abi", "cp311", "--abi", "abi3", "--abi", "none", *platforms,
         "--target", str(ROOT / "site"), "-r", str(ROOT / "wheels.lock")],
        check=True,
    )  # fmt: skip
    held.write_text(wanted)


def core() -> None:
    """Compile the core for AArch64."""
    compiler = f"{sys.executable} -m ziglang cc -target aarch64-linux-gnu.2.17"
    shutil.rmtree(ROOT / "core", ignore_errors=True)
    subprocess.run(
        [sys.executable, "setup.py", "-q", "build_ext", "--force", f"--build-lib={ROOT / 'core'}",
         f"--build-temp={ROOT / 'objects'}"],
        env={**os.environ, "CC": compiler, "LDSHARED": f"{compiler} -shared"}, check=True,
    )  # fmt: skip


def status(name: str) -> int | None:
    """Exit status of the golden tests on one of these; None: it cannot be had here."""
    if name == V4:
        return native()
    return aarch64() if name == "aarch64" else x86(name)


def main(names: list[str]) -> int:
    """0 if the golden tests pass on all of these that can be had here."""
    codes = {name: status(name) for name in names}
    for name, code in codes.items():
        if code is None:
            print(f"{name}: NOT RUN: neither this machine nor qemu-user has AVX-512")
        else:
            print(f"{name}: {'the same bytes' if code == 0 else f'pytest ended with {code}'}")
    return int(any(codes.values()))


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:] or [*X86, V4, "aarch64"]))
