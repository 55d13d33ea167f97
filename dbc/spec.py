"""Messages and signals of a bound DBC as plain immutable data, without cantools."""

from __future__ import annotations

import sys
from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import IntEnum
from pathlib import Path
from typing import Final, NamedTuple

from _traction_core import lib

from dbc.frame import Nanos
from dbc.text import InputError, printable

VALID: Final[int] = lib.SIGNAL_VALID
NOT_AVAILABLE: Final[int] = lib.SIGNAL_NOT_AVAILABLE
RANGE: Final[int] = lib.SIGNAL_OUT_OF_RANGE
SATURATED: Final[int] = lib.SIGNAL_SATURATED
ABSENT: Final[int] = lib.SIGNAL_ABSENT
NOT_A_NUMBER: Final[int] = ABSENT + 1

EXTENDED_KEY: Final = 1 << 31
"""Bit set in a 29-bit id used as a key, as in a DBC: 0x123 and 0x00000123 differ."""


class Validity(IntEnum):
    """Validity of a raw value, before any scaling.

    VALID: a number in range. NOT_AVAILABLE: the sender's code for "no value". RANGE: outside the
    DBC's range. SATURATED: at the end of a signed range, so that the true value may lie beyond.
    ABSENT: not in this frame (not selected by its multiplexer, or an unused column). NOT_A_NUMBER:
    a float that is NaN or infinite, for which the core's code is RANGE.
    """

    VALID = VALID
    NOT_AVAILABLE = NOT_AVAILABLE
    RANGE = RANGE
    SATURATED = SATURATED
    ABSENT = ABSENT
    NOT_A_NUMBER = NOT_A_NUMBER


class Profile(IntEnum):
    """Protection of a message. The numbers are those of the DBC attribute `E2EProfile`."""

    NONE = lib.E2E_PROFILE_NONE
    P02 = lib.E2E_PROFILE_02
    P05 = lib.E2E_PROFILE_05


class Match(IntEnum):
    """Whether a frame may be decoded, and if not, why."""

    OK = 0
    UNKNOWN_ID = 1
    REMOTE = 2
    ERROR_FRAME = 3
    WRONG_LENGTH = 4
    WRONG_FORMAT = 5
    """A classic frame of an FD message of the DBC, or the other way round."""


class DbcMismatch(InputError):
    """A DBC that cannot be used; the text lists every problem, one a line."""

    def __init__(self, path: Path, problems: list[str]) -> None:
        """`problems`: one line each, without the path."""
        self.path = path
        self.problems = tuple(map(printable, problems))
        super().__init__("\n".join([f"{path}:", *(f"  {line}" for line in self.problems)]))


class Reading(NamedTuple):
    """One decoded signal. `value` is physical, and must be used only if it is VALID."""

    raw: int | float
    value: float
    validity: Validity


@dataclass(frozen=True, slots=True)
class SignalSpec:
    """One signal. `start` as in the DBC (big endian: position of the most significant bit).

    Ranges and codes are raw; `raw_min > raw_max` never happens. `mux_parent` names the signal
    whose raw value must lie in one of `mux_ranges` (inclusive) for this one to be present.
    """

    name: str
    start: int
    length: int
    is_signed: bool = False
    is_big_endian: bool = False
    scale: float = 1.0
    offset: float = 0.0
    unit: str = ""
    raw_min: int = 0
    raw_max: int = 0
    not_available: int | None = None
    start_raw: int = 0
    labels: Mapping[int, str] = field(default_factory=dict)
    is_float: bool = False
    float_min: float = -sys.float_info.max
    float_max: float = sys.float_info.max
    mux_parent: str | None = None
    mux_ranges: tuple[tuple[int, int], ...] = ()

    @staticmethod
    def float_limits() -> tuple[float, float]:
        """The widest finite range of a float."""
        return -sys.float_info.max, sys.float_info.max

    @property
    def saturates(self) -> bool:
        """Whether the end values mean "or beyond".

        This holds for signed measured signals with a not-available code, as those of the contract:
        if a sender clamps, the clipped number is never used as a measurement.
        """
        return self.is_signed and not self.is_float and self.not_available is not None


@dataclass(frozen=True, slots=True)
class MessageSpec:
    """One message. `signals` are in the order of their position: the protection header is first.

    `kind` and `node` split the name: `Drive3_Motion` is ("Motion", 3), `Gateway_Faults` is
    ("Faults", 0), any other name is its own kind. `data_ids`: 16 bytes for P02, the 16-bit id
    as two bytes (big endian) for P05, empty for NONE. `cycle_ns` is 0 for a message without one.
    """

    name: str
    can_id: int
    length: int
    is_fd: bool
    brs: bool
    cycle_ns: Nanos
    profile: Profile
    data_ids: bytes
    signals: tuple[SignalSpec, ...]
    index: int
    node: int
    kind: str
    is_extended: bool = False
    is_gateway: bool = False
    """Sent by the gateway itself."""
    is_either: bool = False
    """The DBC does not say whether its frames are CAN FD frames, and other messages must be."""

    @property
    def is_optional(self) -> bool:
        """Whether the gateway sends the message only if its configuration asks for it."""
        return self.is_gateway and self.kind == "Adhesion" and self.node > 0

    @property
    def key(self) -> int:
        """Key in `Codec.by_id`: the id, with bit 31 set for 29-bit ids."""
        return self.can_id | (EXTENDED_KEY if self.is_extended else 0)

    def has_format(self, fd: bool) -> bool:
        """Whether the message may come in a CAN FD frame (`fd`), or in a classic one."""
        return self.is_either or fd == self.is_fd

    def column(self, name: str) -> int:
        """Column of a signal in a decoded block. Raises KeyError."""
        for k, signal in enumerate(self.signals):
            if signal.name == name:
                return k
        raise KeyError(f"{self.name}.{name}")
