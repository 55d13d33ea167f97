"""Bounds of a number that a person writes into a file, with its unit and what to do beyond them."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

from pydantic import AfterValidator

LONGEST: Final = 24
"""Characters of a number that are quoted."""


@dataclass(frozen=True)
class Within:
    """low to high, both allowed, in `unit`; cure: what to do with a number outside.

    Called with a number it gives it back, or raises ValueError with one line.
    """

    low: float
    high: float
    unit: str
    cure: str

    def __call__(self, value: float) -> float:
        """Raises ValueError outside of the bounds."""
        if self.low <= value <= self.high:
            return value
        msg = f"expected {self}, got {_text(value)}: {self.cure}"
        raise ValueError(msg)

    def __str__(self) -> str:
        """`0.01 to 100 ohm`."""
        return f"{_plain(self.low)} to {_plain(self.high)} {self.unit}".rstrip()


def within(low: float, high: float, unit: str, cure: str) -> AfterValidator:
    """Those bounds for a field of a pydantic model: the metadata of its `Annotated` type."""
    return AfterValidator(Within(low, high, unit, cure))


def _plain(value: float) -> str:
    return str(int(value)) if value == int(value) and abs(value) < 1e9 else f"{value:g}"


def _text(value: float) -> str:
    if isinstance(value, int) and value.bit_length() > 64:
        return f"a whole number of {value.bit_length()} bits"
    return str(value)[:LONGEST]
