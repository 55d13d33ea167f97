"""Options of the test run."""

from __future__ import annotations

import pytest
from hypothesis import settings

# The first example pays for compiling; a deadline would judge the compiler.
settings.register_profile("project", deadline=None)
settings.load_profile("project")


def pytest_addoption(parser: pytest.Parser) -> None:
    group = parser.getgroup("vcan", "tests on a real SocketCAN interface")
    group.addoption(
        "--require-vcan",
        action="store_true",
        help="fail where the tests marked vcan would be skipped for want of SocketCAN",
    )
    group.addoption(
        "--vcan-inside",
        metavar="FILE",
        help="used by the tests themselves: SocketCAN is real here; write the reports to FILE",
    )
    parser.getgroup("golden").addoption(
        "--update-golden", action="store_true", help="write the expected golden logs anew"
    )
