"""The adhesion side around its detector: the compiled loops are the same functions uncompiled."""

import numpy as np
import pytest

from gateway import _adhesion_kernels as kernels
from gateway import _train_kernels, flags, inputs, slow, tracks
from gateway import adhesion as module
from gateway.adhesion import AdhesionSide
from gateway.config import BENCH_MOTOR, Adhesion
from gateway.flags import Timing
from gateway.health import Flag, Health

N = 3
MS = 1_000_000
TICK = 10 * MS
ADHESION = Timing(40 * MS, 20 * MS, 60 * MS)
RULES = flags.rules([ADHESION] * 5, ADHESION, 0.7, 0.2, TICK)


def course(seed):
    """What is told and commanded, tick by tick: losses of one and of all, silence, new commands."""
    rng = np.random.default_rng(seed)
    command = np.full(N, 20.0)
    share = np.ones(N)
    for tick in range(600):
        if tick % 10 == 0:
            before = command.copy()
            if rng.random() < 0.1:
                command = np.full(N, rng.choice([20.0, 15.0, 0.5, -12.0]))
        if rng.random() < 0.03:
            share = rng.choice([np.ones(N), np.full(N, 0.1), np.array([1.0, 0.1, 1.0])])
        told, sent = tracks.told(N), slow.start(N)
        told.health[:] = np.where(rng.random(N) < 0.02, Health.CONVERGING, Health.TRACKING)
        told.load[:] = command * share + rng.normal(0.0, 0.1, N)
        told.speed[:] = np.where(rng.random(N) < 0.01, np.nan, 25.0 + rng.normal(0.0, 0.1, N))
        sent.command[:], sent.before[:] = command, before
        sent.command_ns[:] = (tick - tick % 10) * TICK
        yield told, sent, rng.random(N) < 0.98, tick * TICK


@pytest.mark.parametrize("seed", range(4))
def test_loops_equal_themselves_uncompiled(seed, monkeypatch):
    made, met = [], set()
    names = ("compare", "conclude", "teach", "assess_train")
    for how in (lambda kernel: kernel, lambda kernel: kernel.py_func):
        for name in names:
            kernel = getattr(kernels, name, None) or getattr(_train_kernels, name)
            monkeypatch.setattr(module, name, how(kernel))
        side, kept, out = AdhesionSide(Adhesion(), [BENCH_MOTOR] * N, RULES, TICK), None, []
        kept = np.repeat(flags.flag(0), N)
        for told, sent, fresh, now in course(seed):
            come = inputs.inputs(N)._replace(commanded=fresh.copy(), speed=told.speed.copy())
            opinion = side.judge(told, sent, come, kept["state"], kept["since_ns"], now)
            lost = opinion.known & (opinion.lost > 0.7)
            flag = np.where(lost, Flag.BAD, np.where(opinion.known, Flag.GOOD, Flag.UNKNOWN))
            kept["since_ns"][kept["state"] != flag] = now
            kept["state"] = flag
            memory, own = (learnt.all["spread"].item() for learnt in (side.reference, side.own))
            said_so = opinion.lost.tolist(), opinion.known.tolist(), side.severe.tolist()
            out.append((*said_so, side.common_mode["state"].item(), memory, own))
            met |= {("flag", *flag.tolist()), ("common", side.common_mode["state"].item())}
        made.append(out)
    assert made[0] == made[1]
    assert {("common", flag) for flag in Flag} <= met
    assert ("flag", Flag.GOOD, Flag.BAD, Flag.GOOD) in met
    assert made[0][-1][4] != made[0][0][4], "the spread is learnt"
