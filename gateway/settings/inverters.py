"""`[inverter.NAME]`: signals that several drives share and that are written only once."""

from __future__ import annotations

import difflib
from collections.abc import Mapping
from typing import Any


def share(raw: Mapping[str, Any]) -> tuple[dict[str, Any], dict[int, str], list[str]]:
    """Return a configuration in which each drive has the `signals` of its `inverter`.

    The drive's `id_offset` replaces the inverter's. Returns the document, the inverters' names by
    position of the drive, and all problems.
    """
    inverters, drives = raw.get("inverter", {}), raw.get("drive")
    out = {key: value for key, value in raw.items() if key != "inverter"}
    if not isinstance(inverters, dict):
        return out, {}, ["inverter: expected a table, [inverter.NAME]"]
    if not isinstance(drives, list):
        return out, {}, ["inverter: no [[drive]] names one"] if inverters else []
    shared: list[Any] = []
    names: dict[int, str] = {}
    problems: list[str] = []
    for position, drive in enumerate(drives):
        if not isinstance(drive, dict) or not {"inverter", "id_offset"} & set(drive):
            shared.append(drive)
            continue
        where = f"drive.{position}"
        own = {k: v for k, v in drive.items() if k not in ("inverter", "id_offset")}
        shared.append(own)
        name = drive.get("inverter")
        if name is None:
            problems.append(f"{where}.id_offset: needs an `inverter`; or put it into `signals`")
        elif "signals" in own:
            problems.append(f"{where}: has an `inverter` and `signals`; remove one of them")
        elif name not in inverters or not isinstance(inverters[name], dict):
            problems.append(f"{where}.inverter: no [inverter.{name}]{_near_names(name, inverters)}")
        else:
            moved = {"id_offset": drive["id_offset"]} if "id_offset" in drive else {}
            own["signals"] = {**inverters[name], **moved}
            names[position] = str(name)
    return {**out, "drive": shared}, names, problems


def _near_names(name: Any, inverters: Mapping[str, Any]) -> str:
    near = difflib.get_close_matches(str(name), inverters, 1)
    if near:
        return f"; did you mean {near[0]!r}?"
    return f"; known: {', '.join(inverters)}" if inverters else ""
