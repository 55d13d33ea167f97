"""The files of an evaluation: a Markdown table, CSV files, ROC and reliability pictures."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Sequence
from pathlib import Path
from typing import Any, Final

import numpy as np

from gateway.io.whole_file import write_csv, write_text
from gateway.study.evaluation import BINS, COLUMNS, Line, reliability, roc, row
from gateway.study.reproduction_figures import save, subplots
from gateway.study.thermal_scores import table_of

COLOURS: Final = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9", "#000000")
"""Colour-blind safe (Okabe-Ito); the lines also differ by dashes."""
DASHES: Final = ("-", "--", "-.", ":")
DIGITS: Final = {
    "F1": 4, "F1 mean": 3, "F1 sd": 3, "F1 uncut": 4, "precision": 4, "recall": 4,
    "false alarms / h": 1, "delay ms": 0, "delay 90 % ms": 0, "delay abrupt ms": 0, "adhering %": 2,
    "unknown %": 2, "false %": 3, "dangerous %": 2, "load rmse Nm": 2, "load rmse %": 2,
    "ROC area": 4, "ECE": 4, "common F1": 4, "common delay ms": 0, "common false / h": 1,
}  # fmt: skip
LEGEND: Final = """\
Scored per drive and flag frame, without 30 ms around each edge and the first 0.5 s; an unknown flag
counts as not raised. F1, precision and recall are pooled over all runs; mean and standard deviation
are over runs with a loss. F1 uncut leaves out the time in which the rail is good again and the
drive's own slip limiter still holds its torque back. A loss counts if it takes at least 20 % of the
demand. The delay of the losses found runs from the onset to the first `AdhesionLost`; abrupt: at
least half of the demand lost within 20 ms. A false alarm is an interval of `AdhesionLost` that
overlaps no loss, per healthy hour of the train. Adhering, unknown, false (`AdhesionLost`): share of
healthy frames. Dangerous: share of lost frames that are `Adhering` later than 100 ms after the
onset. Load: estimated minus true load while tracking, % of rated torque. ROC area and expected
calibration error (ECE) from `LossProbability`. Common: `CommonMode`, scored against losses of all
drives together."""


def cells(line: Line) -> list[str]:
    """One line as text, a dash where there is no number."""
    out = []
    for name, value in zip(COLUMNS, row(line), strict=True):
        if isinstance(value, float):
            known = math.isfinite(value)
            out.append(f"{value:.{DIGITS[name]}f}" if known else "-")
        else:
            out.append(str(value))
    return out


def table(lines: Iterable[Line]) -> str:
    """All lines as a Markdown table."""
    return table_of(COLUMNS, map(cells, lines))


def write(folder: Path, title: str, lines: Sequence[Line]) -> list[Path]:
    """Write all files into `folder`, which is made if necessary; return their paths."""
    folder.mkdir(parents=True, exist_ok=True)
    text = folder / "evaluation.md"
    write_text(text, f"# {title}\n\n{table(lines)}\n\n{LEGEND}\n")
    written = [text]
    for name, rows in (
        ("evaluation.csv", [COLUMNS, *([_text(x) for x in row(line)] for line in lines)]),
        ("runs.csv", _runs(lines)),
        ("roc.csv", _curves(lines)),
        ("reliability.csv", _bins(lines)),
    ):
        write_csv(folder / name, rows)
        written.append(folder / name)
    for name, draw, what in (("roc", _draw_roc, "ROC"), ("reliability", _draw_bins, "Calibration")):
        written += _picture(folder / name, lines, draw, f"{what}: {title}")
    return written


def _text(value: str | float) -> str:
    """A value as text; nine digits for a float, empty if it is not finite."""
    if isinstance(value, float):
        return f"{value:.9g}" if math.isfinite(value) else ""
    return str(value)


def _runs(lines: Sequence[Line]) -> Iterable[Sequence[object]]:
    yield ("family", "detector", "seed", "f1", "false_alarms", "losses", "missed", "delay_ms",
           "unknown", "load_rmse_nm", "common_f1")  # fmt: skip
    for line in lines:
        for seed, run in zip(line.seeds, line.runs, strict=True):
            flags = run.flags
            delay = max(flags.delays_ms, default=math.nan)
            numbers = (flags.f1, flags.alarms, flags.losses, flags.missed, delay,
                       flags.unknown_share, run.load_rmse_nm,
                       run.common.f1 if line.common else math.nan)  # fmt: skip
            yield line.family, line.detector, seed, *(_text(value) for value in numbers)


def _curves(lines: Sequence[Line]) -> Iterable[Sequence[object]]:
    yield "family", "detector", "threshold", "true_rate", "false_rate"
    for line in lines:
        for numbers in zip(*roc(line.total.levels), strict=True):
            yield line.family, line.detector, *(_text(float(value)) for value in numbers)


def _bins(lines: Sequence[Line]) -> Iterable[Sequence[object]]:
    yield "family", "detector", "bin", "said", "true", "frames"
    for line in lines:
        found = reliability(line.total.levels)
        for k in range(BINS):
            predicted, true = _text(float(found.predicted[k])), _text(float(found.true[k]))
            yield line.family, line.detector, k, predicted, true, int(found.frames[k])


def _picture(
    stem: Path, lines: Sequence[Line], draw: Callable[[Any, Line, Any], None], title: str
) -> list[Path]:
    """One small picture per family, one curve per detector; PNG and SVG."""
    families = list(dict.fromkeys(line.family for line in lines))
    detectors = list(dict.fromkeys(line.detector for line in lines))
    across = min(4, len(families))
    down = -(-len(families) // across)
    figure, axes = subplots(down, across, (3.2 * across, 3.2 * down + 0.6))
    for axis in list(axes.flat)[len(families) :]:
        axis.set_axis_off()
    for axis, family in zip(axes.flat, families, strict=False):
        for line in lines:
            if line.family == family:
                k = detectors.index(line.detector)
                style = {"color": COLOURS[k % len(COLOURS)], "ls": DASHES[k % len(DASHES)]}
                draw(axis, line, {**style, "label": line.detector, "lw": 1.4})
        axis.set_title(family)
        axis.grid(alpha=0.3)
    handles, labels = axes.flat[0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", ncols=len(labels) or 1)
    figure.suptitle(title)
    save(figure, stem)
    return [stem.with_suffix(".png"), stem.with_suffix(".svg")]


def _draw_roc(axis: Any, line: Line, style: Any) -> None:
    curve = roc(line.total.levels)
    # Steps, because there is no threshold between two levels.
    axis.plot(curve.false_rate, curve.true_rate, drawstyle="steps-post", **style)
    axis.set_xscale("symlog", linthresh=1e-4)
    axis.set_xlim(0.0, 1.0)
    axis.set_ylim(0.0, 1.02)
    axis.set_xlabel("false alarm rate")
    axis.set_ylabel("share found")


def _draw_bins(axis: Any, line: Line, style: Any) -> None:
    found = reliability(line.total.levels)
    full = found.frames > 0
    axis.plot([0, 1], [0, 1], color="#999999", lw=0.8)
    axis.plot(found.predicted[full], found.true[full], marker="o", ms=3, **style)
    axis.set_xlim(0.0, 1.0)
    axis.set_ylim(0.0, 1.0)
    axis.set_xlabel("probability said")
    axis.set_ylabel("share lost")
    axis.set_yticks(np.linspace(0.0, 1.0, 6))
