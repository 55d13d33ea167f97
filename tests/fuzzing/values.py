"""Fuzz target: values behind right headers. Input: a small program of faults of running drives.

A byte for the set-up, then four bytes each: which fault, of which message, of which drives, for how
many ticks; honest frames before the first. What is missing at the end reads as zeros.
"""

from functools import cache
from itertools import islice

from gateway.core.gateway import Gateway
from tests.extremes import MESSAGES, RULES, Setup, Stretch, changed
from tests.fuzzing.frames import _well_formed
from tests.storm.value_faults import VALUE_KINDS, ValueFaults
from tests.value_cases import TICK, honest

DRIVES = 2
WARM_TICKS = 60
"""Drives are tracked by then, though their flags need some longer."""
LONGEST = 80
"""Ticks of one program."""
RULE_NAMES = tuple(RULES)
SPEEDS = (100.0, 290.0)


@cache
def _setup(head):
    kind, fd = ("ekf", "ukf")[head & 1], bool(head & 2)
    return Setup(DRIVES, kind, fd, SPEEDS[head >> 2 & 1])


def steps_of(data):
    """Set-up, and (fault, message, drives, ticks) one after the other."""
    setup = _setup(data[0] & 7 if data else 0)
    steps, total = [], 0
    for at in range(1, len(data), 4):
        what, where, who, long = data[at : at + 4].ljust(4, b"\0")
        ticks = min(1 + long % 32, LONGEST - total)
        if ticks <= 0:
            break
        total += ticks
        names = (*VALUE_KINDS, *RULE_NAMES, "none")
        drives = tuple(d for d in range(DRIVES) if (who % 3 + 1) >> d & 1)
        message = MESSAGES[where % len(MESSAGES)]
        steps.append((names[what % len(names)], message, drives, ticks))
    return setup, steps


def values(data, gateway=Gateway):
    """Nothing raises and what is sent is well formed; returns ticks with a fault."""
    setup, steps = steps_of(data)
    ticks = WARM_TICKS + LONGEST
    blocks = iter(honest(setup.speed, setup.motor, setup.fd, ticks, 0.6, setup.nodes))
    core = gateway(setup.config(), setup.codec, 0)
    faults = ValueFaults(setup.codec, setup.nodes)
    sent = {}
    tick = done = 0
    for name, message, drives, count in [("none", "all", (), WARM_TICKS), *steps]:
        part = list(islice(blocks, count))
        if name in RULES:
            part = list(changed(setup, Stretch(name, message, drives), part, len(data)))
        kinds = [(name, drive) for drive in drives] if name in VALUE_KINDS else []
        for block in part:
            tick += 1
            came = faults.apply(kinds, block)
            _well_formed(setup.codec, core.step(came, tick * TICK), tick * TICK, sent)
        done += count if name != "none" else 0
    return done
