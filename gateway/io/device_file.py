"""What a CANopen drive sends according to its EDS or DCF: heartbeat and PDOs.

A file is read as far as possible, and its faulty parts are listed. May know: files. May not know:
buses, clocks.
"""

from __future__ import annotations

from pathlib import Path
from typing import Final, NamedTuple

from dbc.text import printable, read_bytes
from gateway.io.eds_text import EdsText, Value, number_of, text_of
from gateway.settings.config import ConfigError

HEARTBEAT: Final = 0x1017
TPDOS: Final = range(0x1800, 0x1A00)
MAPPING: Final = 0x200
"""Offset from the index of a PDO's communication parameters to that of its mapping."""
MOST_MAPPED: Final = 64
"""Most objects in a PDO (CiA 301)."""
LONGEST_MS: Final = 0xFFFF
_UNUSED: Final = 1 << 31
_LISTS: Final = ("MandatoryObjects", "OptionalObjects", "ManufacturerObjects")


class Mapped(NamedTuple):
    """An object in a PDO: first bit, number of bits, index, subindex, and its name in the file."""

    start: int
    length: int
    object_index: int
    subindex: int
    name: str


class Pdo(NamedTuple):
    """A TPDO that is in use. number: from 1; can_id: the node id is included."""

    number: int
    can_id: int
    objects: tuple[Mapped, ...]


class Device(NamedTuple):
    """Contents of an EDS or DCF.

    node: node id of a DCF, or None; heartbeat_ms: period, 0: no heartbeat, None: not known;
    heartbeat_fault: why the period cannot be read; faults: parts of the file left out, and why.
    """

    name: str
    node: int | None
    heartbeat_ms: int | None
    pdos: tuple[Pdo, ...]
    heartbeat_fault: str = ""
    faults: tuple[str, ...] = ()


def device_of(path: Path) -> Device:
    """Read an EDS or DCF, plain or gzip; if it has no node id, identifiers are for node 1.

    Raises ConfigError if the file cannot be read or holds no object.
    """
    try:
        text, cut = text_of(read_bytes(path))
    except OSError as error:
        raise ConfigError(str(path), [f"cannot be read: {error.strerror}"]) from None
    except ValueError as error:
        raise ConfigError(str(path), [str(error)]) from None
    eds = EdsText(text)
    if not eds.objects:
        raise ConfigError(str(path), ["is not an EDS or DCF: there is no object in it"])
    own, faults = _node_of(eds)
    faults = [*cut, *eds.faults, *faults, *_missing(eds)]
    heartbeat, heartbeat_fault = _heartbeat(eds)
    pdos = []
    for number, index in enumerate(TPDOS, 1):
        if index in eds.objects:
            pdo, problems = _pdo(eds, number, index, own or 1)
            pdos += [pdo] if pdo else []
            faults += problems
    product = eds.get("DeviceInfo", "ProductName")
    name = product.text if product and product.text else path.stem
    return Device(
        printable(name), own, heartbeat, tuple(pdos), printable(heartbeat_fault),
        tuple(map(printable, faults)),
    )  # fmt: skip


def _node_of(eds: EdsText) -> tuple[int | None, list[str]]:
    """Node id of `[DeviceComissioning]` (the standard's spelling), also hexadecimal; and faults."""
    found = eds.get("DeviceComissioning", "NodeID") or eds.get("DeviceCommissioning", "NodeID")
    if found is None or not found.text:
        return None, []
    number = number_of(found.text, 0)
    if number is not None and 1 <= number <= 127:
        return number, []
    return None, [f"{_quoted(found)} is not a node number, 1 to 127"]


def _missing(eds: EdsText) -> list[str]:
    """Objects that the lists name but the file lacks: it was truncated, or they are damaged."""
    named = [value for name in _LISTS for key, value in eds.sections.get(name.lower(), {}).items()
             if key.isdecimal()]  # fmt: skip
    indexes = [number_of(value.text, 0) for value in named]
    there = set(eds.objects)
    lost = [f"{index:04X}h" for index in indexes if index is not None and index not in there]
    if not lost:
        return []
    more = f" and {len(lost) - 10} more" if len(lost) > 10 else ""
    return [f"listed, but not in the file: {', '.join(lost[:10])}{more}"]


def _heartbeat(eds: EdsText) -> tuple[int | None, str]:
    """Heartbeat period in ms, or None; and what is wrong with its value."""
    found = eds.configured(HEARTBEAT)
    if found is None:
        fault = "has no value" if HEARTBEAT in eds.objects else ""
        return None, fault
    number = number_of(found.text, 0)
    if number is not None and 0 <= number <= LONGEST_MS:
        return number, ""
    return None, f"is {found.text!r}" if found.text else "is empty"


def _pdo(eds: EdsText, number: int, index: int, node: int) -> tuple[Pdo | None, list[str]]:
    """A TPDO, or None if it is not in use or its identifier cannot be read; and its faults."""
    found = eds.configured(index, 1)
    if found is None:
        return None, [f"TPDO{number} is left out: [{index:04X}sub1] has no value"]
    can_id = number_of(found.text, node)
    if can_id is None or not 0 <= can_id < 1 << 32:
        return None, [f"TPDO{number} is left out: {_quoted(found)} is not an identifier"]
    if can_id & _UNUSED:
        return None, []
    objects, faults = _mapped(eds, index + MAPPING, node)
    return Pdo(number, can_id & 0x1FFF_FFFF, objects), faults


def _mapped(eds: EdsText, index: int, node: int) -> tuple[tuple[Mapped, ...], list[str]]:
    """The objects of a PDO before the first unreadable one, behind which positions are unknown."""
    first = eds.configured(index, 0)
    count = number_of(first.text, node) if first else 0
    if first and count is None:
        return (), [f"{_quoted(first)} is not a number of objects"]
    if not count or not 0 <= count <= MOST_MAPPED:
        return (), []  # 254, 255: multiplexed PDOs, which name their object in the data
    out: list[Mapped] = []
    start = 0
    for k in range(1, count + 1):
        found = eds.configured(index, k)
        entry = number_of(found.text, node) if found else None
        if entry is None or not 0 <= entry < 1 << 32:
            what = f"[{index:04X}sub{k:X}] has no value"
            what = f"{_quoted(found)} is not a mapped object" if found else what
            return tuple(out), [f"{what}; mapped objects from it on are left out"]
        at, sub, length = entry >> 16, entry >> 8 & 0xFF, entry & 0xFF
        name = printable(eds.name_of(at, sub) or "not in the file")
        out.append(Mapped(start, length, at, sub, name))
        start += length
    return tuple(out), []


def _quoted(value: Value) -> str:
    return f"{value.where} = {value.text!r}"
