"""What is wrong with a value in a file that a person wrote: what was expected, and what is there.

pydantic's own messages leave out the value and its unit, and may contain the name of a class.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from typing import Any, Final

from dbc.text import near
from dbc.toml_files import LONGEST

UNITS: Final = {
    "s": "seconds", "ms": "milliseconds", "us": "microseconds", "nm": "Nm", "a": "A", "v": "V",
    "k": "K", "c": "degC", "rad": "rad", "hz": "Hz", "w": "W", "kw": "kW", "m": "m", "mm": "mm",
    "kg": "kg", "h": "hours",
}  # fmt: skip
"""Unit of a key, by what follows the last `_` of its name."""
_WHOLE: Final = frozenset({"int_parsing", "int_type", "int_from_float"})
_NUMBER: Final = frozenset({"float_parsing", "float_type"})
_TABLE: Final = frozenset({"model_type", "model_attributes_type", "dict_type"})
_LIST: Final = frozenset({"list_type", "tuple_type"})
_LIMITS: Final = {
    "greater_than_equal": ("at least", "ge"), "greater_than": ("more than", "gt"),
    "less_than_equal": ("at most", "le"), "less_than": ("less than", "lt"),
}  # fmt: skip


def wording(item: Mapping[str, Any]) -> str:
    """Message for one of `ValidationError.errors()`: `expected .., got ..`."""
    if item["type"] == "missing":
        return "expected, but missing"
    expected = _expected(item)
    if expected is None:
        return str(item["msg"]).removeprefix("Value error, ")
    return f"expected {expected}, got {quoted(item['input'])}{_cure(item)}"


def joined(items: Sequence[Mapping[str, Any]]) -> str:
    """Message for all errors of one value, which may have one of several types."""
    expected = [_expected(item) for item in items]
    if len(items) == 1 or None in expected:
        return " or ".join(dict.fromkeys(map(wording, items)))
    text = ", or ".join(dict.fromkeys(str(part) for part in expected))
    cure = next(filter(None, map(_cure, items)), "")
    return f"expected {text}, got {quoted(items[0]['input'])}{cure}"


def quoted(value: Any) -> str:
    """The value as in the file, its end left out if it is long."""
    if isinstance(value, dict):
        return "a table"
    if isinstance(value, list | tuple):
        return "a list"
    text = str(value).lower() if isinstance(value, bool) else repr(value)
    return text if len(text) <= 2 * LONGEST else f"{text[: 2 * LONGEST]}.."


def _expected(item: Mapping[str, Any]) -> str | None:
    kind, context = item["type"], item.get("ctx", {})
    if kind in _WHOLE:
        return "a whole number"
    if kind in _NUMBER:
        return f"a number{_unit(item)}"
    if kind in _TABLE:
        return "a table"
    if kind in _LIST:
        return "a list"
    if kind in _LIMITS:
        words, key = _LIMITS[kind]
        return f"{words} {context[key]}"
    return {
        "literal_error": str(context.get("expected")),
        "bool_parsing": "true or false",
        "bool_type": "true or false",
        "string_type": "text in quotes",
        "finite_number": "a finite number",
        "string_pattern_mismatch": "'MESSAGE.SIGNAL'",
        "string_too_short": "a text that is not empty",
        "too_short": f"{context.get('min_length')} or more entries",
        "too_long": f"no more than {context.get('max_length')} entries",
    }.get(kind)


def _unit(item: Mapping[str, Any]) -> str:
    """The unit in the key's name, as in ` of seconds` for `at_s`; `L_s` is a symbol."""
    key = next((str(part) for part in reversed(item["loc"]) if _is_key(part)), "")
    unit = UNITS.get(key.rpartition("_")[2].lower()) if "_" in key and key.islower() else None
    return f" of {unit}" if unit else ""


def _is_key(part: int | str) -> bool:
    """Whether a part of a location is a key, and no branch of a union that pydantic adds."""
    return isinstance(part, str) and part.isidentifier() and part not in ("int", "float", "str")


def _cure(item: Mapping[str, Any]) -> str:
    """What to write instead, if the expected values do not show it."""
    if item["type"] == "literal_error":
        return near(item["input"], re.findall(r"'([^']*)'", _expected(item) or ""))
    path = ".".join(str(part) for part in item["loc"] if isinstance(part, str))
    if item["type"] in _TABLE and not isinstance(item["input"], list):
        return f": write [{path}], and its keys below"
    if item["type"] in _LIST:
        if isinstance(item["input"], dict):
            return f": write [[{path}]]"
        return ": write it in [ ]" + ("" if isinstance(item["input"], str) else f", or [[{path}]]")
    text = item["input"]
    if (
        item["type"] in _WHOLE | _NUMBER
        and isinstance(text, str)
        and text.lstrip("+-. ")[:1].isdigit()
    ):
        return ": write it without quotes and unit"
    return ""
