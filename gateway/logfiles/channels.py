"""Numbers of channels, for formats without channel names."""

from __future__ import annotations

from typing import Final

import numpy as np

from dbc.frames import Block
from gateway.logfiles.frames import interface

MOST: Final = 99_999
"""The largest number that is taken for one."""
_MOST_DIGITS: Final = 21
"""Candump's names have no more characters."""
_UNNAMED: Final = "can0"
"""What a frame without a channel is on in candump text."""


def channel_number(channel: str, most: int = MOST) -> int | None:
    """The digits of a channel's name; None where it has none, or more than the format has."""
    digits = "".join(filter(str.isdecimal, channel or _UNNAMED))
    number = int(digits) if digits and len(digits) <= _MOST_DIGITS else most + 1
    return number if number <= most else None


class ChannelNumbers:
    """Numbers of the channels of one log, and which of its names do not come back from them.

    A name comes back if it has a number of its own: `can1` and `vcan1` do, but not both of one log.
    """

    def __init__(self, most: int = MOST) -> None:
        """most: the largest number that the format has."""
        self._most = most
        self._names: dict[int, str] = {}
        """Of each number, the first name that had it."""

    def number(self, channel: str) -> int:
        """Of a name; 0 where it has none."""
        return channel_number(channel, self._most) or 0

    def lost(self, block: Block) -> int:
        """How many frames have a channel that does not come back."""
        counts = np.bincount(block.channel, minlength=len(block.names)).tolist()
        return sum(
            count
            for name, count in zip(block.names, counts, strict=True)
            if count and not self._comes_back(name)
        )

    def _comes_back(self, channel: str) -> bool:
        number = channel_number(channel, self._most)
        name = interface(channel) or _UNNAMED
        return number is not None and self._names.setdefault(number, name) == name
