"""`python -m bench.real_temperatures -o docs/pictures`: recordings made by others, judged by us.

Prints every figure of docs/real_temperatures.md; draws its pictures (`real_pictures`).
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator, Sequence
from itertools import chain
from pathlib import Path
from typing import Final

import numpy as np

from bench.real_pictures import draw
from bench.real_recordings import (
    BRIDGES,
    HALF_BRIDGES,
    JOINTS,
    LABELS,
    LEARNT_S,
    LEG,
    STALE_NS,
    Said,
    after,
    holding_rule,
    icub,
    inverter,
    judge,
    judged,
    kona_frames,
    kona_runs,
    learn_icub,
    learn_inverter,
    reading,
    to_accuracy,
)
from dbc.frame import SECOND
from gateway.core.codes import FaultClass, FaultSensor, Flag, Reason
from tests.stations import Temperatures

FROZEN_S: Final = 60.0
"""When HB2 is made to hold its value, s of F0's judged part: no real sensor of these did."""


def kinds(said: Said, k: int) -> set[FaultClass]:
    """All that was said of motor `k`, healthy and unknown left out."""
    found = {FaultClass(kind) for kind in said.kind[:, k].tolist()}
    return found - {FaultClass.UNKNOWN, FaultClass.NONE}


def first(said: Said, mask: np.ndarray) -> str:
    """When `mask` (T,) is first true."""
    at = np.flatnonzero(mask)
    return f"{said.t_s[at[0]]:.1f} s" if at.size else "never"


def _named(said: Said, names: Sequence[str]) -> str:
    found = [
        f"{name} {', '.join(kind.name for kind in sorted(kinds(said, k)))}"
        for k, name in enumerate(names)
        if kinds(said, k)
    ]
    return "; ".join(found) or "nothing"


def icub_lines() -> Iterator[str]:
    readings = icub()
    for k, name in enumerate(JOINTS[:-1]):
        for t_s, lasted_s in drops([r for r in readings if r.drive == k]):
            yield f"icub: {name} has no value at {t_s:.2f} s for {1000 * lasted_s:.0f} ms"
    gaps = np.diff([r.t_ns for r in readings if r.drive == 0])
    yield (
        f"icub: {(gaps > STALE_NS).sum()} holes beyond {STALE_NS / SECOND:.2f} s, "
        f"the longest {gaps.max() / SECOND:.2f} s"
    )
    said, calibrated = judge(readings, LEG), judge(readings, LEG, learn_icub())
    yield f"icub, nothing learnt: {_named(said, JOINTS)}"
    yield f"  ankle_roll's sensor flag is bad from {first(said, said.sensor[:, 5] == Flag.BAD)}"
    yield f"icub, learnt from 60 s: {_named(calibrated, JOINTS)}; thermal flag bad: " + str(
        bool((calibrated.thermal == Flag.BAD).any())
    )
    good = (calibrated.thermal == Flag.GOOD).mean(axis=0)
    yield "  thermal flag good: " + ", ".join(
        f"{name} {100 * share:.1f} %" for name, share in zip(JOINTS, good, strict=True)
    )
    yield "  longest hold on our wire, s: " + ", ".join(
        f"{name} {hold:.1f}" for name, hold in zip(JOINTS, holds(), strict=True)
    )
    for t_s in (10.0, 20.0, 30.0, 45.0, 60.0):
        cells = learn_icub(t_s)
        wrong, now = (judge(readings, LEG, c) for c in (holding_rule(cells), cells))
        stuck = [
            [n for k, n in enumerate(JOINTS) if FaultClass.SENSOR_STUCK in kinds(said, k)]
            for said in (wrong, now)
        ]
        yield f"  learnt from {t_s:.0f} s: stuck by hold alone {stuck[0]}, noise asked {stuck[1]}"
    bare = judge(icub(()), LEG)
    yield f"icub, codes not mapped: {_named(bare, JOINTS)}"


def drops(readings: Sequence[Temperatures]) -> list[tuple[float, float]]:
    """When one motor's first sensor had no value and until the next one, s."""
    found: list[tuple[float, float]] = []
    since: float | None = None
    for one in readings:
        t_s = one.t_ns / SECOND
        if not one.valid[0]:
            since = t_s if since is None else since
        elif since is not None:
            found.append((since, t_s - since))
            since = None
    return found


def holds() -> list[float]:
    """Longest time, s, that each joint holds a value of our wire (0.1 K); invalid ends a hold."""
    longest, since, last = ([0.0] * len(JOINTS) for _ in range(3))
    for one in icub():
        k, t_s = one.drive, one.t_ns / SECOND
        if one.raw[0] != last[k] or one.raw[0] < 0:
            last[k], since[k] = one.raw[0], t_s
        longest[k] = max(longest[k], t_s - since[k])
    return longest


