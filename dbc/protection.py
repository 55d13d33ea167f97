"""E2E protection from the attributes of a DBC: profile, data ids, and position of the header."""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from typing import TYPE_CHECKING, Any, Final

from dbc.e2e import HEADER_BYTES, p02_data_ids
from dbc.layout import bits_of
from dbc.spec import Profile, SignalSpec

if TYPE_CHECKING:
    from cantools.database import Database
    from cantools.database.can import Message

_HEADERS: Final = {
    Profile.P02: (("Crc", 0, 8), ("Counter", 8, 4)),
    Profile.P05: (("Crc", 0, 16), ("Counter", 16, 8)),
}
_PROFILES: Final = {"none": Profile.NONE, "p02": Profile.P02, "p05": Profile.P05}


def attribute(database: Database, message: Message, name: str) -> Any:
    """Value of a message attribute, of an enumeration the name; None if it is not defined."""
    specifics = database.dbc
    definition = specifics.attribute_definitions.get(name) if specifics else None
    own = message.dbc.attributes.get(name) if message.dbc and message.dbc.attributes else None
    if definition is None:
        return own.value if own is not None else None
    value = own.value if own is not None else definition.default_value
    if definition.type_name == "ENUM" and isinstance(value, int):
        choices = definition.choices or []
        return choices[value] if 0 <= value < len(choices) else f"number {value}"
    return value


def protection(database: Database, message: Message) -> tuple[Profile, bytes, list[str]]:
    """Profile (NONE without attributes), data ids and faults, from the attributes of a message."""
    text = attribute(database, message, "E2EProfile")
    if text is None:
        return Profile.NONE, b"", []
    profile = _PROFILES.get(str(text).lower())
    if profile is None:
        return Profile.NONE, b"", [f"E2EProfile {text!r}; known: None, P02, P05"]
    if profile is Profile.NONE:
        return profile, b"", []
    problems = []
    if message.length < HEADER_BYTES[profile]:
        problems.append(f"{message.length} bytes have no room for the {profile.name} header")
    own = message.dbc.attributes if message.dbc and message.dbc.attributes else {}
    data_id = own["E2EDataId"].value if "E2EDataId" in own else message.frame_id
    if profile is Profile.P05:
        if not isinstance(data_id, int) or not 0 <= data_id <= 0xFFFF:
            problems.append(f"E2EDataId {data_id} does not fit in 16 bits")
            data_id = 0
        return profile, int(data_id).to_bytes(2, "big"), problems
    listed = attribute(database, message, "E2EDataIdList") or ""
    if listed and not re.fullmatch(r"[0-9A-Fa-f]{32}", str(listed)):
        problems.append(f"E2EDataIdList {str(listed)!r} is not 32 hex digits")
        listed = ""
    return profile, bytes.fromhex(listed) if listed else p02_data_ids(int(data_id)), problems


def header_faults(name: str, profile: Profile, signals: Sequence[SignalSpec]) -> Iterator[str]:
    """Yield header signals that are not where the profile has them, and others in the header."""
    if profile is Profile.NONE:
        return
    header = {label: (start, length) for label, start, length in _HEADERS[profile]}
    size = sum(length for _, length in header.values())
    for signal in signals:
        if signal.name in header:
            if (signal.start, signal.length, signal.is_big_endian, signal.is_signed) != (
                *header[signal.name], False, False,
            ):  # fmt: skip
                start, length = header[signal.name]
                yield f"{name}.{signal.name}: {profile.name} has it at {start}|{length}@1+"
            continue
        bits = bits_of(signal, signal.is_big_endian)
        low = min(8 * (b >> 3) + 7 - (b & 7) if signal.is_big_endian else b for b in bits)
        if low < size:
            yield f"{name}.{signal.name}: lies in the {profile.name} header"
