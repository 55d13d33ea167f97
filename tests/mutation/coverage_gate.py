"""Fails unless every line and branch of what decides a flag is run by its own tests.

    python -m tests.mutation.coverage_gate

Module and tests are those of `spec.py`; of the C, `python -m tests.core_variants coverage`.
"""

from __future__ import annotations

import sys
from pathlib import Path

import coverage

from tests.mutation.spec import MODULE, TESTS


def main() -> int:
    """Run the tests, show what they have run."""
    measured = coverage.Coverage(data_file=None, config_file=False, branch=True, include=[MODULE])
    measured.start()
    # Not before: whatever is imported has run its first lines unseen.
    import pytest

    code = pytest.main(["-q", "-p", "no:xdist", "-p", "no:cacheprovider", *TESTS])
    measured.stop()
    percent = measured.report(show_missing=True)
    seen = {
        str(Path(path).relative_to(Path.cwd())) for path in measured.get_data().measured_files()
    }
    if code or percent < 100.0 or seen != {MODULE}:
        print("coverage: not every line and branch of what decides a flag, or a test has failed")
        return 1
    return 0


if __name__ == "__main__":
    sys.exit(main())