def deviations(said: Said) -> str:
    """Smallest and largest deviation of each motor, K: a cell of docs/real_temperatures.md."""
    lowest, highest = np.nanmin(said.deviation_k, axis=0), np.nanmax(said.deviation_k, axis=0)
    pairs = zip(lowest, highest, strict=True)
    return ", ".join(f"{low:.1f}..{high:.1f}".replace("-0.0", "0.0") for low, high in pairs)


def inverter_lines() -> Iterator[str]:
    for t_s in (60.0, 100.0, LEARNT_S, 300.0, 400.0):
        cells = learn_inverter(t_s)
        limits = f"MAISD {cells.maisd_limit_k[0]:.2f}, deviation {cells.deviation_limit_k[0]:.2f} K"
        yield f"inverter, learnt from {t_s:.0f} s of F0: {limits}"
        for name, chosen in (("as learnt", cells), ("at least 3 K", to_accuracy(cells))):
            hot = [
                f"{label}: {', '.join(found)}"
                for label, said in judged(chosen, t_s).items()
                if (found := hot_bridges(said))
            ]
            yield f"  {name}: hot {'; '.join(hot) or 'nothing'}"
    cells = to_accuracy(learn_inverter())
    for label, said in judged(cells).items():
        bad = first(said, (said.thermal == Flag.BAD).any(axis=1))
        yield f"  {label}: deviation K {deviations(said)}; bad from {bad}; {_named(said, BRIDGES)}"
        jump_k = np.nanmax(np.abs(np.diff(said.celsius, axis=0)))
        below = (said.thermal == Flag.BAD) & (said.kind == FaultClass.NONE)
        at = said.t_s[below.any(axis=1)]
        carried = f"; evidence gone, flag held {at[0]:.1f}..{at[-1]:.1f} s" if at.size else ""
        yield f"    largest jump between two readings {jump_k:.1f} K{carried}"
    frozen = judge(frozen_bridge(), HALF_BRIDGES, cells)
    stuck = first(frozen, frozen.kind[:, 1] == FaultClass.SENSOR_STUCK)
    yield f"  F0, HB2 frozen at {FROZEN_S:.0f} s: {_named(frozen, BRIDGES)} at {stuck}"
    unlearnt = [_named(judge(inverter(label), HALF_BRIDGES), BRIDGES) for label in LABELS]
    yield f"  sensor faults with nothing learnt: {', '.join(unlearnt)}"
    hole = judged(cells)["F6"]
    stale = (hole.reason == Reason.STALE).all(axis=1)
    span = hole.t_s[stale]
    says = [{Flag(f).name for f in hole.thermal[stale, k].tolist()} for k in range(len(BRIDGES))]
    yield f"  F6's hole: stale from {span[0]:.1f} to {span[-1]:.1f} s; flags within {says}"
    back = hole.thermal[hole.t_s > span[-1]][0].tolist()
    yield f"  flags of the cycle after it: {[Flag(f).name for f in back]}"


def frozen_bridge() -> list[Temperatures]:
    """The part of F0 that is judged, HB2 frozen at 26 degC from `FROZEN_S` on."""
    from_ns = (LEARNT_S + FROZEN_S) * SECOND
    return [
        reading(1, r.t_ns, [26.0]) if r.drive == 1 and r.t_ns >= from_ns else r
        for r in after(inverter("F0"), LEARNT_S)
    ]


def hot_bridges(said: Said) -> list[str]:
    """Half-bridges whose thermal flag was bad at some time."""
    return [n for k, n in enumerate(BRIDGES) if (said.thermal[:, k] == Flag.BAD).any()]


def kona_lines() -> Iterator[str]:
    frames = kona_frames()
    default = [f.t_ns for f in frames if f.data[2:6] == b"\x28\x28\x28\x28"]
    down = [f.t_ns for f in frames if not f.data[0] & 0x08]
    yield f"kona: {len(frames)} frames, {len(default)} at the default, {len(down)} with status 0"
    fast = [f.data[3] - 40 for f in frames if f.t_ns in set(down)]
    yield f"  fast 1 while status is 0: {sorted(set(fast))} degC"
    for name, said in kona_runs().items():
        which = {FaultSensor(w).name for w in said.which[:, 0].tolist()}
        bad = 100 * (said.sensor[:, 0] == Flag.BAD).mean()
        yield f"  {name}: {_named(said, ['inverter'])}, sensor {which}; flag bad {bad:.0f} %"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("-o", "--output", type=Path, help="directory of the pictures")
    options = parser.parse_args()
    for line in chain(icub_lines(), inverter_lines(), kona_lines()):
        print(line, flush=True)
    if options.output:
        options.output.mkdir(parents=True, exist_ok=True)
        for path in draw(options.output):
            print(f"written: {path}")


if __name__ == "__main__":
    main()
