"""Thresholds of `[adhesion]` from the results of a healthy fleet.

Measured are the settings for the loss probability and for the spread of healthy loads. NIS, MAISD
and a load's share have no threshold in the configuration (`calibrate` measures MAISD limits, from
all three sensors), and `[thermal] limit_k` is what an owner allows, not what is usual: so they are
left out.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any, Final, NamedTuple

import numpy as np
import pyarrow.parquet as pq
from numpy.typing import NDArray

from gateway.core.adhesion import BASE_NM
from gateway.fleet.log_result import EVERY_NS, PEAK
from gateway.fleet.table import DONE, TABLE, metadata_of
from gateway.settings.config import Config, ConfigError
from gateway.settings.sections import Adhesion

QUANTILE: Final = 0.999
BINS: Final = 10_000
"""Bins of a probability's histogram: little memory for any number of rows, right to four digits."""
HIGHEST: Final = 0.999
"""Highest threshold, whatever was measured: above it hardly any loss would be found."""
STEP_CLIP: Final = 4.0
"""A step counts as at most this many standard deviations: passing a curve is no wide spread."""
SHOWN: Final = 5

Array = NDArray[Any]


class Seen(NamedTuple):
    """Loss probability of healthy drives: quantile of samples, largest at any tick, hours known."""

    quantile: float
    largest: float
    hours: float


class Measured(NamedTuple):
    """Result for all logs, by node and together. spread_nm: as in `[adhesion]`; None: not known."""

    drives: dict[int, Seen]
    fleet: Seen
    spread_nm: float | None
    logs: int
    bad: int
    adhesion: Adhesion
    settings: str


def _seen(bins: Array, largest: float) -> Seen:
    """Summary of a histogram (BINS,), with the upper edge of its bin as the quantile."""
    total = int(bins.sum())
    place = int(np.searchsorted(np.cumsum(bins), QUANTILE * total))
    quantile = min((place + 1) / BINS, 1.0) if total else 0.0
    return Seen(quantile, largest, total * EVERY_NS / 3.6e12)


def measure(folder: Path, *, force: bool) -> Measured:
    """Read a fleet's results. Raises ConfigError if there are none, or the fleet is not healthy.

    force: accept results in which flags were raised, on the assertion that these were false.
    """
    table = folder / TABLE
    metadata = metadata_of(table)
    if "config" not in metadata:
        raise ConfigError(str(table), ["no results of a fleet; make them with 'fleet'"])
    config = Config.model_validate_json(metadata["config"])
    with table.open("rb") as file:
        rows = pq.read_table(file).to_pylist()
    done = [row for row in rows if row["status"] == DONE]
    problems = [
        f"{row['path']}: {row['adhesion_losses']} adhesion losses, "
        f"{row['thermal_faults']} thermal faults"
        for row in done
        if row["adhesion_losses"] or row["thermal_faults"]
    ]
    if problems and not force:
        more = [f"and {len(problems) - SHOWN} logs more"] if len(problems) > SHOWN else []
        cure = "take other logs, or --force if these are false"
        raise ConfigError("the fleet is not healthy", [*problems[:SHOWN], *more, cure])
    drives = len(config.nodes)
    bins, largest = np.zeros((drives, BINS), dtype=np.int64), np.zeros(drives)
    steps = np.zeros(2)
    rated = np.array([config.motors[drive.motor].T_rated for drive in config.drive])
    for samples in _logs(folder, done):
        for k, node in enumerate(config.nodes):
            mine = samples["drive"] == node
            known, peaks = samples["loss_probability"][mine], samples[PEAK][mine]
            bins[k] += np.histogram(known[~np.isnan(known)], BINS, (0.0, 1.0))[0]
            largest[k] = np.max(peaks, initial=largest[k], where=~np.isnan(peaks))
        steps += _steps(samples, config.nodes, rated)
    if not bins.any():
        raise ConfigError(str(table), ["no drive's loss probability was known in any log"])
    spread = BASE_NM * math.sqrt(steps[0] / steps[1]) if steps[1] else None
    seen = map(_seen, bins, largest.tolist())
    return Measured(
        dict(zip(config.nodes, seen, strict=True)), _seen(bins.sum(axis=0), float(largest.max())),
        spread, len(done), len(rows) - len(done), config.adhesion, metadata.get("settings", ""),
    )  # fmt: skip


