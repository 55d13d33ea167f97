"""How cost grows: with drives, with the length of a log, with the sample rate; and a fleet's bill.

Straight lines in a double logarithmic picture (`docs/pictures/growth.svg`). The bill is on paper:
what these figures make of a thousand trains that record a whole day.
"""

from __future__ import annotations

import resource
import tempfile
import time
from functools import partial
from pathlib import Path
from typing import Final, NamedTuple

from bench.filters import BLOCK, FLEETS, compiled
from bench.judges import variational
from bench.speed import best, quiet
from bench.thermal import cost
from bench.wire import log_of
from dbc.candump.reader import Reader
from estimators.models.pmsm import SUB_STEP_S

HEADER = ("what grows", "to", "cost", "per", "memory")
SEE = "![Cost with drives, with a log's length and with the sample rate](pictures/growth.svg)"
PICTURE: Final = Path("docs/pictures/growth.svg")
READ_MB: Final = (1, 10, 100, 1000)
REPLAY_S: Final = (6, 20, 60)
"""Of a log of three drives."""
RATES_HZ: Final = (500, 1000, 2000, 4000, 8000)
TRAINS, DRIVES, HOURS, FAST_HZ = 1000, 16, 18, 8000
"""The bill: trains, drives of each, hours of service a day, samples a second."""
CORE_HOUR_EUR: Final = 0.04
"""A rented processor's, for an hour; an assumption, not a measurement."""


Row = tuple[str, ...]


class Curve(NamedTuple):
    """One line of the picture: cost y (s) over x."""

    name: str
    x: list[float]
    y: list[float]


def drives() -> list[Curve]:
    """s of one tick of 10 ms at 500 samples a second, or one sample of the thermal monitor."""
    sizes = [float(n) for n in FLEETS]
    return [
        Curve("EKF, 5 samples", sizes, [5 / BLOCK * compiled("ekf", n, BLOCK) for n in FLEETS]),
        Curve(
            "UKF, 5 samples", sizes,
            [5 / BLOCK * compiled("ukf", n, BLOCK) for n in FLEETS],
        ),
        Curve("VB verdict", sizes[1:], [variational(n) for n in FLEETS[1:]]),
        Curve("thermal watch, a tick's share", sizes, [cost(n)[0] for n in FLEETS]),
    ]  # fmt: skip


def reading(folder: Path) -> tuple[Curve, list[float]]:
    """s to read so many MB of candump lines, and the memory that it took, MB."""
    minute = log_of(folder, "traction.dbc").read_bytes()
    log, seconds, grown = folder / "long.log", [], []
    sum(block.size for block in Reader(folder / "traction.log").blocks())
    for size in READ_MB:
        whole_lines = minute.rfind(b"\n", 0, int(size * 1e6)) + 1
        with log.open("wb") as out:
            for _ in range(max(round(size * 1e6 / len(minute)), 1)):
                out.write(minute[:whole_lines])
        before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
        began = time.perf_counter()
        sum(block.size for block in Reader(log).blocks())
        seconds.append(time.perf_counter() - began)
        grown.append((resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before) / 1024)
    log.unlink()
    return Curve("candump read", [float(size) for size in READ_MB], seconds), grown


def replaying(folder: Path) -> Curve:
    """s to replay logs of so many MB."""
    sizes, seconds = [], []
    for span in REPLAY_S:
        log = folder / f"replay{span}.log"
        quiet("sim", "healthy", "--duration", str(span), "-o", str(log))
        sizes.append(log.stat().st_size / 1e6)
        seconds.append(best(partial(quiet, "replay", str(log), "-o", str(folder / "o.log")), 1))
        log.unlink()
    return Curve("replay, flags out", sizes, seconds)


def sampling() -> Curve:
    """s of a second of one drive's filter, by its sample rate; sub-steps as the gateway takes."""
    n, seconds = 64, []
    for rate in RATES_HZ:
        steps = round(1.0 / rate / SUB_STEP_S)
        seconds.append(rate * compiled("ekf", n, BLOCK, sub_steps=max(steps, 1)) / BLOCK / n)
    return Curve("EKF, a second of one drive", [float(r) for r in RATES_HZ], seconds)


