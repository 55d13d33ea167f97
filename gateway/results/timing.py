"""What a run leaves behind about its timing: table, histograms in powers of two, a picture."""

from __future__ import annotations

import csv
from collections.abc import Sequence
from pathlib import Path
from typing import Final, NamedTuple

HEADER: Final = ("stage", "from_us", "below_us", "count")
_COLUMNS: Final = 2
_SHOWN_NS: Final = 1024
"""What is shorter shares one bar."""


class Stage(NamedTuple):
    """One histogram. ns; octaves: (from, below, count) in powers of two, empty ones between."""

    name: str
    values: int
    p50: int
    p99: int
    p999: int
    largest: int
    octaves: Sequence[tuple[int, int, int]]


def leave(
    folder: Path, stages: Sequence[Stage], title: str, period_ns: int, ticks: int, missed: int
) -> None:
    """Write timing.csv, timing.svg and report.md, report.html. Raises OSError."""
    from gateway.results.page import write

    folder.mkdir(parents=True, exist_ok=True)
    with (folder / "timing.csv").open("w", newline="", encoding="utf-8") as file:
        rows = csv.writer(file, lineterminator="\n")
        rows.writerow(HEADER)
        for stage in stages:
            for begin, below, count in stage.octaves:
                rows.writerow((stage.name, f"{begin / 1e3:.3f}", f"{below / 1e3:.3f}", count))
    _picture(folder / "timing.svg", stages, period_ns)
    write(folder, title, text(stages, title, period_ns, ticks, missed), ["timing"])


def text(stages: Sequence[Stage], title: str, period_ns: int, ticks: int, missed: int) -> str:
    """The report in Markdown."""
    lines = [
        f"# {title}", "",
        f"{ticks} ticks of {period_ns / 1e6:g} ms, {missed} missed. Milliseconds; a percentile "
        "is the upper end of its bucket (at most a quarter more than the value).", "",
        "| stage | count | p50 | p99 | p99.9 | largest | p99 of the period |",
        "|---|---|---|---|---|---|---|",
    ]  # fmt: skip
    for s in stages:
        spans = " | ".join(f"{ns / 1e6:.3f}" for ns in (s.p50, s.p99, s.p999, s.largest))
        lines.append(f"| {s.name} | {s.values} | {spans} | {100.0 * s.p99 / period_ns:.1f} % |")
    lines += [
        "", "lateness: of a tick's begin after its deadline. The rest is of the frame that "
        "completed the newest sample, from the kernel's stamp: waiting for the tick; reading "
        "the queue; deciding (decode, estimate, judge, encode); sending, until the tick's last "
        "frame is handed over; and all of it, frame to flag.",
        "", '<img alt="Histograms of every stage" src="timing.svg">', "",
    ]  # fmt: skip
    return "\n".join(lines)


def _picture(path: Path, stages: Sequence[Stage], period_ns: int) -> None:
    """A histogram per stage, a bar an octave, on one axis of time."""
    import matplotlib as mpl

    mpl.use("Agg")
    from matplotlib import pyplot as plt

    from gateway.results.pictures import BLUE, ORANGE

    rows = -(-len(stages) // _COLUMNS)
    figure, axes = plt.subplots(
        rows, _COLUMNS, sharex=True, figsize=(10, 2.2 * rows), squeeze=False, layout="constrained"
    )
    most = max([below for stage in stages for _, below, _ in stage.octaves] + [period_ns])
    axes[0, 0].set_xlim(0.9 * _SHOWN_NS / 2e6, 1.5 * most / 1e6)
    axes[0, 0].set_xscale("log")
    for axis, stage in zip(axes.flat, stages, strict=False):
        bars: dict[int, int] = {}
        for _, below, count in stage.octaves:
            bars[max(below, _SHOWN_NS)] = bars.get(max(below, _SHOWN_NS), 0) + count
        below_ms = [below / 1e6 for below in bars]
        begin_ms = [0.5 * edge for edge in below_ms]
        axis.bar(
            begin_ms, list(bars.values()), begin_ms, align="edge", color=BLUE, edgecolor="white",
            lw=0.5,
        )  # fmt: skip
        if stage.values:
            axis.axvline(stage.p99 / 1e6, color=ORANGE, lw=1.2, label="p99")
        axis.axvline(period_ns / 1e6, color="#555555", lw=1.0, ls="--", label="period")
        axis.set_title(stage.name, fontsize="medium")
        axis.set_yscale("symlog", linthresh=1.0)
        axis.grid(alpha=0.3)
    for axis in axes[-1]:
        axis.set_xlabel("time / ms")
    for row in axes:
        row[0].set_ylabel("ticks")
    axes[0, 0].legend(fontsize="small")
    figure.savefig(path, metadata={"Date": None})
    plt.close(figure)
