"""The timing of a run: table, histograms in powers of two, a picture."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Final, NamedTuple

from gateway.io.timing import Stage
from gateway.io.whole_file import write_csv
from gateway.reports.histograms import write_histograms

if TYPE_CHECKING:
    from gateway.io.live import LiveSnapshot

HEADER: Final = ("stage", "from_us", "below_us", "count")


class Timed(NamedTuple):
    """Timing of a run in real time; picture: stem of its histograms."""

    stages: Sequence[Stage]
    period_ns: int
    ticks: int
    missed: int
    picture: str = "timing"


def timed(seen: LiveSnapshot, period_ns: int) -> Timed:
    """The timing of a run so far."""
    return Timed(seen.timing.stage_rows(), period_ns, seen.tick + 1, seen.missed)


def leave(folder: Path, run: Timed, title: str) -> None:
    """Write timing.csv, timing.svg and report.md, report.html. Raises OSError."""
    from gateway.reports.page import plain, write

    tables(folder, run)
    lines = [f"# {plain(title)}", "", *section(run)]
    write(folder, title, "\n".join(lines), [run.picture])


def tables(folder: Path, run: Timed) -> None:
    """Write timing.csv and timing.svg. Raises OSError."""
    folder.mkdir(parents=True, exist_ok=True)
    rows = [
        (stage.name, f"{begin / 1e3:.3f}", f"{below / 1e3:.3f}", count)
        for stage in run.stages
        for begin, below, count in stage.octaves
    ]
    write_csv(folder / "timing.csv", [HEADER, *rows])
    write_histograms(folder / "timing.svg", run.stages, run.period_ns)


def section(run: Timed) -> list[str]:
    """Lines of a report in Markdown."""
    period_ns = run.period_ns
    lines = [
        f"{run.ticks} ticks of {period_ns / 1e6:g} ms, {run.missed} missed. Milliseconds; a "
        "percentile is the upper end of its bucket (at most a quarter more than the value).", "",
        "| stage | count | p50 | p99 | p99.9 | largest | p99 of the period |",
        "|---|---|---|---|---|---|---|",
    ]  # fmt: skip
    for s in run.stages:
        spans = " | ".join(f"{ns / 1e6:.3f}" for ns in (s.p50, s.p99, s.p999, s.largest))
        measured = f"{spans} | {100.0 * s.p99 / period_ns:.1f} %"
        lines.append(f"| {s.name} | {s.values} | {measured if s.values else ' | '.join('-' * 5)} |")
    return [
        *lines,
        "", "lateness: delay of a tick's start after its deadline. The other stages follow the "
        "frame that completed the newest sample, from its kernel time stamp: waiting for "
        "the tick; reading the queue; deciding (decode, estimate, judge, encode); sending, until "
        "the tick's last frame is handed over; and all of it, frame to flag.",
        "", f"![Histograms of every stage]({run.picture}.svg)", "",
    ]  # fmt: skip
