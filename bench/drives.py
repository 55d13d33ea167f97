"""A tick by the number of drives, far beyond the 16 that the message set has identifiers for.

Three drives of a simulated log go through a gateway. What its receiver holds after each tick is
copied for N drives, and the stations from there on do their work: inputs, filters, motion,
adhesion, temperatures, evidence, debouncing, publishing. Receiving and sending are left out: both
go through messages one by one. The copying is not in the times.
"""

from __future__ import annotations

import tempfile
import time
from pathlib import Path
from statistics import median
from typing import Any, Final

import numpy as np
from _traction_core import lib

from bench.stages import NODES, Recorded
from bench.wire import log_of
from dbc.codec import bind
from dbc.frame import MS, Nanos
from dbc.records import pointer
from gateway.core.adhesion import AdhesionMonitor
from gateway.core.gateway import Gateway
from gateway.core.inputs import places
from gateway.core.motion import Timebase
from gateway.settings.config import BENCH_MOTOR, shipped_dbc
from gateway.settings.sections import Adhesion, Estimator
from tests.receivers import Received
from tests.sample_rows import readings_of, samples_of
from tests.stations import Bank, Flags, InputMonitor, MotionMonitor, TemperatureMonitor

HEADER = ("drives", "per tick", "per drive and tick", "longest station")
FLEETS: Final = (3, 16, 64, 256, 1024)
TICKS: Final = 300
"""Of the log, that are timed."""
SETTLED: Final = 100
"""Ticks before that."""


class Stations:
    """What a tick does of N drives, copies of those of a gateway."""

    def __init__(self, n: int, gateway: Gateway) -> None:
        """n: a multiple of the gateway's drives, or cut to it."""
        self.n, self.given = n, gateway
        count, tick_ns = len(NODES), gateway.config.loop.period_ns
        self.per = len(gateway.inbox.channels) // count
        self.came = Received(n, channels=n * self.per, rows=8 * n)
        step_a = 0.02
        laid = gateway.inputs.channels
        rows = [
            (k * self.per, (k + 1) * self.per, *self._channels_of(laid[k % count], k))
            for k in range(n)
        ]
        ages, sums = ([laid[0][name].item()] * n for name in ("max_age_ns", "max_current_sum_a"))
        where = places(rows, ages, sums)
        motors = [BENCH_MOTOR] * n
        rules = gateway.flags.rules.copy()
        self.inputs = InputMonitor(self.came, where.channels)  # type: ignore[arg-type]
        self.bank = Bank(motors, Estimator(), step_a, tick_ns)
        self.adhesion = AdhesionMonitor(Adhesion(), motors, rules, tick_ns)
        times = Timebase(2e-3, 10 * MS, 0.5 * np.pi / 30.0)
        self.motion = MotionMonitor(
            motors, Estimator(), times, tick_ns, step_a, self.came, self.inputs, self.bank,
            self.adhesion.rotors,
        )  # fmt: skip
        self.thermal = TemperatureMonitor(n, 100 * MS, 60.0, None, tuple(range(n)))
        self.thermal.wire(where, [gateway.config.loop.period_ns * 30] * n, [25.0])
        self.flags = Flags(rules, n, self.adhesion.detector.code, gateway.start_ns)
        self.spent: dict[str, list[float]] = {}

    def _channels_of(self, laid: Any, k: int) -> tuple[list[int], int, int]:
        """Electrical channels, Motion and Status of drive k."""
        moved = k * self.per - laid["first"].item()
        electrical = [c + moved for c in laid["electrical"].tolist()]
        return electrical, laid["motion"].item() + moved, laid["status"].item() + moved

    def copy(self) -> None:
        """What the gateway's receiver holds, for all drives."""
        count, groups = len(NODES), -(-self.n // len(NODES))
        box, came = self.given.inbox.receiver, self.came
        for mine, theirs in ((came.channels, box.channels), (came.drives, box.drives)):
            mine[:] = np.tile(theirs, groups)[: len(mine)]
        came.channels["drive"] = np.arange(len(came.channels)) // self.per
        tick = box.pointer.tick
        for name, mine, theirs, rows in (
            ("samples", came.samples, samples_of(box), tick.samples),
            ("motions", came.readings, readings_of(box), tick.motions),
        ):
            drive = np.tile(theirs.drive[:rows], groups) + count * np.arange(groups).repeat(rows)
            kept = drive < self.n
            for ours, column in zip(mine, theirs, strict=True):
                copied = np.concatenate([column[:rows]] * groups)[kept]
                ours[: len(copied)] = copied
            mine.drive[: kept.sum()] = drive[kept]
            setattr(came.pointer.tick, name, int(kept.sum()))
        came.note_samples(came.pointer.tick.samples)
        self.bank.reserve(came.pointer.tick.samples)

    def tick(self, now: Nanos) -> None:
        n, flags, status = self.n, self.flags, self.flags.status.drives
        rules, train, found, evidence = (
            pointer(f"struct {kind}", records)
            for kind, records in (
                ("flag_rules", flags.rules), ("train_inputs", flags.train_inputs),
                ("flag_inputs", flags.inputs), ("drive_evidence", flags.evidence),
            )
        )  # fmt: skip
        given = (
            pointer("struct adhesion", self.adhesion.record),
            pointer("struct drive_estimate", self.bank.estimates),
            pointer("struct input_status", self.inputs.status),
            self.came.pointer.drives, pointer("struct drive_status", status), now,
        )  # fmt: skip
        calls = {
            "inputs": lambda: self.inputs.assess(intruder=False, now=now),
            "filters": lambda: self.bank.run(self.came.pointer, self.inputs.status, now),
            "motion": lambda: self.motion.observe(now),
            "adhesion": lambda: lib.detect_loss(*given),
            "temperatures": lambda: lib.monitor_temperatures(
                self.thermal.pointer, self.came.pointer, now, found
            ),
            "evidence": lambda: lib.collect_evidence(rules, train, found, n, evidence),
            "debouncing": lambda: flags.debounce(now),
            "publishing": lambda: flags.publish(now),
        }
        for name, call in calls.items():
            began = time.perf_counter()
            call()
            self.spent.setdefault(name, []).append(time.perf_counter() - began)


def measured(recorded: Recorded, n: int) -> dict[str, float]:
    """s a tick of each station: medians."""
    gateway = recorded.gateway()
    stations = Stations(n, gateway)
    for block, now in recorded.ticks()[: SETTLED + TICKS]:
        gateway.step(block, now)
        stations.copy()
        stations.tick(now)
    tracking = (stations.bank.estimates["health"] == lib.HEALTH_TRACKING).mean()
    assert tracking > 0.9, f"{tracking:.0%} of the drives are tracked"
    return {name: median(spent[SETTLED:]) for name, spent in stations.spent.items()}


def rows() -> list[tuple[str, ...]]:
    with tempfile.TemporaryDirectory() as name:
        log = log_of(Path(name), "traction.dbc", 6.0)
        recorded = Recorded(log, bind(shipped_dbc("traction.dbc"), NODES))
    out = []
    for n in FLEETS:
        spent = measured(recorded, n)
        whole, longest = sum(spent.values()), max(spent, key=lambda name: spent[name])
        out.append((
            str(n), f"{1e6 * whole:.1f} us", f"{1e9 * whole / n:.0f} ns",
            f"{longest}, {100.0 * spent[longest] / whole:.0f} %",
        ))  # fmt: skip
    return out
