"""The labgrid example: a pytest of its own, in real time. Here, where nothing else is running."""

import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
LABGRID = ROOT / "out" / "labgrid"
"""Where `make test-all` puts it: with what it needs 52 MB, and a pytest plugin of its own."""
ATTEMPTS = 3
"""In real time, on a machine that may be busy."""


@pytest.mark.thorough
@pytest.mark.skipif(not LABGRID.is_dir(), reason="labgrid is not in out/labgrid")
def test_labgrid_starts_the_gateway_and_our_fixtures_see_it(tmp_path):
    shutil.copytree(ROOT / "examples" / "labgrid", tmp_path / "labgrid")
    bench = tmp_path / "labgrid" / "env.yaml"
    group = f"239.74.{os.getpid() % 250 + 1}.9"
    bench.write_text(bench.read_text().replace("239.74.163.2", group))
    path = os.pathsep.join([os.environ.get("PYTHONPATH", ""), str(ROOT), str(LABGRID)])
    words = (
        "-c", "/dev/null", "labgrid", "--lg-env", str(bench), "--hil-gateway", "external",
        "--can-interface", "udp_multicast", "--can-channel", group,
    )  # fmt: skip
    for _ in range(ATTEMPTS):
        done = subprocess.run(
            [sys.executable, "-m", "pytest", *words], cwd=tmp_path, capture_output=True, text=True,
            env=os.environ | {"PYTHONPATH": path}, check=False, timeout=120,
        )  # fmt: skip
        if done.returncode == 0:
            assert "1 passed" in done.stdout
            return
        missed = re.search(r"ticks missed (\d+)", done.stdout)
        assert missed, done.stdout
        assert int(missed[1]), done.stdout
    pytest.skip("this machine missed ticks in each attempt")
