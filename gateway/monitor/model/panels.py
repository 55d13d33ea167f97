"""Each panel of the terminal view as text, drawn from a snapshot alone. Pure.

No panel shows anything by colour alone: good has a tick, bad a cross, unknown a question mark.
"""

from __future__ import annotations

from typing import Final

from rich.text import Text

from gateway.core.codes import FaultClass, Flag, Health, Reason
from gateway.monitor.model.plots import GREEN, GREY, ORANGE, SKY, VERMILION, bar
from gateway.monitor.model.snapshot import DriveRow, Event, Lateness, Snapshot, word

_FLAG: Final = {Flag.UNKNOWN: ("?", GREY), Flag.GOOD: ("✓", GREEN), Flag.BAD: ("✗", VERMILION)}
_HEALTH: Final = {
    Health.TRACKING: GREEN, Health.DIVERGED: VERMILION, Health.INPUT_INVALID: ORANGE,
    Health.PREDICTING: ORANGE,
}  # fmt: skip
_LEVEL: Final = {"error": ("✗", VERMILION), "warning": ("!", ORANGE), "info": ("·", GREY)}
_FAULTY: Final = (FaultClass.UNKNOWN, FaultClass.NONE)
_SET: Final = (
    ("common_mode", "common"), ("sensor_fault", "sensors"), ("comm_fault", "comm"),
    ("estimator_fault", "estimators"), ("overrun", "cycle"),
)  # fmt: skip
WIDE: Final = 118
"""Width in characters from which the table has all columns."""


def flag_text(name: str, flag: Flag) -> Text:
    """A flag with its sign; name: name of the field."""
    sign, style = _FLAG[flag]
    bold = "bold " if flag is Flag.BAD else ""
    return Text(f"{sign}{word(name, flag)}", style=bold + style)


def number(value: float | None, digits: int = 1, unit: str = "") -> str:
    """A number as text, or a question mark for None."""
    if value is None:
        return "?"
    return f"{value:.{digits}f}{' ' + unit if unit else ''}"


def load_text(row: DriveRow) -> str:
    """Load torque and its standard deviation."""
    if row.load_nm is None:
        return "?"
    sigma = "?" if row.load_sigma_nm is None else f"{row.load_sigma_nm:.1f}"
    return f"{row.load_nm:.1f}±{sigma}"


def thermal(row: DriveRow) -> Text:
    """The thermal flag; the fault class if it is bad."""
    if row.thermal is Flag.BAD and row.fault_class not in _FAULTY:
        return Text(f"✗{word('', row.fault_class)}", style=f"bold {VERMILION}")
    return flag_text("thermal", row.thermal)


def age(seconds: float | None) -> str:
    """An age as text in ms or s; `never` for None."""
    if seconds is None:
        return "never"
    return f"{seconds * 1e3:.0f} ms" if seconds < 1 else f"{seconds:.1f} s"


_Cells = tuple[tuple[str, int, str], ...]
_NARROW: Final[_Cells] = (
    ("drive", 6, "<"), ("adhesion", 14, "<"), ("P(lost)", 8, ">"), ("load Nm", 11, ">"),
    ("rad/s", 8, ">"), ("health", 14, "<"), ("thermal", 13, "<"), ("mixed", 6, ">"),
)  # fmt: skip
_MORE: Final[_Cells] = (
    ("MAISD", 7, ">"), ("state", 10, "<"), ("heartbeat", 15, "<"), ("rejected", 9, ">"),
    ("age", 8, ">"),
)  # fmt: skip


def _cells(width: int) -> _Cells:
    return _NARROW + (_MORE if width >= WIDE else ())


def heading(width: int) -> Text:
    """The names of the table's columns. width: of the table in characters."""
    text = Text(no_wrap=True)
    for head, size, side in _cells(width):
        text.append(_cell(Text(head), size, side))
    text.stylize("bold underline")
    return text


def drive_table(shown: Snapshot, selected: int, width: int) -> Text:
    """A row per drive, the selected one marked, in the columns of `heading`."""
    cells = _cells(width)
    text = Text(no_wrap=True)
    for row in shown.drives:
        health = Text(word("", row.health), style=_HEALTH.get(row.health, GREY))
        lost = "?" if row.loss_probability is None else f"{100 * row.loss_probability:.0f} %"
        line = [
            Text(f"{'▶' if row.node == selected else ' '}{row.node:>3}"),
            flag_text("adhesion", row.adhesion), Text(lost), Text(load_text(row)),
            Text(number(row.speed_rad_s)), health, thermal(row), Text(number(row.mixed_c)),
        ]  # fmt: skip
        if width >= WIDE:
            line += [
                Text(number(row.maisd_k, 2)), Text(row.state or "?"),
                Text(row.heartbeat or "?", style=VERMILION if row.heartbeat == "Silent" else ""),
                Text(str(row.rejected)), Text(age(row.age_s)),
            ]  # fmt: skip
        drawn = Text("\n" if text else "")
        for value, (_, size, side) in zip(line, cells, strict=True):
            drawn.append(_cell(value, size, side))
        drawn.right_crop()  # the last column is for the scroll bar
        if row.node == selected:
            drawn.stylize("bold")
        text.append(drawn)
    return text


def _cell(value: Text, size: int, side: str) -> Text:
    """A value cut or padded to `size` - 1 characters, and a space."""
    value = value.copy()
    space = size - 1
    if len(value) > space:
        value.truncate(space, overflow="ellipsis")
    fill = " " * (space - len(value))
    value = Text(fill).append(value) if side == ">" else value.append(fill)
    return value.append(" ")


