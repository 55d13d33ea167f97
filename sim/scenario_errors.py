"""The problems of a scenario file, one line each: the path of a key, and what is wrong there."""

from __future__ import annotations

import re
from collections.abc import Iterator
from typing import Any, Final

from pydantic import BaseModel, ValidationError

from dbc.toml_files import did_you_mean
from dbc.value_errors import joined

_BRANCHES: Final = frozenset({
    "int", "float", "str", "constrained-float", "list[constrained-float]",
    "literal['all']", "literal['all','others']", "literal['equilibrium','ambient']",
})  # fmt: skip
_CHECKED: Final = ("function-after[", "list[function-after[")
"""Names that pydantic adds to a location inside a union; they are no keys of the file."""
_KEY: Final = re.compile(r"[a-z]\w*(\[\d+\])?(\.\w+)*: ", re.IGNORECASE)
"""Begin of a message of a table's own check about one of its keys."""


def problems_of(error: ValidationError, model: type[BaseModel]) -> list[str]:
    """One line per problem: `event[2].kind: ..`. model: of the whole file."""
    found: dict[str, list[Any]] = {}
    for item in error.errors():
        if item["type"] == "default_factory_not_called":
            continue  # a key on which the default depends is wrong, and is reported
        found.setdefault(_path(item["loc"]), []).append(item)
    return [line for path, items in found.items() for line in _described(path, items, model)]


def _path(location: tuple[int | str, ...]) -> str:
    path = ""
    for part in location:
        if isinstance(part, int):
            path += f"[{part}]"
        elif part not in _BRANCHES and not part.startswith(_CHECKED):
            path += f".{part}" if path else part
    return path


def _described(path: str, items: list[Any], model: type[BaseModel]) -> Iterator[str]:
    if items[0]["type"] == "extra_forbidden":
        yield f"{path}: unknown key{did_you_mean(model, items[0]['loc'])}"
        return
    for text in joined(items).split("\n"):
        # A table's own message begins with a key, or is about the table as a whole.
        yield f"{path}{'.' if _KEY.match(text) else ': '}{text}" if path else text
