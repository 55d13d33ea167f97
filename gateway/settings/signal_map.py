"""`[drive.signals]`: which signals of a foreign DBC replace ours. Names and numbers only.

Signals that several drives share are written only once, as `[inverter.NAME]`.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Annotated, Any, Final, Literal

from pydantic import Field, model_validator

from dbc.text import near
from dbc.toml_files import Strict, within

Quantity = Literal[
    "Ia", "Ib", "Ic", "Ialpha", "Ibeta", "Id", "Iq", "ElectricalAngle", "Ualpha", "Ubeta", "Ud",
    "Uq", "Counter", "Speed", "Torque", "TorqueCommand", "Irms", "Tstator", "Tde", "Tnde",
    "Tambient",
]  # fmt: skip
UNITS: Final[dict[str, str]] = {
    **dict.fromkeys(("Ia", "Ib", "Ic", "Ialpha", "Ibeta", "Id", "Iq", "Irms"), "A"),
    **dict.fromkeys(("Ualpha", "Ubeta", "Ud", "Uq"), "V"),
    **dict.fromkeys(("Torque", "TorqueCommand"), "Nm"),
    **dict.fromkeys(("Tstator", "Tde", "Tnde", "Tambient"), "degC"),
    "ElectricalAngle": "deg", "Speed": "rpm", "Counter": "",
}  # fmt: skip
"""Unit of `value = scale * (the DBC's physical value) + offset`; speed is the rotor's."""


CURRENTS: Final = (("Ia", "Ib"), ("Ialpha", "Ibeta"), ("Id", "Iq"))
VOLTAGES: Final = (("Ualpha", "Ubeta"), ("Ud", "Uq"))
"""Alternative forms of one vector; a configuration maps exactly one, with all its parts."""

SENSORS: Final = {"Tstator": "stator", "Tde": "drive_end", "Tnde": "non_drive_end"}
"""Names of temperature sensors in a configuration, by signal."""
LEAST_SCALE: Final = 1e-9
Raw = Annotated[int, within(-(2**63), 2**64 - 1, "", "give the raw value, before scale and offset")]


class Source(Strict):
    """Where a quantity comes from; a plain string in TOML is its `signal`."""

    signal: str = Field(pattern=r"^\w+\.\w+$", description='"Message.Signal" of that DBC')
    scale: Annotated[float, within(-1e6, 1e6, "", "no unit conversion has such a factor")] = 1.0
    offset: Annotated[float, within(-1e6, 1e6, "", "no offset is so large")] = 0.0
    not_available: tuple[Raw, ...] = Field((), description="raw values that mean no value")
    settle_ms: Annotated[
        float, within(0, 60_000, "ms", "give the time it is unused after power-up or a silence")
    ] = 0.0
    """Time during which the signal is not used."""

    @model_validator(mode="before")
    @classmethod
    def _plain(cls, given: Any) -> Any:
        return {"signal": given} if isinstance(given, str) else given

    @model_validator(mode="after")
    def _some_scale(self) -> Source:
        if abs(self.scale) < LEAST_SCALE:
            raise ValueError(f"scale: {self.scale:g} is too small: the signal would be 0")
        return self

    @property
    def message(self) -> str:
        """Name of the message."""
        return self.signal.partition(".")[0]

    @property
    def name(self) -> str:
        """Name of the signal in it."""
        return self.signal.partition(".")[2]


class Signals(Strict):
    """`[drive.signals]`: a foreign message set, and which of our quantities its signals are."""

    dbc: str = Field(min_length=1, description="file, beside this one")
    id_offset: Annotated[int, within(-(2**29), 2**29, "", "identifiers have up to 29 bits")] = 0
    """Added to every identifier of that file."""
    cycle_ms: dict[
        str, Annotated[float, within(0.1, 3_600_000, "ms", "give the cycle time in ms")]
    ] = Field(
        default_factory=dict, description="by message, where that file has no GenMsgCycleTime"
    )
    use: dict[Quantity, Source] = Field(min_length=1, description="our names: that file's signals")

    @model_validator(mode="after")
    def _goes_together(self) -> Signals:
        problems = []
        for what, forms in (("currents", CURRENTS), ("voltages", VOLTAGES)):
            begun = [form for form in forms if any(name in self.use for name in form)]
            for form in begun:
                missing = [name for name in form if name not in self.use]
                if missing and missing != ["Id"]:  # Iq alone is a torque
                    problems.append(f"{what} as {', '.join(form)}: {', '.join(missing)} missing")
            if len(begun) > 1:
                problems.append(f"{what} in {len(begun)} forms; map only one form")
        if "Ud" in self.use and "ElectricalAngle" not in self.use:
            problems.append("Ud, Uq need ElectricalAngle: map it, too")
        if "Ic" in self.use and "Ia" not in self.use:
            problems.append("currents as Ia, Ib: Ia, Ib missing")
        if problems:
            raise ValueError("\n".join(problems))
        return self

    @property
    def phases(self) -> tuple[str, ...]:
        """Quantities from which phase currents are computed; empty where they cannot be."""
        form = next((form for form in CURRENTS if form[0] in self.use), ())
        if form == CURRENTS[2]:
            return (*form, "ElectricalAngle") if "ElectricalAngle" in self.use else ()
        return (*form, "Ic") if "Ic" in self.use else form

    @property
    def voltages(self) -> tuple[str, ...]:
        """Quantities from which the stator voltages are computed; empty without any."""
        form = next((form for form in VOLTAGES if form[0] in self.use), ())
        return (*form, "ElectricalAngle") if form == VOLTAGES[1] else form


def share(raw: Mapping[str, Any]) -> tuple[dict[str, Any], dict[int, str], list[str]]:
    """Return a configuration in which each drive has the `signals` of its `[inverter.NAME]`.

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
    return near(name, inverters) or (f"; known: {', '.join(inverters)}" if inverters else "")
