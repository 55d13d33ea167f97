"""Pictures of docs/real_temperatures.md: `python -m bench.real_temperatures -o docs/pictures`."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise
from pathlib import Path
from typing import Any, Final

import numpy as np

from bench import real_recordings as recordings
from dbc.frame import SECOND
from gateway.core.codes import Flag, Reason
from gateway.reports.figures import BLUE, GREEN, GREY, ORANGE

COLOURS: Final = (BLUE, "#CC79A7", "#E69F00", "#56B4E9", "#000000")
"""Of lines: none of the flags'."""
HATCH: Final = "////"


def _strip(axis: Any, said: recordings.Said, flags: np.ndarray, names: Sequence[str]) -> None:
    """Flags (T, N) as bars, a row each, the first on top."""
    looks = {
        Flag.GOOD: {"fc": GREEN},
        Flag.BAD: {"fc": ORANGE},
        Flag.UNKNOWN: {"fc": "white", "ec": GREY, "hatch": HATCH},
    }
    for k in range(flags.shape[1]):
        cuts = np.flatnonzero(np.diff(flags[:, k])) + 1
        edges = [0, *cuts.tolist(), len(flags) - 1]
        for i, j in pairwise(edges):
            t = said.t_s[[i, j]]
            axis.broken_barh([(t[0], t[1] - t[0])], (k - 0.4, 0.8), lw=0, **looks[flags[i, k]])
    axis.set_yticks(range(flags.shape[1]), names)
    axis.set_ylim(flags.shape[1] - 0.5, -0.5)


def _legend(figure: Any, good: str, bad: str) -> None:
    from matplotlib.patches import Patch

    handles = [
        Patch(color=GREEN, label=good),
        Patch(color=ORANGE, label=bad),
        Patch(fc="white", ec=GREY, hatch=HATCH, label="Unknown"),
    ]
    figure.legend(handles=handles, loc="outside lower center", ncols=3, fontsize="small")


def draw(folder: Path) -> list[Path]:
    """The pictures of docs/real_temperatures.md; their paths."""
    import matplotlib as mpl

    mpl.use("Agg")
    from matplotlib import pyplot as plt

    made = []
    for name, figure in (("icub", _icub(plt)), ("inverter", _inverter(plt)), ("kona", _kona(plt))):
        path = folder / f"real_{name}.png"
        figure.savefig(path, dpi=100, metadata={"Software": None})
        plt.close(figure)
        made.append(path)
    return made


def _icub(plt: Any) -> Any:
    said = recordings.judge(recordings.icub(), recordings.LEG, recordings.learn_icub())
    figure, (top, strip, heat) = plt.subplots(
        3, 1, figsize=(10, 6.4), sharex=True, layout="constrained",
        gridspec_kw={"height_ratios": [3, 1.5, 1.5]},
    )  # fmt: skip
    readings = recordings.icub()
    for k, joint in enumerate(recordings.JOINTS[:-1]):
        mine = [r for r in readings if r.drive == k]
        t, values = [r.t_ns / SECOND for r in mine], [r.celsius[0] for r in mine]
        top.plot(t, values, color=COLOURS[k], lw=1.1, label=joint)
        for gap in np.flatnonzero(np.diff(np.isnan(values).astype(int)) == 1).tolist():
            top.annotate(
                "no value for\na tenth of a second", (t[gap], values[gap]), (t[gap], 30.5),
                ha="center", fontsize="small", arrowprops={"arrowstyle": "->", "color": GREY},
            )  # fmt: skip
    top.set_ylim(25.4, 32.4)
    top.set_ylabel("motor / degC")
    top.legend(loc="upper left", fontsize="small", ncols=5)
    top.set_title("Motors of a robot's leg: ankle_roll reads 2727 degC throughout (open sensor)")
    top.grid(alpha=0.3)
    _strip(strip, said, said.sensor, recordings.JOINTS)
    _strip(heat, said, said.thermal, recordings.JOINTS)
    strip.set_ylabel("sensor flag")
    heat.set_ylabel("thermal flag")
    heat.set_xlabel("time / s (flags learnt from the first 60 s)")
    top.margins(x=0)
    for axis in (strip, heat):
        axis.tick_params(axis="y", labelsize=8)
    _legend(figure, "NoFault", "Fault")
    return figure


def _inverter(plt: Any) -> Any:
    runs = recordings.judged(recordings.to_accuracy(recordings.learn_inverter()))
    widths = [max(said.t_s[-1], 60.0) for said in runs.values()]
    figure, axes = plt.subplots(
        2, len(runs), figsize=(12, 5), sharex="col", sharey="row", layout="constrained",
        gridspec_kw={"height_ratios": [3, 1], "width_ratios": widths},
    )  # fmt: skip
    for (label, said), top, strip in zip(runs.items(), axes[0], axes[1], strict=True):
        for k, name in enumerate(recordings.BRIDGES):
            # A hole is not a line.
            shown = np.where(said.reason[:, k] == Reason.STALE, np.nan, said.celsius[:, k])
            top.plot(said.t_s, shown, color=COLOURS[k], lw=0.5, label=name)
        top.set_title(label)
        top.grid(alpha=0.3)
        top.margins(x=0)
        _strip(strip, said, said.thermal, recordings.BRIDGES)
        strip.set_xlabel("s")
    axes[0, 0].set_ylabel("half-bridge / degC")
    for line in axes[0, 0].legend(loc="upper left", fontsize="small").get_lines():
        line.set_linewidth(2.0)
    axes[1, 0].set_ylabel("thermal flag")
    figure.suptitle(
        "Inverter faults, learnt from the part of F0 that is not shown: F6 heats HB1, F8 heats HB3"
    )
    _legend(figure, "NoFault", "Fault")
    return figure


def _kona(plt: Any) -> Any:
    frames = recordings.kona_frames()
    begin = frames[0].t_ns
    figure, (top, strip) = plt.subplots(
        2, 1, figsize=(10, 4.6), sharex=True, layout="constrained",
        gridspec_kw={"height_ratios": [3, 1.2]},
    )  # fmt: skip
    shown = recordings.before(recordings.kona(frames, status=False), (begin + 4 * SECOND) / SECOND)
    t = [(r.t_ns - begin) / SECOND for r in shown]
    for k, name in enumerate(("inlet", "fast 1", "fast 2")):
        values = [r.celsius[k] for r in shown]
        top.plot(t, values, color=COLOURS[k], lw=1.2, marker=".", ms=3, label=name, ds="steps-post")
    down = [(f.t_ns - begin) / SECOND for f in frames if not f.data[0] & 0x08]
    top.axvspan(down[0], down[-1], color=GREY, alpha=0.25, lw=0, label="status byte 0")
    top.set_ylabel("inverter / degC")
    top.legend(loc="center right", fontsize="small")
    top.grid(alpha=0.3)
    top.set_title(
        "An electric car's inverter powers up: 0x28 (0 degC) is a default, no temperature"
    )
    runs = list(recordings.kona_runs().values())[:2]
    flags = np.column_stack([said.sensor[:, 0] for said in runs])
    _strip(strip, runs[0], flags, ["status used", "status not used"])
    strip.set_ylabel("sensor flag")
    strip.set_xlim(1.5, 4.0)
    strip.set_xlabel("time since the log's first frame / s")
    _legend(figure, "NoFault", "Fault (SensorBias, sensor None: common source)")
    return figure
