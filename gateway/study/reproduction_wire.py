"""The report's section on the wire: the cost of rounding, slower samples and the bus."""

from __future__ import annotations

import numpy as np

from gateway.study.reproduction import METHODS, STATISTICS
from gateway.study.reproduction_loads import PAPER, PRODUCT
from gateway.study.reproduction_paths import WAYS, Comparison
from gateway.study.reproduction_text import grid, number


def wire(c: Comparison) -> list[str]:
    """Section "Through the wire", one string per paragraph."""
    known = [c.known_from_ns[w, PAPER.name] for w in ("FD bus", "classic bus")]
    bus, direct = c.of("classic bus", PAPER.name), c.of("8 kHz", PAPER.name)
    methods = [f"{m}.PMSM{d}" for m in METHODS.values() for d in (1, 2, 3)]
    pairs = zip(
        methods,
        bus.table.value.reshape(len(methods), -1).tolist(),
        direct.table.value.reshape(len(methods), -1).tolist(),
        strict=True,
    )
    late = [
        f"{d.way}, {d.belief}: {d.age_ns / 1e6:.2f} ms old, within {number(d.rest_nm, 3)} Nm"
        for d in c.delays
    ]
    return [
        "## Through the wire",
        "The same experiment as frames of the simulated inverters in a candump log "
        "(`section5_fd.log`, `section5_classic.log`), replayed by the gateway, which ticks once "
        "per frame or sample and has to find the rotors first: it knows all loads from "
        f"{known[0] / 1e6:.0f} ms (FD) and {known[1] / 1e6:.0f} ms (classic) on. All ways are "
        f"compared at the same {c.instants} instants, 1.125 ms apart so that every phase of a "
        f"frame is met, from {c.first_ns / 1e6:.0f} ms on, as one who reads them live sees them. "
        "Where a way takes the same samples as a bus, it has the same noise. All of Table 1 for "
        "each way: `table1_paths.csv`.",
        "Table 1 at these instants, paper's Q: classic bus (8 kHz without a bus).",
        grid(
            ("Nm", *STATISTICS),
            (
                [name, *(f"{number(x)} ({number(y)})" for x, y in zip(a, b, strict=True))]
                for name, a, b in pairs
            ),
        ),
        "Load error and the statistics that say most:",
        grid(
            ("Nm", "load RMSE drive 1", "drives 2, 3", "median PMSM1 Min", "Max", "mean", "s",
             "IQR", "median PMSM2, 3 s", "VB PMSM1 mean", "s"),
            _way_rows(c),
        ),
        "**What it costs**: change of the load RMSE over all drives, and the largest change of any "
        "of the 72 numbers of Table 1 that are no extremes, and of all 96, Nm.",
        grid(("step", "load RMSE", "72 numbers", "all 96"), _cost_rows(c)),
        "**What the bus itself costs is time**: at the gateway's ticks its loads are those that "
        "the same samples give without a bus, but older, by frame, transmission and tick ("
        + "; ".join(late)
        + "), and they stand until the next tick.",
        "The product's Q and R are what the gateway runs with. The paper's Q follows edges more "
        "slowly, which is most of its load error, and is smoother in between, so that rounding "
        "shows less. On a bus R takes step^2 / 12 of the wire.",
    ]  # fmt: skip


def _way_rows(c: Comparison) -> list[list[str]]:
    """One row per filter and way."""
    rows = []
    shown = [STATISTICS.index(name) for name in ("Min", "Max", "mean", "s", "IQR")]
    mean, s = STATISTICS.index("mean"), STATISTICS.index("s")
    for belief in (PAPER, PRODUCT):
        for way in WAYS:
            seen = c.of(way.name, belief.name)
            vb, _, _, median = seen.table.value
            values = [
                seen.rmse[0], np.sqrt(np.mean(seen.rmse[1:] ** 2)), *median[0, shown],
                np.mean(median[1:, s]), vb[0, mean], vb[0, s],
            ]  # fmt: skip
            rows.append([f"{way.name}, {belief.name}", *(number(float(v)) for v in values)])
    return rows


def _cost_rows(c: Comparison) -> list[list[str]]:
    """One row per filter and pair of ways that differ in one thing only."""
    inner = [k for k, name in enumerate(STATISTICS) if name not in ("Min", "Max")]
    rows = []
    for way in WAYS:
        for belief in (PAPER, PRODUCT) if way.less else ():
            seen, less = c.of(way.name, belief.name), c.of(way.less, belief.name)
            load = np.sqrt(np.mean(seen.rmse**2)) - np.sqrt(np.mean(less.rmse**2))
            moved = np.abs(seen.table.value - less.table.value)
            rows.append(
                [
                    f"{way.cost}; {belief.name}",
                    number(float(load), 3),
                    number(float(moved[..., inner].max())),
                    number(float(moved.max())),
                ]
            )
    return rows