def detail(shown: Snapshot, selected: int) -> Text:
    """The values of the selected drive that do not fit in the table."""
    row = next((r for r in shown.drives if r.node == selected), shown.drives[0])
    text = Text(no_wrap=True)
    text.append(f"drive {row.node} ", style=f"bold {SKY}")
    text.append(
        f"stator {number(row.stator_c)}  DE {number(row.drive_end_c)}  "
        f"NDE {number(row.non_drive_end_c)}  ambient {number(row.ambient_c)} "
        f"degC  MAISD {number(row.maisd_k, 2)} K\n"
        f"{row.state or 'state ?'}, {row.heartbeat or 'heartbeat ?'}  "
        f"measured {number(row.measured_speed_rad_s)} rad/s  NIS {number(row.nis)}  "
        f"rejected {row.rejected}  last frame {age(row.age_s)}"
    )
    if row.fault_sensor:
        text.append(f"  at {word('', row.fault_sensor)}", style=ORANGE)
    return text


def gateway(shown: Snapshot) -> Text:
    """The state that the gateway reports of itself, and the flags of the train."""
    row = shown.gateway
    text = Text(no_wrap=True)
    text.append("GATEWAY ", style=f"bold {SKY}")
    if row.source == "shadow":
        text.append("? no gateway here, SHADOW: computed by this monitor", style=f"bold {ORANGE}")
    elif not row.present:
        text.append("? no gateway on this bus", style=f"bold {ORANGE}")
    elif not row.alive:
        late = age(None if row.flags_age_ms is None else row.flags_age_ms / 1e3)
        text.append(f"✗ no flags for {late}", style=f"bold {VERMILION}")
    else:
        text.append(word("", row.state) if row.state is not None else "state ?", style="bold")
        text.append(f"  {row.detector or '?'}  age {number(row.age_ms, 0, 'ms')}")
    grave = row.reason is not None and row.reason is not Reason.NONE
    text.append("\nreason ")
    text.append("?" if row.reason is None else word("", row.reason), style=ORANGE if grave else "")
    text.append(f", thermal {'?' if row.thermal_reason is None else word('', row.thermal_reason)}")
    text.append(f"  late p99 {number(row.lateness_p99_us, 0)} us\n")
    for name, label in _SET:
        flag = getattr(row, name)
        sign, style = _FLAG[flag]
        label_text = f"{label} {word(name, flag)}" if flag is Flag.BAD else label
        text.append(f"{sign}{label_text} ", style=f"bold {style}" if flag is Flag.BAD else style)
    return text


def link(shown: Snapshot) -> Text:
    """The state of the bus as seen by the monitor, and the gateway's counters."""
    row, status = shown.link, shown.gateway
    text = Text(no_wrap=True)
    text.append("BUS ", style=f"bold {SKY}")
    fine = row.state == "active"
    text.append(f"{'✓' if fine else '✗'}{row.state}", style=GREEN if fine else f"bold {VERMILION}")
    share = None if row.bus_load_pct is None else row.bus_load_pct / 100
    text.append(f" {number(row.bus_load_pct, 0)} % ")
    text.append(bar(share or 0.0, 8), style=SKY if (share or 0) < 0.8 else VERMILION)
    wrong = sum(row.rejected.values())
    text.append(f"\n{number(row.frames_s, 0)} frames/s  errors {row.error_frames}")
    text.append(f"  bad {wrong}", style=ORANGE if wrong else "")
    text.append(f"  unread {row.unread}" if row.unread else "", style=ORANGE)
    counters = (status.deadline_misses, status.rejected, status.lost_frames)
    missed, rejected, lost = ("?" if n is None else str(n) for n in counters)
    text.append(f"\nmissed {missed}  rejected {rejected}  lost {lost}")
    return text


def lateness(late: Lateness, size: tuple[int, int]) -> Text:
    """Histogram of the lateness of flag frames. size: width in characters, height in lines."""
    width, height = size
    text = Text(no_wrap=True)
    text.append("FLAGS LATE BY", style=f"bold {SKY}")
    if not late.counts:
        return text.append("\nnot known", style=GREY)
    text.append(f"  p99 {_short(late.p99_us or 0)}", style="")
    rows = list(zip(late.edges_us[1:], late.counts, strict=True))
    space = max(height - 1, 1)
    if len(rows) > space:  # merge the lowest bins: the tail matters
        over = len(rows) - space
        rows = [(rows[over][0], sum(n for _, n in rows[: over + 1])), *rows[over + 1 :]]
    most = max(n for _, n in rows)
    for edge, count in rows:
        drawn = bar(count / most, max(width - 17, 3))
        text.append(f"\n<{_short(edge):>7} ")
        text.append(f"{drawn:<{max(width - 17, 3)}}", style=SKY)
        text.append(f" {_count(count):>6}")
    return text


def _short(us: float) -> str:
    """A time, given in microseconds, as a short text."""
    return f"{us:.0f} us" if us < 1000 else f"{us / 1000:.3g} ms"


def _count(n: int) -> str:
    return str(n) if n < 100_000 else f"{n / 1000:.0f}k"


def events(shown: tuple[Event, ...], lines: int) -> Text:
    """The last events, the newest at the bottom. lines: height of the panel."""
    text = Text(no_wrap=True)
    kept = shown[-lines:] if lines > 0 else ()
    if not kept:
        return text.append("no events", style=GREY)
    for k, event in enumerate(kept):
        sign, style = _LEVEL.get(event.level, _LEVEL["info"])
        who = "set    " if event.drive is None else f"drive {event.drive:<2}"
        text.append("\n" if k else "")
        text.append(f"{event.t_s:10.3f} s ", style=GREY)
        text.append(f"{sign} {who:<9}{event.text}", style=style if event.level != "info" else "")
    return text