def picture(panels: list[tuple[str, str, str, list[Curve]]], path: Path) -> None:
    import matplotlib as mpl

    mpl.use("Agg")
    from matplotlib import pyplot as plt
    from matplotlib.ticker import NullFormatter

    mpl.rcParams["svg.hashsalt"] = "growth"
    figure, axes = plt.subplots(1, len(panels), figsize=(13, 4.2), layout="constrained")
    for axis, (title, x, y, curves) in zip(axes, panels, strict=True):
        for curve, marker, colour in zip(
            curves, "os^D", ("#0072B2", "#D55E00", "#009E73", "#CC79A7"), strict=False
        ):
            axis.plot(curve.x, curve.y, marker=marker, color=colour, label=curve.name, lw=1.3)
        wide = max(curves[0].y) > 20.0 * min(curves[0].y)
        axis.set(title=title, xlabel=x, ylabel=y, xscale="log", yscale="log" if wide else "linear")
        axis.xaxis.set_minor_formatter(NullFormatter())
        axis.set_xticks(curves[0].x, [f"{value:g}" for value in curves[0].x])
        if not wide:
            axis.set_ylim(bottom=0.0)
        axis.grid(alpha=0.3, which="both")
        axis.legend(fontsize="small")
    figure.savefig(path, metadata={"Date": None})
    plt.close(figure)


def bill(per_sample_s: float, read_s: float, replay_s: float, line: float) -> list[Row]:
    """A day of the fleet, on paper: every sample filtered, every line read; or all of it replayed.

    per_sample_s: of one drive's filter; read_s, replay_s: of one line, line: bytes of it.
    """
    samples = TRAINS * DRIVES * HOURS * 3600.0 * FAST_HZ
    # CAN FD: eight samples a frame, a line each.
    lines = samples / 8.0
    what = f"calculated: {TRAINS} trains x {DRIVES} drives x {HOURS} h at {FAST_HZ / 1000:g} kHz"
    out = [(what, f"{lines / 1e12:.2f} T lines, {lines * line / 1e12:.0f} TB a day", "", "", "")]
    parts = (
        ("filters alone", samples * per_sample_s),
        ("reading alone", lines * read_s),
        ("replay: read, decode, filter, both detectors, flags", lines * replay_s),
    )
    for name, spent in parts:
        hours = spent / 3600.0
        out.append((
            f"  {name}", "a day", f"{hours:.0f} core hours: {hours / 24:.1f} cores all day",
            f"{hours * CORE_HOUR_EUR:.0f} EUR at {CORE_HOUR_EUR} a core hour (assumed)", "",
        ))  # fmt: skip
    return out


def rows() -> list[Row]:
    """Tables; writes the picture."""
    by_drives, by_rate = drives(), sampling()
    with tempfile.TemporaryDirectory() as name:
        read, grown = reading(Path(name))
        replayed = replaying(Path(name))
        text = (Path(name) / "traction.log").read_bytes()
        line_bytes = len(text) / text.count(b"\n")
    out = []
    for curve in by_drives:
        for n, spent in zip(curve.x, curve.y, strict=True):
            out.append((f"drives: {curve.name}", f"{n:.0f}", f"{1e6 * spent:.2f} us",
                        f"{1e9 * spent / n:.0f} ns a drive", ""))  # fmt: skip
    for size, spent, more in zip(read.x, read.y, grown, strict=True):
        out.append((f"log: {read.name}", f"{size:.0f} MB", f"{spent:.3f} s",
                    f"{1e3 * spent / size:.2f} ms a MB", f"+{more:.1f} MB"))  # fmt: skip
    for size, spent in zip(replayed.x, replayed.y, strict=True):
        out.append((f"log: {replayed.name}", f"{size:.1f} MB", f"{spent:.2f} s",
                    f"{1e3 * spent / size:.0f} ms a MB", ""))  # fmt: skip
    for rate, spent in zip(by_rate.x, by_rate.y, strict=True):
        out.append((f"rate: {by_rate.name}", f"{rate:.0f} Hz", f"{1e3 * spent:.3f} ms",
                    f"{1e9 * spent / rate:.0f} ns a sample", ""))  # fmt: skip
    picture(
        [
            ("with drives", "drives", "s", by_drives),
            ("with the log", "MB", "s", [read, replayed]),
            ("with the sample rate", "samples a second", "s a second of one drive", [by_rate]),
        ],
        PICTURE,
    )
    read_s, replay_s = (c.y[-1] / (c.x[-1] * 1e6 / line_bytes) for c in (read, replayed))
    return out + bill(by_rate.y[-1] / by_rate.x[-1], read_s, replay_s, line_bytes)
