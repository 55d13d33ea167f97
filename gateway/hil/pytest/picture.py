"""Picture of a failed expectation: flags and truth over time, and the last frames."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Final

from dbc.codec import Codec
from dbc.frame import Frame, Nanos
from gateway.core.codes import Flag

WIDTH: Final = 64
"""Columns of the strip."""
_WORST_LAST: Final = (Flag.GOOD, Flag.UNKNOWN, Flag.BAD)
SIGNS: Final = {Flag.UNKNOWN: "?", Flag.GOOD: "-", Flag.BAD: "#"}


def strip(points: Sequence[tuple[Nanos, Flag]], first: Nanos, last: Nanos) -> str:
    """A flag over time: `?` unknown, `-` good, `#` bad; blank before the first frame.

    points: stamp and state of every frame, in order. A column that holds several states shows the
    worst of them.
    """
    out = []
    state: Flag | None = None
    k = 0
    for column in range(WIDTH):
        end = first + (last - first) * (column + 1) // WIDTH
        seen = [] if state is None else [state]
        while k < len(points) and points[k][0] <= end:
            # The state before the column counts only if there is no frame in it.
            if points[k][0] > first + (last - first) * column // WIDTH:
                seen = seen if len(seen) > 1 else []
                seen.append(points[k][1])
            else:
                seen = [points[k][1]]
            state = points[k][1]
            k += 1
        out.append(SIGNS[max(seen, key=_WORST_LAST.index)] if seen else " ")
    return "".join(out)


def axis(first: Nanos, last: Nanos) -> str:
    """Labels of a strip: its beginning and end, s."""
    left, right = f"|{first / 1e9:.3f} s", f"{last / 1e9:.3f} s|"
    return left + right.rjust(WIDTH - len(left))


def candump(frame: Frame, channel: str = "can") -> str:
    """A frame as candump -L writes it."""
    mark = "##1" if frame.is_fd else "#"
    return f"({frame.t_ns / 1e9:.6f}) {channel} {frame.can_id:03X}{mark}{frame.data.hex().upper()}"


def frame_texts(frames: Iterable[Frame], codec: Codec) -> list[str]:
    """Frames as lines of text, with their names and, of flag frames, the flags."""
    out = []
    for frame in frames:
        spec = codec.by_id.get(frame.can_id)
        words = ""
        if spec is not None:
            words = f"  {spec.name}"
            if spec.name in ("Gateway_Adhesion", "Gateway_Faults"):
                values = codec.decode(spec, frame.data)
                fields = [
                    f"{name}={_word(int(value.raw))}"
                    for name, value in values.items()
                    if name.startswith(("Adhesion", "Thermal", "SensorF", "CommF")) and value.raw
                ]
                words += "  " + " ".join([f"Reason={int(values['Reason'].raw)}", *fields])
        out.append(candump(frame) + words)
    return out


def _word(raw: int) -> str:
    return {1: "good", 2: "bad"}.get(raw, "unknown")
