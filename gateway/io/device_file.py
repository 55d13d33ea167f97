"""What a CANopen drive sends, by its EDS or DCF: heartbeat and PDOs.

canopen reads the file; what it refuses although nothing is wrong (empty fields of the maker's name
and number) is left out before. May know: files. May not know: buses, clocks.
"""

from __future__ import annotations

import configparser
import io
import re
import warnings
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, NamedTuple

from dbc.text import decoded, printable, read_bytes
from gateway.settings.config import ConfigError

if TYPE_CHECKING:
    from canopen import ObjectDictionary

HEARTBEAT: Final = 0x1017
TPDOS: Final = range(0x1800, 0x1A00)
MAPPING: Final = 0x200
"""From a PDO's communication to its mapping."""
MOST_MAPPED: Final = 64
"""Objects in a PDO (CiA 301)."""
_UNUSED: Final = 1 << 31
_SECTION: Final = re.compile(r"[ \t]*\[([^]]*)\]")
_NODE: Final = re.compile(r"[ \t]*NodeID[ \t]*=[ \t]*(0x[0-9a-f]+|\d+)", re.IGNORECASE)
_EMPTY: Final = re.compile(r"[ \t]*[^=\s]+\s*=\s*$")
_FAULTS: Final = (
    configparser.Error, ValueError, AttributeError, TypeError, OverflowError, LookupError,
)  # fmt: skip
"""What canopen, and configparser below it, raise for a file that is none."""


class Mapped(NamedTuple):
    """An object in a PDO: first bit, bits, its index and subindex, and its name in the file."""

    start: int
    length: int
    object_index: int
    subindex: int
    name: str


class Pdo(NamedTuple):
    """A TPDO that is in use. number: from 1; can_id: with the node's number."""

    number: int
    can_id: int
    objects: tuple[Mapped, ...]


class Device(NamedTuple):
    """What a file says. node: of a DCF, or None; heartbeat_ms: 0 is none, None: not said."""

    name: str
    node: int | None
    heartbeat_ms: int | None
    pdos: tuple[Pdo, ...]


def device_of(path: Path, node: int | None = None) -> Device:
    """Of an EDS or DCF. node: for the identifiers, where the file has none.

    Raises ConfigError for what cannot be read.
    """
    from canopen import import_od

    try:
        text = decoded(read_bytes(path))
    except OSError as error:
        raise ConfigError(str(path), [f"cannot be read: {error.strerror}"]) from None
    source = io.StringIO(_without_empty_fields(text))
    source.name = "drive.eds"
    try:
        with warnings.catch_warnings():
            # canopen 2.4 calls a method of `logging` that is going away.
            warnings.simplefilter("ignore", DeprecationWarning)
            objects = import_od(source, node_id=_node_of(text) or node or 1)
    except _FAULTS as error:
        message = printable(" ".join(str(error).split()))
        why = f"is no EDS or DCF that can be read: {type(error).__name__}: {message}"
        raise ConfigError(str(path), [why]) from None
    if not len(objects):
        raise ConfigError(str(path), ["is no EDS or DCF: there is no object in it"])
    heartbeat = _configured(objects, HEARTBEAT)
    pdos = tuple(pdo for k, index in enumerate(TPDOS, 1) if (pdo := _pdo(objects, k, index)))
    name = objects.device_information.product_name or path.stem
    return Device(printable(str(name)), _node_of(text), heartbeat, pdos)


def _without_empty_fields(text: str) -> str:
    """The file without what `[DeviceInfo]` leaves empty."""
    section, kept = "", []
    for line in text.splitlines():
        found = _SECTION.match(line)
        section = found[1].lower() if found else section
        if not (section == "deviceinfo" and _EMPTY.match(line)):
            kept.append(line)
    return "\n".join(kept)


def _node_of(text: str) -> int | None:
    """Of `[DeviceComissioning]`, which the standard spells so; also in hexadecimal."""
    section = ""
    for line in text.splitlines():
        found = _SECTION.match(line)
        section = found[1].lower() if found else section
        node = _NODE.match(line)
        if node and section in ("devicecomissioning", "devicecommissioning"):
            number = int(node[1], 0 if node[1].lower().startswith("0x") else 10)
            return number if 1 <= number <= 127 else None
    return None


def _configured(objects: ObjectDictionary, index: int, subindex: int | None = None) -> int | None:
    """What a DCF has configured, else the default."""
    entry: Any = objects.get(index)
    if entry is not None and subindex is not None:
        entry = entry.get(subindex) if hasattr(entry, "get") else None
    for name in ("value", "default"):
        if isinstance(found := getattr(entry, name, None), int):
            return found
    return None


def _pdo(objects: ObjectDictionary, number: int, index: int) -> Pdo | None:
    can_id = _configured(objects, index, 1)
    if can_id is None or can_id & _UNUSED:
        return None
    mapped, start = [], 0
    count = _configured(objects, index + MAPPING, 0) or 0
    if count > MOST_MAPPED:
        count = 0  # 254 and 255: a PDO whose objects are named in itself
    for k in range(1, count + 1):
        entry = _configured(objects, index + MAPPING, k) or 0
        at, sub, length = entry >> 16 & 0xFFFF, entry >> 8 & 0xFF, entry & 0xFF
        mapped.append(Mapped(start, length, at, sub, _name(objects, at, sub)))
        start += length
    return Pdo(number, can_id & 0x1FFF_FFFF, tuple(mapped))


def _name(objects: ObjectDictionary, index: int, subindex: int) -> str:
    entry: Any = objects.get(index)
    inner = entry.get(subindex) if hasattr(entry, "get") else None
    words = [getattr(one, "name", None) for one in (entry, inner)]
    return printable(": ".join(word for word in words if word) or "not in the file")
