"""Channel numbers, for formats without channel names."""

from __future__ import annotations

from typing import Final

import numpy as np

from dbc.frames import Block
from gateway.logfiles.frames import interface

MOST: Final = 99_999
"""The largest number that counts as a channel number."""
_MOST_DIGITS: Final = 21
"""Longest name of a channel in candump text, in characters."""
UNNAMED: Final = "can0"
"""Channel in candump text of a frame without a channel."""


def channel_number(channel: str, most: int = MOST) -> int | None:
    """Number formed by the digits of a channel's name; None without digits or above `most`."""
    digits = "".join(filter(str.isdecimal, channel or UNNAMED))
    number = int(digits) if digits and len(digits) <= _MOST_DIGITS else most + 1
    return number if number <= most else None


class ChannelNumbers:
    """Numbers of the channels of one log, and which names cannot be restored from them.

    A name can be restored if its number is its own: `can1` or `vcan1`, but not both in one log.
    """

    def __init__(self, most: int = MOST) -> None:
        """most: the largest number that the format can hold."""
        self._most = most
        self._names: dict[int, str] = {}
        """Number -> the first name that had it."""

    def number(self, channel: str) -> int:
        """Number of a channel's name; 0 if it has none."""
        return channel_number(channel, self._most) or 0

    def lost(self, block: Block) -> int:
        """Number of frames whose channel name cannot be restored."""
        counts = np.bincount(block.channel, minlength=len(block.names)).tolist()
        return sum(
            count
            for name, count in zip(block.names, counts, strict=True)
            if count and not self._comes_back(name)
        )

    def _comes_back(self, channel: str) -> bool:
        number = channel_number(channel, self._most)
        name = interface(channel) or UNNAMED
        return number is not None and self._names.setdefault(number, name) == name