def _logs(folder: Path, rows: Sequence[dict[str, Any]]) -> Iterator[dict[str, Array]]:
    """The columns needed, of every log; null becomes NaN. Raises ConfigError for a missing file."""
    names = ["t_ns", "drive", "load_nm", "loss_probability", PEAK]
    for row in rows:
        path = folder / row["file"]
        if not path.is_file():
            raise ConfigError(str(path), ["missing; run 'fleet' again"])
        with path.open("rb") as file:
            table = pq.read_table(file, columns=names)
        yield {name: table[name].to_numpy() for name in names}


def _steps(samples: dict[str, Array], nodes: Sequence[int], rated: Array) -> tuple[float, float]:
    """(sum of squares, number), whose quotient is the squared spread per unit of rated torque.

    As the detector learns it: in the drives' loads around their mean, a change from one sample to
    the next is noise, with twice its variance; what stays is a lasting difference. rated: (N,).
    """
    stamps = np.unique(samples["t_ns"])
    load = np.full((stamps.size, len(nodes)), np.nan)
    for k, node in enumerate(nodes):
        mine = samples["drive"] == node
        load[np.searchsorted(stamps, samples["t_ns"][mine]), k] = samples["load_nm"][mine]
    load /= rated
    # Ticks in which not every drive has a row are not used.
    whole = ~np.isnan(load).any(axis=1)
    load, stamps = load[whole], stamps[whole]
    beside = load - load.mean(axis=1, keepdims=True)
    step = np.diff(beside, axis=0)[np.diff(stamps) == EVERY_NS]
    if len(nodes) < 2 or not step.size:
        return 0.0, 0.0
    most = STEP_CLIP * float(np.median(np.abs(step))) / 0.6745
    step = np.clip(step, -most, most)
    return 0.5 * float(np.sum(step * step)), float(step.shape[0] * (len(nodes) - 1))


def to_toml(measured: Measured) -> str:
    """A fragment for the configuration, with its basis in comments.

    No value becomes more sensitive than the one in use: healthy logs can show that a threshold or
    the spread is too low, never that it is too high.
    """
    seen, used = measured.fleet, measured.adhesion
    raised = max(used.raise_probability, min(_up((1.0 + seen.largest) / 2.0), HIGHEST))
    if seen.largest < used.raise_probability:
        raised = used.raise_probability
    cleared = min(max(used.clear_probability, _up(seen.quantile)), raised)
    lines = [
        f"# From {measured.logs} logs of a healthy fleet (settings {measured.settings}).",
        f"# Loss probability: {100 * QUANTILE:g} % quantile, largest at any tick, hours known:",
        *(_line(f"drive {node}", drive) for node, drive in measured.drives.items()),
        _line("all", seen),
        "",
        "[adhesion]",
        "# The value in use; if the largest probability reached it: half-way from there to 1.",
        f"raise_probability = {raised:g}",
        "# The value in use, or the quantile if that is higher.",
        f"clear_probability = {cleared:g}",
    ]
    if measured.spread_nm is not None:
        lines += [
            f"# The value in use, or the measured {measured.spread_nm:.3f} Nm if that is higher.",
            f"spread_nm = {max(used.spread_nm, _up(measured.spread_nm)):g}",
        ]
    return "\n".join(lines) + "\n"


def _line(who: str, seen: Seen) -> str:
    return f"#   {who}: {seen.quantile:.4f}, {seen.largest:.4f}, {seen.hours:.3f} h"


def _up(value: float) -> float:
    return math.ceil(1000.0 * value) / 1000.0
