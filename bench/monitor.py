"""What a monitor costs: processor time for a second of bus. `python -m bench.monitor`."""

from __future__ import annotations

import time

from dbc.frame import MS, SECOND, Frame
from dbc.frames import block_of
from gateway.hil.bench import run_virtual
from gateway.hil.fitting import fitting
from gateway.monitor.model.observer import Observer
from sim.scenario import find

SCENARIO = "demo"
LOOK_NS = 100 * MS
RUNS = 5


def main() -> None:
    """Three drives and the gateway of the demonstration, looked at ten times a second."""
    scenario = find(SCENARIO)
    config, codec = fitting(None, scenario)
    frames: list[Frame] = []
    run_virtual(scenario, config, codec, [lambda _, seen, sent, __: frames.extend((*seen, *sent))])
    frames.sort(key=lambda f: f.t_ns)
    blocks: dict[int, list[Frame]] = {}
    for frame in frames:
        blocks.setdefault(-(-frame.t_ns // LOOK_NS), []).append(frame)
    looks = [(k * LOOK_NS, block_of(inside)) for k, inside in blocks.items()]
    seconds = frames[-1].t_ns / SECOND
    took = []
    for _ in range(RUNS):
        observer = Observer(codec, config)
        began = time.process_time()
        for now, block in looks:
            observer.add_frames(block, now)
            observer.snapshot(now)
        took.append(time.process_time() - began)
    best = min(took)
    print(
        f"{len(frames)} frames, {seconds:.0f} s of bus, {len(looks)} snapshots: {best:.2f} s of "
        f"processor time, {100 * best / seconds:.0f} % of one, {seconds / best:.0f} times real time"
    )


if __name__ == "__main__":
    main()
