"""Find the key that a misspelt key of a configuration or a scenario was meant to be."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any, get_args


def did_you_mean(model: Any, loc: Sequence[int | str]) -> str:
    """Return `; did you mean 'node'?`, or an empty text if no key is similar.

    model: pydantic model of the whole document; loc: path of the rejected key, the key last.
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
    """Yield the models in a type such as `dict[str, Motor] | None`."""
    if hasattr(annotation, "model_fields"):
        yield annotation
    for part in get_args(annotation):
        yield from _models(part)
