"""The results of the slip-protection bench, as one page with pictures."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Final

import numpy as np

from gateway.hil.slip_bench import Run
from gateway.hil.slip_plant import Moment
from gateway.hil.slip_score import LOST, Score
from gateway.reports import figures
from gateway.reports.page import picture, plain, table, write

if TYPE_CHECKING:
    from matplotlib.axes import Axes

HEAD: Final = (
    "track", "controller", "score %:", "utilisation %:", "worst creep %:", "locked s:",
    "false interventions:", "delay s:", "stop m:",
)  # fmt: skip
COLOURS: Final = (figures.BLUE, figures.GREEN, figures.PURPLE, figures.YELLOW)
DASHES: Final = ("-", (0, (5, 2)), (0, (2, 1.2)), (0, (5, 1.5, 1, 1.5)))
HATCHES: Final = ("", "////", "....")
NOTES: Final = """
**Utilisation** is the work of the brakes over what rail and demand allowed: at each moment the
smaller of what was asked and what the rail carries at the peak of its creep. The **score** is that
times the share of time without a locked wheel. **Locked**: longest time that an axle had a creep
above 90 %. **False intervention**: torque cut, or flag raised, though for half a second the wheel
neither slid nor was asked for more than the rail carries. **Delay**: from the onset of sliding (5 %
beyond the best creep) to the axle's cut or flag, median; 0 where it was cut already. **Stop**: from
15 to 2 m/s. An axle that is stuck or cut out is not scored.

The tracks have the shape of those of EN 15595:2018+A1:2023 and UIC 541-05, not their trains, speeds
and friction values: this is not a type test.
"""


def cells(run: Run) -> tuple[str, ...]:
    """Cells of one run's row in the table of `HEAD`."""
    s: Score = run.score
    delay = "no slide" if math.isnan(s.delay_s) else f"{s.delay_s:.2f}"
    return (
        run.track.name, run.controller, f"{100 * s.score:.1f}", f"{100 * s.utilisation:.1f}",
        f"{100 * s.worst_creep:.0f}", f"{s.locked_s:.2f}", f"{s.false_interventions}", delay,
        f"{s.stopping_m:.0f}",
    )  # fmt: skip


def leave(folder: Path, runs: Sequence[Run], device: str) -> Path:
    """Write `report.html` of these runs, with pictures of those of `device`. Raises OSError."""
    folder.mkdir(parents=True, exist_ok=True)
    own = [run for run in runs if run.controller == device]
    mean = np.mean([run.score.score for run in own])
    title = f"Slip protection: {device} scores {100 * mean:.1f} %"
    lines = [f"# {plain(title)}", "", *table(HEAD, ([plain(c) for c in cells(r)] for r in runs))]
    stems = ["scores"]
    scores(folder / "scores.svg", runs)
    lines += [*picture("score of each controller on each track", "scores"), NOTES]
    for run in own:
        stem = run.track.name
        lines += ["", f"## {plain(run.track.title)}", *picture(f"run on {stem}", stem)]
        ride_picture(folder / f"{stem}.svg", run)
        stems.append(stem)
    write(folder, title, "\n".join(lines) + "\n", stems)
    return folder / "report.html"


def scores(path: Path, runs: Sequence[Run]) -> None:
    """Draw a bar chart of each controller's score on each track."""
    by: dict[str, dict[str, float]] = {}
    for run in runs:
        by.setdefault(run.controller, {})[run.track.name] = 100.0 * run.score.score
    tracks = list(dict.fromkeys(run.track.name for run in runs))
    with figures.styled():
        figure, (axis,) = figures.panels([figures.Panel(2.2, "score / %")], top_in=0.4)
        _bars(axis, by, tracks)
        axis.set_xlabel("")
        figures.legend(axis)
        figures.save(figure, path)


def _bars(axis: Axes, by: Mapping[str, Mapping[str, float]], tracks: Sequence[str]) -> None:
    width = 0.8 / len(by)
    for k, (name, found) in enumerate(by.items()):
        at = np.arange(len(tracks)) + (k - 0.5 * (len(by) - 1)) * width
        high = [found.get(track, math.nan) for track in tracks]
        axis.bar(at, high, width, color=COLOURS[k], hatch=HATCHES[k], edgecolor="white", label=name)
        for x, value in zip(at, high, strict=True):
            axis.text(x, value + 1.0, f"{value:.0f}", ha="center", fontsize=7)
    axis.set_xticks(range(len(tracks)), tracks)
    axis.set_ylim(0.0, 109.0)
    axis.grid(visible=False, axis="x")


def ride_picture(path: Path, run: Run) -> None:
    """Draw speeds, brake torque with the torque that rail and demand allow, limits and flags."""
    moments = run.moments
    t_s = np.array([m.t_s for m in moments])
    wanted = [
        figures.Panel(1.7, "speed / m/s", names=True),
        figures.Panel(1.3, "all axles\ntorque / kNm", names=True),
        figures.Panel(1.3, "torque let\nthrough / %", names=True),
    ]
    with figures.styled():
        figure, (speed, torque, limit) = figures.panels(wanted, top_in=0.15)
        speed.plot(t_s, [m.train_m_s for m in moments], color="black", lw=1.6, label="train")
        for k, (color, dash) in enumerate(zip(COLOURS, DASHES, strict=True)):
            style = {"color": color, "ls": dash, "lw": 1.0, "label": f"axle {k + 1}"}
            speed.plot(t_s, [m.wheel_m_s[k] for m in moments], **style)
            limit.plot(t_s, [100.0 * m.limit[k] for m in moments], **style)
        torque.plot(t_s, [_allowed_knm(m) for m in moments], color="black", lw=1.0,
                    ls=(0, (4, 2)), label="rail and demand allow")  # fmt: skip
        torque.plot(t_s, [1e-3 * m.load_nm.sum() for m in moments], color=figures.BLUE, lw=1.1,
                    label="on the rail")  # fmt: skip
        lost = np.array([m.flag == LOST for m in moments])
        for k in range(lost.shape[1]):
            at = np.where(lost[:, k], -6.0 - 8.0 * k, np.nan)
            limit.plot(t_s, at, color=figures.ORANGE, lw=2.5, solid_capstyle="butt",
                       label=None if k else "AdhesionLost, axle 1 to 4 from above")  # fmt: skip
        for axis in (speed, torque, limit):
            figures.legend(axis, 6)
        speed.set_ylim(bottom=0.0)
        speed.set_xlim(0.0, t_s[-1])
        figures.save(figure, path)


def _allowed_knm(moment: Moment) -> float:
    return 1e-3 * float(np.minimum(moment.asked_nm, moment.peak_nm).sum())
