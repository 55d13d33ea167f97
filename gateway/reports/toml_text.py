"""A configuration as TOML: what was in force, defaults included, to be used again."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from gateway.settings.config import Config


def dump(config: Config) -> str:
    """Every key that has a value; `load` of it is the same configuration, in the same folder."""
    table = config.model_dump(mode="json", exclude_none=True)
    return "\n".join(_table(table, ())).strip() + "\n"


def _table(table: Mapping[str, Any], path: tuple[str, ...]) -> list[str]:
    lines = [f"{_key(k)} = {_value(v)}" for k, v in table.items() if not _nested(v)]
    for name, value in table.items():
        inner = (*path, name)
        heading = ".".join(map(_key, inner))
        if isinstance(value, Mapping):
            if not value:
                continue
            body = _table(value, inner)
            # A section without a key of its own needs no heading, unless its being there says it.
            bare = bool(value) and all(isinstance(v, Mapping) for v in value.values())
            lines += body if bare else ["", f"[{heading}]", *body]
        elif _nested(value):
            for item in value:
                lines += ["", f"[[{heading}]]", *_table(item, inner)]
    return lines


def _nested(value: Any) -> bool:
    """Whether it is written as a section, or several."""
    if isinstance(value, Mapping):
        return True
    return isinstance(value, list) and bool(value) and isinstance(value[0], Mapping)


def _key(name: str) -> str:
    bare = name.isascii() and name.replace("_", "").replace("-", "").isalnum()
    return name if bare else _text(name)


def _value(value: Any) -> str:
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, str):
        return _text(value)
    if isinstance(value, Sequence):
        return f"[{', '.join(map(_value, value))}]"
    return repr(value)


def _text(text: str) -> str:
    """A basic string: quotes, backslashes and control characters escaped."""
    short = {'"': '\\"', "\\": "\\\\", "\n": "\\n", "\t": "\\t", "\r": "\\r"}
    return '"' + "".join(short.get(c) or (c if c.isprintable() else _code(c)) for c in text) + '"'


def _code(character: str) -> str:
    return f"\\U{ord(character):08x}"
