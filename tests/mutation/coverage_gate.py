"""Fails unless every line and branch of what decides a flag is run by its own tests.

    python -m tests.mutation.coverage_gate

Modules and tests are those of `parts.toml`; of the C, `python -m tests.core_variants coverage`.
"""

from __future__ import annotations

import sys
import tomllib
from pathlib import Path

import coverage

PARTS = Path(__file__).with_name("parts.toml")


def main() -> int:
    """Run the tests, show what they have run."""
    parts = tomllib.loads(PARTS.read_text()).values()
    modules = [module for part in parts for module in part["modules"]]
    tests = [test for part in parts for test in part["tests"]]
    only = " and ".join(part["only"] for part in parts if "only" in part)
    measured = coverage.Coverage(data_file=None, config_file=False, branch=True, include=modules)
    measured.start()
    # Not before: whatever is imported has run its first lines unseen.
    import pytest

    code = pytest.main(["-q", "-p", "no:xdist", "-p", "no:cacheprovider", "-k", only, *tests])
    measured.stop()
    percent = measured.report(show_missing=True)
    seen = {
        str(Path(path).relative_to(Path.cwd())) for path in measured.get_data().measured_files()
    }
    if code or percent < 100.0 or seen != set(modules):
        print("coverage: not every line and branch of what decides a flag, or a test has failed")
        return 1
    return 0


if __name__ == "__main__":
    sys.exit(main())
