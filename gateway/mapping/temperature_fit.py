"""Check whether recorded temperatures can be those of a motor and of the air around it."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Final

import numpy as np

from dbc.arrays import Array
from gateway.mapping.fit import Finding

_AIR: Final = (-50.0, 60.0)
"""degC, of railway surroundings (EN 50125-1: -40 to 45), with some heat from the equipment."""
_MOTOR: Final = (-50.0, 220.0)
"""degC. A winding of a high insulation class (200) is not used above this."""
_MISTAKES: Final = (
    ("K instead of degC (offset = -273.15)", 1.0, -273.15),
    ("degF instead of degC (scale = 0.5556, offset = -17.78)", 1 / 1.8, -32 / 1.8),
)
_COLDER_K: Final = 30.0
"""A motor is colder than the air only where it has come from outside."""


def findings(columns: Mapping[str, Array]) -> list[Finding]:
    """Findings on a drive's temperatures: those without a value; whether the others are possible.

    columns: recorded values by signal, degC, NaN where there is no value.
    """
    known = {
        name: float(np.nanmedian(values))
        for name, values in columns.items()
        if np.isfinite(values).any()
    }
    missing = [name for name, values in columns.items() if len(values) and name not in known]
    out = [Finding(None, f"{', '.join(missing)}: no value in the log")] if missing else []
    if not known:
        return out
    values = "temperatures: " + ", ".join(f"{name} {x:.0f}" for name, x in known.items()) + " degC"
    air = known.get("Tambient", -math.inf)
    if not _possible(known):
        causes = [
            text for text, a, b in _MISTAKES if _possible({n: a * x + b for n, x in known.items()})
        ]
        causes = causes or ["a wrong unit, scale or offset"]
        bad = [name for name, x in known.items() if not _possible({name: x})]
        # A sensor without a cable shows the end of its converter's range, beside sensible values.
        causes += [f"no sensor is connected for {', '.join(bad)}"] if len(bad) < len(known) else []
        out.append(Finding(False, f"{values}, which is impossible: {' or '.join(causes)}"))
    elif min(known.values()) < air - _COLDER_K:
        text = f"{values}; colder than the air by more than {_COLDER_K:g} K: a wrong unit, or"
        out.append(Finding(None, f"{text} the train has come in from the cold"))
    else:
        out.append(Finding(True, f"{values}, which is possible"))
    return out


def _possible(known: Mapping[str, float]) -> bool:
    ranges = {name: _AIR if name == "Tambient" else _MOTOR for name in known}
    return all(low <= known[name] <= high for name, (low, high) in ranges.items())
