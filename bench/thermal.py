"""What the thermal monitor costs: 16 to 1,024 motors at one sample a second, in ticks of 10 ms."""

from __future__ import annotations

import time

import numpy as np

from estimators.thermal.model import TYPICAL
from estimators.thermal.monitor import Known, ThermalMonitor

HEADER = ("what", "per 10 ms tick, mean", "goal", "a second's samples", "a motor's block")
FLEETS = {16: "10 us", 64: "-", 1024: "500 us"}
TICKS = 100
"""In a second."""


def _monitor(motors: int) -> ThermalMonitor:
    nothing = np.zeros((motors, 3))
    known = Known(
        np.tile(TYPICAL, (motors, 1)), nothing, nothing + 0.25, 1.5,
        np.array([200.0, 1e4, 0.02, 0.04]),
    )  # fmt: skip
    return ThermalMonitor(known, 1.0)


def cost(motors: int) -> tuple[float, float, float]:
    """s: mean per tick over two minutes of samples; a second's samples; a motor's block."""
    monitor, rng = _monitor(motors), np.random.default_rng(0)
    square, speed, air = (np.full(motors, value) for value in (1e4, 200.0, 20.0))
    samples, judged, blocks = 0.0, 0.0, 0
    for second in range(180):
        reading = 50.0 + 0.25 * rng.standard_normal((motors, 3))
        begun = time.perf_counter()
        monitor.add_sample(reading, square, speed, air)
        taken = time.perf_counter()
        waiting = monitor.waiting
        monitor.judge(waiting)
        done = time.perf_counter()
        if second >= 60:
            samples += taken - begun
            judged += done - taken
            blocks += waiting
    return (samples + judged) / 120 / TICKS, samples / 120, judged / max(blocks, 1)


def rows() -> list[tuple[str, ...]]:
    out = []
    for motors, goal in FLEETS.items():
        tick, second, block = (1e6 * spent for spent in cost(motors))
        out.append((
            f"thermal monitor, {motors} motors", f"{tick:.1f} us", goal,
            f"{second:.0f} us", f"{block:.0f} us",
        ))  # fmt: skip
    return out
