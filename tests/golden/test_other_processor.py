"""The golden logs on a processor without vectors of 256 bits and without fused multiplication.

What rounds otherwise in the last place must not be seen on the bus (R35). Compiled anew in a folder
of its own: a minute or two.
"""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

HERE = Path(__file__).parent
CASES = ("loss", "slow")
"""The default detector with all it takes; temperatures for long."""


@pytest.mark.slow
def test_the_gateway_says_the_same_on_the_least_processor(tmp_path):
    least = {
        **os.environ, "NUMBA_CPU_NAME": "generic", "NUMBA_CPU_FEATURES": "",
        "NUMBA_CACHE_DIR": str(tmp_path),
    }  # fmt: skip
    words = ["-p", "no:xdist", "-p", "no:cacheprovider", f"{HERE / 'test_golden.py'}"]
    cases = " or ".join(f"says_what_it_said[{case}]" for case in CASES)
    done = subprocess.run(
        [sys.executable, "-m", "pytest", *words, "-k", cases],
        env=least, cwd=HERE.parents[1], capture_output=True, text=True, check=False,
    )  # fmt: skip
    assert done.returncode == 0, done.stdout[-3000:]
    assert f"{len(CASES)} passed" in done.stdout
    # Compiled for that processor, and not what lay beside the sources.
    kept = list(tmp_path.rglob("*.nbc"))
    assert kept
    assert all(b"generic" in path.read_bytes() for path in kept)
