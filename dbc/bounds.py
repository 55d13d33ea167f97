"""Bounds of a number that a person writes into a file, with unit and advice if it exceeds them."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

from pydantic import AfterValidator, BaseModel, ConfigDict

LONGEST: Final = 24
"""Most characters of a number that a message quotes."""


@dataclass(frozen=True)
class Within:
    """Range from low to high, both included, in `unit`; cure: what to do with a number outside.

    A call returns the number that it is given, or raises ValueError with one line.
    """

    low: float
    high: float
    unit: str
    cure: str

    def __call__(self, value: float) -> float:
        """Return `value`; raises ValueError if it is outside the bounds."""
        if self.low <= value <= self.high:
            return value
        msg = f"expected {self}, got {_text(value)}: {self.cure}"
        raise ValueError(msg)

    def __str__(self) -> str:
        """Return the range as in `0.01 to 100 ohm`."""
        return f"{_plain(self.low)} to {_plain(self.high)} {self.unit}".rstrip()


class Strict(BaseModel):
    """Part of a file that a person writes: unknown keys are refused, values are frozen."""

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)


def within(low: float, high: float, unit: str, cure: str) -> AfterValidator:
    """Bounds for a field of a pydantic model, as metadata of its `Annotated` type."""
    return AfterValidator(Within(low, high, unit, cure))


def _plain(value: float) -> str:
    return str(int(value)) if value == int(value) and abs(value) < 1e9 else f"{value:g}"


def _text(value: float) -> str:
    if isinstance(value, int) and value.bit_length() > 64:
        return f"a whole number of {value.bit_length()} bits"
    return str(value)[:LONGEST]
