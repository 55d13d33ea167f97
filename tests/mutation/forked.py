"""One run of pytest that judges many mutants: tests are imported and collected once.

    python -m tests.mutation.forked SOURCE MUTANTS RESULTS   # JSON files; used by core.py

Each mutant is a shared library of one source, compiled by core.py. A child process loads it and
puts a jump to its functions over those of the delivered core, so that nothing is linked or imported
anew. Quick tests, and those that have found other mutants, come first.
"""

from __future__ import annotations

import ctypes
import difflib
import json
import os
import signal
import struct
import subprocess
import sys
import time
from collections import Counter
from collections.abc import Callable, Sequence
from itertools import pairwise
from pathlib import Path
from typing import Any

import pytest

LEAST_S = 3.0
"""Each test may run ten times as long as with the original, and this long at least; and longer by
the longest of them, as what tests share is made by whichever comes first."""
PROT_ALL, PAGE = 7, 4096


def functions(library: Path) -> list[tuple[str, str, int]]:
    """Name, kind (T: code) and size of what a library defines and others may use."""
    command = ["nm", "-D", "--defined-only", "-S", str(library)]
    told = subprocess.run(command, capture_output=True, text=True, check=True).stdout
    rows = [line.split() for line in told.splitlines()]
    return [(row[3], row[2], int(row[1], 16)) for row in rows if len(row) == 4]


def _overwrite(at: int, code: bytes) -> None:
    first = at & -PAGE
    libc = ctypes.CDLL(None, use_errno=True)
    size = at + len(code) - first
    if libc.mprotect(ctypes.c_void_p(first), ctypes.c_size_t(size), PROT_ALL):
        raise OSError(ctypes.get_errno(), "mprotect")
    ctypes.memmove(at, code, len(code))


def jump_to(address: int) -> bytes:
    """Machine code that goes to an address."""
    if os.uname().machine == "aarch64":
        return struct.pack("<IIQ", 0x58000050, 0xD61F0200, address)  # ldr x16, 8; br x16
    return b"\xff\x25\0\0\0\0" + struct.pack("<Q", address)  # jmp [rip]


def become(library: Path) -> None:
    """From now on this process runs the functions and tables of a library instead of the core's."""
    import _traction_core

    core = ctypes.CDLL(_traction_core.__file__, mode=ctypes.RTLD_GLOBAL)
    new = ctypes.CDLL(str(library))
    for name, kind, size in functions(library):
        old, own = (ctypes.cast(getattr(d, name), ctypes.c_void_p).value for d in (core, new))
        assert old, name
        assert own, name
        if kind == "T":
            _overwrite(old, jump_to(own))
        else:
            _overwrite(old, ctypes.string_at(own, size))


class Judge:
    """Plugin: the loop over tests becomes a loop over mutants."""

    def __init__(self, libraries: Sequence[Path], results: Path) -> None:
        self.libraries, self.results = libraries, results
        self.durations: dict[str, float] = {}
        self.kills: Counter[str] = Counter()
        self.failed = ""

    @pytest.hookimpl(tryfirst=True)
    def pytest_collection(self) -> None:
        """No search for the simplest example of a failure."""
        from hypothesis import Phase, settings

        settings.register_profile(
            "mutants", settings(), phases=(Phase.explicit, Phase.generate), database=None,
            report_multiple_bugs=False,
        )  # fmt: skip
        settings.load_profile("mutants")

    @pytest.hookimpl(tryfirst=True)
    def pytest_runtestloop(self, session: pytest.Session) -> bool:
        """The original first, here, so that what tests keep is there for all; then every mutant."""
        told = self._run(session.items, None)
        if "failed" not in told:  # once more, as every mutant comes
            self.durations = told["durations"]
            told = self._forked(lambda: self._run(session.items, None), 3600.0)
        if "durations" not in told:
            raise pytest.UsageError(f"the original fails: {told or 'a crash'}")
        self.durations = told["durations"]
        limit = 10.0 * (LEAST_S + sum(self.durations.values()))
        with self.results.open("w") as out:
            for library in self.libraries:
                told = self._forked(lambda at=library: self._run(session.items, at), limit)
                by = told.get("failed", "" if told else "a crash, or time")
                self.kills[by] += 1
                print(json.dumps(by), file=out, flush=True)
        return True

    def _order(self, items: Sequence[pytest.Item]) -> list[pytest.Item]:
        def worth(item: pytest.Item) -> float:
            name = item.nodeid
            return (self.durations.get(name, 0.0) + 0.01) / (1 + self.kills[name])

        return sorted(items, key=worth) if self.durations else list(items)

    def pytest_runtest_logreport(self, report: pytest.TestReport) -> None:
        """Remembered, until the test is over."""
        if report.failed:
            self.failed = str(report.longrepr)

    def _run(self, items: Sequence[pytest.Item], library: Path | None) -> dict[str, Any]:
        """In the child."""
        if library is not None:
            become(library)
        # That texts differ is enough; to show it nicely takes longer than all the rest.
        difflib.unified_diff = lambda a, b, *_, **__: [] if a == b else ["another text"]
        durations: dict[str, float] = {}
        order: list[pytest.Item | None] = [*self._order(items), None]
        for item, following in pairwise(order):
            assert item is not None
            began = time.monotonic()
            if library is not None:  # of this process; at its end the child is ended, in C, too
                longest_s = max(self.durations.values())
                limit_s = max(LEAST_S, 10.0 * self.durations[item.nodeid]) + longest_s
                signal.setitimer(signal.ITIMER_PROF, limit_s)
            item.ihook.pytest_runtest_protocol(item=item, nextitem=following)
            durations[item.nodeid] = time.monotonic() - began
            if self.failed:
                return {"failed": item.nodeid, "why": self.failed}
        return {"durations": durations}

    def _forked(self, call: Callable[[], dict[str, Any]], limit_s: float) -> dict[str, Any]:
        """What a call gives in a child process; nothing if that crashes or takes too long."""
        told = self.results.with_suffix(".child")
        told.unlink(missing_ok=True)
        child = os.fork()
        if not child:
            os.setsid()
            null = os.open(os.devnull, os.O_RDWR)
            os.dup2(null, 1)
            os.dup2(null, 2)
            try:
                result = call()
            except BaseException as error:
                result = {"failed": repr(error)}
            told.write_text(json.dumps(result))
            os._exit(0)
        end = time.monotonic() + limit_s
        while os.waitpid(child, os.WNOHANG) == (0, 0):
            if time.monotonic() > end:
                os.killpg(child, signal.SIGKILL)
                os.waitpid(child, 0)
                return {}
            time.sleep(0.002)
        return json.loads(told.read_text()) if told.exists() else {}


def main() -> int:
    """Exit status of pytest."""
    libraries, results, *tests = sys.argv[1:]
    judge = Judge([Path(p) for p in json.loads(Path(libraries).read_text())], Path(results))
    options = ["-q", "-s", "-p", "no:cacheprovider", "-p", "no:xdist",
               "-o", "timeout=0"]  # fmt: skip
    return int(pytest.main([*options, *tests], plugins=[judge]))


if __name__ == "__main__":
    sys.exit(main())
