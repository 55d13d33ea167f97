"""Small plots out of characters: a curve with its band, bars, a strip of states. Pure.

A curve is of braille dots, two by four to a character; a band is a shade; gaps stay gaps. Colour
only repeats what the characters say.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Final

from rich.text import Text

from gateway.core.codes import Flag

# Okabe and Ito: told apart with any kind of colour vision, also in grey.
GREEN, VERMILION, ORANGE = "#009E73", "#D55E00", "#E69F00"
SKY, GREY, YELLOW = "#56B4E9", "#9A9A9A", "#F0E442"

_BRAILLE: Final = 0x2800
_DOTS: Final = ((0x01, 0x08), (0x02, 0x10), (0x04, 0x20), (0x40, 0x80))
_EIGHTHS: Final = " ▁▂▃▄▅▆▇█"
_SHADE: Final = "░"
GAP: Final = "·"
_STATE: Final = {Flag.UNKNOWN: ("?", GREY), Flag.GOOD: ("─", GREEN), Flag.BAD: ("█", VERMILION)}
SCALE: Final = 7
"""Characters left of a curve."""
Column = list[float]


def columns(
    t_s: Sequence[float], values: Sequence[float | None], start: float, end: float, count: int
) -> list[Column]:
    """Values by time in `count` equal bins from start to end; the unknown are left out."""
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


def curve(
    t_s: Sequence[float],
    values: Sequence[float | None],
    sigmas: Sequence[float | None],
    span: tuple[float, float],
    size: tuple[int, int],
    least: float = 5.0,
) -> Text:
    """Lines of a plot: the numbers of its ends, the curve, a shade of two sigma around it.

    span: from, to in seconds; size: characters, lines (the scale takes `SCALE` of each).
    """
    width, height = max(size[0] - SCALE, 4), max(size[1], 2)
    uppers, lowers = _edges(values, sigmas, 2.0), _edges(values, sigmas, -2.0)
    seen = [
        value
        for line in (values, uppers, lowers)
        for column in columns(t_s, line, *span, 1)
        for value in column
    ]
    if not seen:
        return _empty(width, height)
    low, high = limits(seen, least)

    def row(value: float, rows: int) -> int:
        """Row from the top, clipped."""
        return min(max(round((high - value) / (high - low) * (rows - 1)), 0), rows - 1)

    dots = [[0] * width for _ in range(height)]
    before: int | None = None
    for x, column in enumerate(columns(t_s, values, *span, 2 * width)):
        if not column:
            # One empty bin may only mean that there are more bins than points.
            before = None if x % 2 else before
            continue
        top, bottom = row(max(column), 4 * height), row(min(column), 4 * height)
        if before is not None:  # a jump is drawn as a line
            top, bottom = min(top, before), max(bottom, before)
        before = row(column[-1], 4 * height)
        for y in range(top, bottom + 1):
            dots[y >> 2][x >> 1] |= _DOTS[y & 3][x & 1]
    shade = [[False] * width for _ in range(height)]
    bands = (columns(t_s, edge, *span, width) for edge in (uppers, lowers))
    for x, (upper, lower) in enumerate(zip(*bands, strict=True)):
        if upper and lower:
            for y in range(row(max(upper), height), row(min(lower), height) + 1):
                shade[y][x] = True
    text = Text(no_wrap=True)
    for y in range(height):
        text.append(_scale(high, low, y, height), style=GREY)
        for x in range(width):
            if dots[y][x]:
                text.append(chr(_BRAILLE + dots[y][x]), style=f"bold {SKY}")
            elif shade[y][x]:
                text.append(_SHADE, style=GREY)
            else:
                text.append(" ")
        text.append("\n" if y < height - 1 else "")
    return text


def _edges(
    values: Sequence[float | None], sigmas: Sequence[float | None], times: float
) -> list[float | None]:
    return [
        value + times * sigma if value is not None and sigma is not None else None
        for value, sigma in zip(values, sigmas, strict=True)
    ]


def _scale(high: float, low: float, y: int, height: int) -> str:
    if y not in (0, height - 1):
        return " " * (SCALE - 1) + "│"
    value = high if y == 0 else low
    return f"{value:6.4g}┤" if abs(value) < 1e5 else f"{value:6.0e}┤"


def _empty(width: int, height: int) -> Text:
    middle = height // 2
    word = "not known".center(width)
    lines = [" " * (SCALE - 1) + "│" + (word if y == middle else "") for y in range(height)]
    return Text("\n".join(lines), style=GREY, no_wrap=True)


def bars(bins: Sequence[Column], grave: float) -> Text:
    """A line of bars 0 .. 1, the highest of each bin; a dot where nothing is known.

    grave: from here on in the colour of what is bad.
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
    """A line of states, the gravest of each bin: lost, unknown, adhering."""
    grave = {Flag.BAD: 2.0, Flag.UNKNOWN: 1.0, Flag.GOOD: 0.0}
    back = {rank: flag for flag, rank in grave.items()}
    text = Text(no_wrap=True)
    for column in columns(t_s, [grave[state] for state in states], *span, width):
        sign, style = _STATE[back[max(column)]] if column else (GAP, GREY)
        text.append(sign, style=style)
    return text


def bar(share: float, width: int) -> str:
    """A horizontal bar; anything above nothing is seen."""
    eighths = min(max(round(share * width * 8), 1 if share > 0 else 0), width * 8)
    full, part = divmod(eighths, 8)
    return "█" * full + (" ▏▎▍▌▋▊▉"[part] if part else "")
