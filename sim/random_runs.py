"""Random single losses of adhesion, by seed: what the detection figures are measured on.

Nothing here is tuned to any detector; scores on a paper's own scenario flatter whatever was
tuned on it.
"""

from __future__ import annotations

from typing import Any, Final, Literal

import numpy as np

from sim.scenario import Scenario, parse

STREAM: Final = 20
"""Purpose of the random stream."""
ONSET_S: Final = (0.8, 1.6)
LENGTH_S: Final = (0.1, 2.0)
DEPTH: Final = (0.2, 1.0)
SPEED_RAD_S: Final = (40.0, 250.0)
LOAD_NM: Final = (8.0, 30.0)
RAMP_S: Final = 0.02
TAIL_S: Final = 0.8


def random_scenario(
    seed: int,
    *,
    drives: int = 3,
    kind: Literal["preset", "rail"] = "preset",
    healthy: bool = False,
    noise_var: float = 2e-4,
) -> Scenario:
    """One run: rolling start with unknown angles, one loss on one drive (none if `healthy`).

    Uniform draws: speed 40-250 electrical rad/s and load 8-30 Nm, each of either sign; depth
    0.2-1, length 0.1-2 s, onset 0.8-1.6 s, linear edges of 0-20 ms, any drive. `kind` is the
    plant's load: preset (every drive speed controlled) or the creep curve on dry rail. Runs end
    0.8 s after the loss.
    """
    rng = np.random.default_rng([seed, STREAM])
    speed = rng.uniform(*SPEED_RAD_S) * rng.choice([-1.0, 1.0])
    load = rng.uniform(*LOAD_NM) * rng.choice([-1.0, 1.0])
    onset = round(float(rng.uniform(*ONSET_S)), 4)
    length = round(float(rng.uniform(*LENGTH_S)), 4)
    depth = round(float(rng.uniform(*DEPTH)), 4)
    ramp = round(float(rng.uniform(0.0, RAMP_S)), 4)
    drive = int(rng.integers(1, drives + 1))
    event: dict[str, Any] = {
        "at_s": onset,
        "for_s": length,
        "drive": drive,
        "kind": "adhesion_loss",
        "depth": depth,
        "ramp_s": ramp,
    }
    title = f"random {seed}: {speed:.0f} rad/s, {load:.1f} Nm"
    table = {
        "title": title if healthy else f"{title}, {depth:.0%} of drive {drive} for {length:.2f} s",
        "seed": seed,
        "duration_s": round(onset + length + TAIL_S, 4),
        "drives": drives,
        "motion": {"speed": round(float(speed), 3)},
        "load": {"kind": kind, "torque_nm": round(float(load), 3)},
        "sensors": {"current_noise_var": noise_var},
        "event": [] if healthy else [event],
    }
    return parse(table, f"random {seed}")
