"""Options of the test run."""

import gc

import pytest

from tests.fuzz import load_fuzz, load_gate

load_gate()


def pytest_addoption(parser):
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
    group.addoption(
        "--counts",
        choices=("tenth", "full"),
        default="tenth",
        help="how often links and programs fail in tests/hil/test_vcan_campaign.py",
    )
    group.addoption(
        "--campaign-seed", type=int, default=1, metavar="N", help="of the campaign's random times"
    )
    parser.getgroup("web", "tests of the monitor's page").addoption(
        "--require-chromium",
        action="store_true",
        help="fail where the tests of the page would be skipped for want of a browser",
    )
    parser.getgroup("core", "tests of the compiled core").addoption(
        "--require-ziglang",
        action="store_true",
        help="fail where tests for another processor would be skipped for want of ziglang",
    )
    parser.getgroup("fuzz").addoption(
        "--fuzz",
        type=int,
        metavar="FACTOR",
        help="FACTOR times as many examples in the property tests, and random ones",
    )
    parser.getgroup("golden").addoption(
        "--update-golden", action="store_true", help="write the expected golden logs anew"
    )


def pytest_configure(config):
    # A search for garbage in all that the tests have loaded takes a second: seldom, and not in it.
    gc.set_threshold(20_000, 20, 20)
    if config.getoption("--fuzz"):
        load_fuzz(config.getoption("--fuzz"))


def pytest_collection_finish():
    gc.freeze()


@pytest.fixture
def loaded_frozen():
    """For tests of live loops, which collect garbage first and exempt nothing at their end."""
    gc.freeze()
    yield
    gc.freeze()


@pytest.fixture(scope="session")
def log(tmp_path_factory):
    """Three drives and a gateway; the second drive loses adhesion from 1.2 s to 2.0 s."""
    from tests.monitored import recorded
    from tests.simrun import log_of

    return log_of(tmp_path_factory.mktemp("log") / "loss.log", recorded().frames)


@pytest.fixture
def refused(capsys):
    """The one line with which the command refuses these words, with exit code 2."""
    from gateway.cli import main

    def line(*words):
        capsys.readouterr()
        assert main([str(word) for word in words]) == 2
        said = capsys.readouterr().err.strip()
        assert said.startswith("traction-gateway: ")
        assert "\n" not in said
        return said

    return line
