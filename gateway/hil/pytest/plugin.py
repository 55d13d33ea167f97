"""pytest plugin: `hil_bench`, `inverter`, `gateway_flags`, `socketcan`; scenario files as tests.

Loaded by pytest wherever traction-gateway is installed, so nothing heavy is imported here before
a test asks for it.
"""

from __future__ import annotations

from collections.abc import Generator, Iterator
from pathlib import Path
from typing import TYPE_CHECKING

import pytest

from gateway.hil.pytest.options import bus_of, expected_known, mutant_of
from gateway.hil.pytest.own_packages import load_hidden

if TYPE_CHECKING:
    from gateway.hil.pytest.bench import HilBench
    from gateway.hil.pytest.flags import GatewayFlags
    from gateway.hil.pytest.inverter import Inverter

MARK = (
    "hil(scenario=NAME or FILE, config=FILE, settle=True, drives=3, motion={..}, load={..}, ..): "
    "bench of the test, from a scenario or its tables; settle: first run until all flags are good; "
    "expect_known=PERCENT: least share of the test in which every adhesion flag is known"
)
GLOBS = ("hil_*.toml",)
"""No wider pattern: pytest loads this plugin in any project, and these have TOML files too."""


def pytest_addoption(parser: pytest.Parser) -> None:
    """Add `--can-interface` and the options that belong to it."""
    group = parser.getgroup("hil", "traction-gateway: hardware-in-the-loop tests")
    group.addoption("--can-interface", metavar="NAME",
                    help="run HIL tests in real time on this python-can interface "
                         "(default: virtual clock, no bus)")  # fmt: skip
    group.addoption("--can-channel", metavar="NAME", help="channel, such as vcan0")
    group.addoption("--can-bitrate", metavar="N", type=int, help="bit rate, where it is needed")
    group.addoption("--can-fd", action="store_true", help="CAN FD")
    group.addoption("--hil-gateway", choices=("own", "external"), default="own",
                    help="external: the gateway under test runs elsewhere on the bus")  # fmt: skip
    group.addoption("--hil-expect-known", action="append", default=[], metavar="[FLAG=]PERCENT",
                    help="fail a test in which a drive's adhesion flag (or FLAG=thermal) was "
                         "known for less of the time; for one test: "
                         "`hil(expect_known=PERCENT)`")  # fmt: skip
    group.addoption(
        "--hil-mutant",
        metavar="NUMBER[:SEED]",
        help="test a gateway with this fault: that of `traction-gateway hil --mutate`",
    )
    group.addoption(
        "--require-socketcan", action="store_true", help="fail where `socketcan` would skip a test"
    )
    parser.addini("hil_scenarios", "file names of scenarios that are tests", type="args",
                  default=list(GLOBS))  # fmt: skip


def pytest_configure(config: pytest.Config) -> None:
    """Register the marker, and check options that depend on each other."""
    config.addinivalue_line("markers", MARK)
    bus = bus_of(config)
    if bus is None and (config.getoption("--can-channel") or config.getoption("--can-fd")):
        raise pytest.UsageError("--can-channel and --can-fd need --can-interface")
    expected_known(config)
    mutant_of(config)
    if bus is not None and (config.getoption("numprocesses", None) or 0) > 1:
        raise pytest.UsageError("--can-interface: a bus has room for one process: remove -n")
    if bus is None and config.getoption("--hil-gateway") == "external":
        raise pytest.UsageError("--hil-gateway external needs a bus: --can-interface")


@pytest.fixture
def hil_bench(request: pytest.FixtureRequest) -> Iterator[HilBench]:
    """Simulated inverters and a gateway, all flags good; `@pytest.mark.hil(..)` configures them."""
    load_hidden(request.path.parent)
    from dbc.text import InputError
    from gateway.hil.fitting import fitted
    from gateway.hil.pytest.bench import HilBench, scenario_of
    from sim.scenario import find

    mark = request.node.get_closest_marker("hil")
    given = dict(mark.kwargs) if mark else {}
    name, settle = given.pop("scenario", None), given.pop("settle", True)
    path = given.pop("config", None)
    given.pop("expect_known", None)
    problem = ""
    if mark and mark.args:
        pytest.fail(f"hil marker: name what {mark.args[0]!r} is: {MARK}", pytrace=False)
    try:
        scenario = find(str(name)) if name else scenario_of(given, request.node.nodeid)
        bench = HilBench(
            *fitted(Path(path) if path else None, scenario),
            bus_of(request.config), mutant_of(request.config),
            own_gateway=request.config.getoption("--hil-gateway") == "own",
        )  # fmt: skip
    except (InputError, OSError) as error:
        problem = str(error)
    if problem:
        pytest.fail(problem, pytrace=False)
    try:
        if settle:
            bench.settle()
        yield bench
    finally:
        bench.close()


@pytest.hookimpl(wrapper=True)
def pytest_runtest_call(item: pytest.Item) -> Generator[None, object, object]:
    """Fail a test on a bench whose flags were known for less of its time than expected."""
    bench = getattr(item, "funcargs", {}).get("hil_bench")
    began_ns = 0 if bench is None else bench.now_ns
    outcome = yield
    if bench is not None:
        mark = item.get_closest_marker("hil")
        wanted = (mark.kwargs if mark else {}).get("expect_known")
        expected = expected_known(item.config) if wanted is None else {"adhesion": float(wanted)}
        bench.flags.expect_known(expected, since_ns=began_ns)
    return outcome


@pytest.fixture
def socketcan(request: pytest.FixtureRequest) -> Iterator[str]:
    """Name of a fresh vcan interface of a real kernel, up, with CAN FD: `vcan -- pytest`."""
    from gateway.hil.pytest.socketcan import interface

    yield from interface(required=request.config.getoption("--require-socketcan"))


@pytest.fixture
def inverter(hil_bench: HilBench) -> Inverter:
    """The simulated inverters of `hil_bench`."""
    return hil_bench.inverter


@pytest.fixture
def gateway_flags(hil_bench: HilBench) -> GatewayFlags:
    """The gateway's flags on the bus of `hil_bench`."""
    return hil_bench.flags


def pytest_collect_file(file_path: Path, parent: pytest.Collector) -> pytest.Collector | None:
    """Collect a scenario named on the command line, or whose name matches `hil_scenarios`."""
    if file_path.suffix != ".toml":
        return None
    named = parent.session.isinitpath(file_path)
    if not named and not any(
        file_path.match(glob) for glob in parent.config.getini("hil_scenarios")
    ):
        return None
    load_hidden(file_path.parent)
    from gateway.hil.pytest.scenarios import ScenarioFile

    return ScenarioFile.from_parent(parent, path=file_path)
