"""After the warm-up nothing is compiled, or loaded, in the middle of a run."""

import argparse
import subprocess
import sys
import time

import pytest

from gateway.commands import common, warm

COMPILED = """
import sys, time
from numba.core.registry import CPUDispatcher
from gateway.commands.common import prepare
from gateway.commands.common import scenario_thermal
from sim.scenario import find

def compiled():
    kernels = {
        value
        for name, module in list(sys.modules.items())
        if name.partition(".")[0] in ("dbc", "estimators", "gateway", "sim")
        for value in vars(module).values()
        if isinstance(value, CPUDispatcher)
    }
    names = {k: (k.py_func.__module__, k.py_func.__name__) for k in kernels}
    return {(*name, str(given)) for k, name in names.items() for given in k.signatures}

config, codec = prepare(None, thermal=scenario_thermal())
"""
DEMO = """
from gateway.drivers import demo

before = set()
make = demo.Gateway

def gateway(*given):
    before.update(compiled())
    return make(*given)

demo.rehearse(find("demo"), config, codec)
demo.Gateway = gateway
demo.run_demo(find("demo"), config, codec, "test-warm", 3.0, lambda *_: None, time.monotonic())
assert before
print(sorted(compiled() - before))
"""
CORE = """
from gateway.core import Gateway
from gateway.drivers.warm import warm_up
from sim.simulation import Simulation

simulation = Simulation(find("wet_one"), codec)
frames = [simulation.step((), k * 10_000_000) for k in range(1, 500)]
warm_up(config, codec)
before = compiled()
core = Gateway(config, codec, 0)
said = set()
for k, came in enumerate(frames, 1):
    core.step(came, k * 10_000_000)
    said |= {drive.adhesion.name for drive in core.view.drives}
assert said == {"UNKNOWN", "GOOD", "BAD"}
print(sorted(compiled() - before))
"""


@pytest.mark.parametrize("slow", [False, True])
def test_who_waits_for_the_compiler_is_told_why(capsys, monkeypatch, slow):
    monkeypatch.setattr(common, "PATIENCE_S", 0.01 if slow else 60.0)
    with common.patience():
        until = time.monotonic() + 5.0
        while slow and time.monotonic() < until and not (said := capsys.readouterr().err):
            time.sleep(0.01)
    assert (said if slow else capsys.readouterr().err) == (common.COMPILING + "\n") * slow


@pytest.mark.parametrize("program", [DEMO, CORE], ids=["demo", "core"])
def test_nothing_is_compiled_in_mid_run(program):
    done = subprocess.run(
        [sys.executable, "-c", COMPILED + program], capture_output=True, text=True, check=True
    )
    assert done.stdout.strip() == "[]"


def test_without_a_configuration_all_that_ships_is_compiled(monkeypatch, tmp_path):
    """The thermal side too, of which nothing runs without a calibration."""
    warmed, made = [], []
    monkeypatch.setattr(
        "gateway.drivers.warm.warm_up", lambda config, _codec: warmed.append(config)
    )
    monkeypatch.setattr("gateway.drivers.kernelcache.make", made.append)
    monkeypatch.setattr("gateway.drivers.kernelcache.count", lambda _: 5)
    assert warm.run(argparse.Namespace(config=[], kernels=tmp_path)) == 0
    assert made == [tmp_path]
    assert {config.dbc_path.name for config in warmed} == {"traction.dbc", "traction_fd.dbc"}
    assert all(config.calibration_path.is_file() for config in warmed)
