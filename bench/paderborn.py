"""`python -m bench.paderborn measures_v2.csv`: our thermal model on recordings of a test bench.

The recordings are Paderborn University's ("Electric Motor Temperature", Kaggle, CC BY-SA 4.0): a
water-cooled motor of 52 kW, 2 readings a second, 69 profiles, 185 hours. They are not here; this is
run where they are. Split and start are the literature's: profiles 60, 62 and 74 are judged, all
others learnt from; a profile begins at the measured temperatures, and no later one is looked at.

The model is the product's, with the coolant in place of the air: winding and core are
`stator_winding` and `stator_tooth`, its two ends `stator_yoke` and `pm` (the magnets). What it
learns from are winding and ends; `stator_tooth` is never shown to it.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Final, NamedTuple

import numpy as np

from dbc.arrays import Array
from estimators.thermal.model import CORE, MEASURED, OFFSETS, inputs_of, simulate
from estimators.thermal.record import Record
from estimators.thermal.system_identification import first_readings, identify, scaled

JUDGED: Final = (60, 62, 74)
"""Profiles that the literature holds back."""
LEARNT: Final = ("stator_winding", "stator_yoke", "pm")
"""Columns that stand for winding, drive end and non-drive end."""
HIDDEN: Final = "stator_tooth"
STEP_S: Final = 0.5
PUBLISHED: Final = "thermal neural network, 64 parameters (doi 10.1016/j.engappai.2022.105537): " \
    "mean squared error 3.18 K^2, largest error 5.84 K"  # fmt: skip


class Profile(NamedTuple):
    """One measurement: what drives the model, and the reading that is hidden from it (K,) degC."""

    number: int
    record: Record
    tooth: Array


def profiles(path: Path) -> Iterator[Profile]:
    """All profiles of a file, in its order.

    Raises OSError, and KeyError for a column that is missing.
    """
    from pyarrow import csv

    table = csv.read_csv(path)
    number = table["profile_id"].to_numpy()
    wanted = ("i_d", "i_q", "motor_speed", "coolant", HIDDEN, *LEARNT)
    column = {name: table[name].to_numpy().astype(np.float64) for name in wanted}
    for one in dict.fromkeys(number.tolist()):
        rows = number == one
        i_d, i_q, rpm, coolant, tooth, *readings = (column[name][rows] for name in wanted)
        record = Record(
            np.stack(readings, axis=1)[:, None, :], np.arange(len(rpm)),
            (i_d**2 + i_q**2)[:, None], rpm * np.pi / 30.0, coolant, STEP_S,
        )  # fmt: skip
        yield Profile(int(one), record, tooth)


def errors(parameters: Array, profile: Profile) -> dict[str, Array]:
    """(K,) K that the model is too warm, by column; it knows the first readings and its inputs."""
    record = profile.record
    start = first_readings(record)
    lumps = simulate(parameters, inputs_of(record), start)[:, 0]
    seen = lumps[:, list(MEASURED)] + parameters[0, OFFSETS]
    by_column = dict(zip(LEARNT, (seen - record.temperature[:, 0]).T, strict=True))
    return {**by_column, HIDDEN: lumps[:, CORE] - profile.tooth}


def report(parameters: Array, judged: Sequence[Profile]) -> Iterator[str]:
    """Lines: mean squared and largest error by column, and of all."""
    found = [errors(parameters, profile) for profile in judged]
    for name in (*LEARNT, HIDDEN):
        yield f"{name}: {_figures(np.concatenate([one[name] for one in found]))}"
    whole = np.concatenate([off for one in found for off in one.values()])
    yield f"all four, {len(parameters[0])} parameters: {_figures(whole)}"


def _figures(off: Array) -> str:
    return f"mean squared error {np.mean(off**2):.2f} K^2, largest {np.abs(off).max():.2f} K"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("file", type=Path, help="measures_v2.csv")
    options = parser.parse_args()
    learnt, judged = [], []
    for profile in profiles(options.file):
        (judged if profile.number in JUDGED else learnt).append(profile)
    if not learnt or not judged:
        parser.error(f"{options.file}: needs the profiles {JUDGED} and others")
    runs = [profile.record for profile in learnt]
    hours = sum(len(run.at) for run in runs) * STEP_S / 3600.0
    print(f"learning from {len(runs)} profiles, {hours:.1f} h", flush=True)
    parameters = identify(runs, scaled(runs))
    for line in report(parameters, judged):
        print(line)
    print(PUBLISHED)


if __name__ == "__main__":
    main()
