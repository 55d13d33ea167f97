"""The key that a misspelt one of a configuration or a scenario was meant to be."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any, get_args


def did_you_mean(model: Any, loc: Sequence[int | str]) -> str:
    """`; did you mean 'node'?`, or nothing where no key is near.

    model: pydantic's of the whole document; loc: where it refuses a key, that key at the end.
    """
    import difflib

    models = [model]
    for part in loc[:-1]:
        fields = [one.model_fields[part] for one in models if part in one.model_fields]
        models = [inner for f in fields for inner in _models(f.annotation)] or models
    given = str(loc[-1])
    names = {name.lower(): name for one in models for name in one.model_fields if name != given}
    near = difflib.get_close_matches(given.lower(), names, 1)
    return f"; did you mean {names[near[0]]!r}?" if near else ""


def _models(annotation: Any) -> Iterator[Any]:
    """Models in a type such as `dict[str, Motor] | None`."""
    if hasattr(annotation, "model_fields"):
        yield annotation
    for part in get_args(annotation):
        yield from _models(part)
