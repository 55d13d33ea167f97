"""Small plots made of characters: a curve with its band, bars, a strip of states. Pure.

plotext draws a curve in braille dots, and its band as a shade; gaps stay gaps. Colour only repeats
what the characters show.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Final

from rich.color import Color
from rich.text import Text
from textual_plotext import Plot

from gateway.core.codes import Flag
from gateway.monitor.model.snapshot import Trace

# Colours of Okabe and Ito: distinct for any kind of colour vision, also in grey.
GREEN, VERMILION, ORANGE = "#009E73", "#D55E00", "#E69F00"
SKY, GREY = "#56B4E9", "#9A9A9A"

_EIGHTHS: Final = " ▁▂▃▄▅▆▇█"
_SHADE: Final = "░"
GAP: Final = "·"
_STATE: Final = {Flag.UNKNOWN: ("?", GREY), Flag.GOOD: ("─", GREEN), Flag.BAD: ("█", VERMILION)}
SCALE: Final = 7
"""Width in characters of the scale to the left of a curve."""
Column = list[float]


def columns(
    t_s: Sequence[float], values: Sequence[float | None], start: float, end: float, count: int
) -> list[Column]:
    """Values in `count` equal bins of time from start to end; unknown values are left out."""
    bins: list[Column] = [[] for _ in range(count)]
    scale = count / max(end - start, 1e-9)
    for t, value in zip(t_s, values, strict=True):
        if value is not None and math.isfinite(value) and start < t <= end:
            bins[min(max(math.ceil((t - start) * scale) - 1, 0), count - 1)].append(value)
    return bins


def limits(values: Sequence[float], least: float) -> tuple[float, float]:
    """Round numbers around all values, at least `least` apart."""
    low, high = min(values, default=0.0), max(values, default=0.0)
    middle, half = (low + high) / 2, max((high - low) / 2, least / 2)
    step = 10.0 ** math.floor(math.log10(2 * half))
    step = step / 2 if 2 * half / step < 4 else step
    return math.floor((middle - half) / step) * step, math.ceil((middle + half) / step) * step


def curve(plot: Plot, trace: Trace, span: tuple[float, float], least: float = 5.0) -> None:
    """Draw the load in Nm with a shade of two sigma around it; gaps stay gaps.

    span: begin and end in seconds; least: least range of the axis in Nm.
    """
    plot.clear_figure()
    plot.xaxes(False, False)
    plot.yaxes(True, False)
    plot.xlim(*span)
    plot.xticks([])
    rows = zip(trace.t_s, trace.load_nm, trace.load_sigma_nm, strict=True)
    here = [row for row in rows if span[0] < row[0] <= span[1]]
    line = [(t, load) for t, load, _ in here]
    band = [
        (t, None if load is None or sigma is None else load + times * sigma)
        for t, load, sigma in here
        for times in (-2.0, 2.0)
    ]
    seen = [y for _, y in line + band if y is not None and math.isfinite(y)]
    low, high = limits(seen, least)
    plot.ylim(low, high)
    ends = [f"{y:6.4g}" if abs(y) < 1e5 else f"{y:6.0e}" for y in (low, high)]
    plot.yticks([low, high], ends if seen else [" " * (SCALE - 1)] * 2)
    if not seen:
        plot.text("not known", sum(span) / 2, (low + high) / 2, alignment="center")
        return
    for points, marker, colour in ((band, _SHADE, GREY), (line, "braille", SKY)):
        t_s, values = zip(*points, strict=True)
        plot.plot(t_s, values, marker=marker, color=Color.parse(colour).get_truecolor())


def bars(bins: Sequence[Column], grave: float) -> Text:
    """A line of bars 0 .. 1, the highest value of each bin; a dot if no value is known.

    grave: value from which a bar has the colour of bad.
    """
    text = Text(no_wrap=True)
    for column in bins:
        if not column:
            text.append(GAP, style=GREY)
            continue
        level = min(max(*column, 0.0), 1.0)
        style = VERMILION if level >= grave else SKY
        text.append(_EIGHTHS[max(1, math.ceil(level * 8))], style=style)
    return text


def strip(
    t_s: Sequence[float], states: Sequence[Flag], span: tuple[float, float], width: int
) -> Text:
    """A line of states, the worst of each bin: lost before unknown before adhering."""
    grave = {Flag.BAD: 2.0, Flag.UNKNOWN: 1.0, Flag.GOOD: 0.0}
    back = {rank: flag for flag, rank in grave.items()}
    text = Text(no_wrap=True)
    for column in columns(t_s, [grave[state] for state in states], *span, width):
        sign, style = _STATE[back[max(column)]] if column else (GAP, GREY)
        text.append(sign, style=style)
    return text


def bar(share: float, width: int) -> str:
    """A horizontal bar; a share above 0 is always visible."""
    eighths = min(max(round(share * width * 8), 1 if share > 0 else 0), width * 8)
    full, part = divmod(eighths, 8)
    return "█" * full + (" ▏▎▍▌▋▊▉"[part] if part else "")
