"""How long a frame really is on the wire: every stuff bit of its own content counted.

Classic CAN: ISO 11898-1, 11-bit and 29-bit identifiers, CRC-15. CAN FD: dynamic stuff bits up to
the end of the data, then the stuff count and a CRC of 17 or 21 bits with fixed stuff bits. Bits
after the stuffed part (delimiters, acknowledge, end of frame, intermission) are counted as well.
"""

from __future__ import annotations

from typing import Final, NamedTuple

from dbc.frame import BRS, EXTENDED, FD, FD_LENGTHS, Frame

CRC15: Final = 0x4599
CLASSIC_TAIL: Final = 1 + 2 + 7 + 3
"""CRC delimiter, acknowledge and its delimiter, end of frame, intermission."""
FD_TAIL: Final = 2 + 7 + 3
"""The same after the CRC delimiter, which is still at the data rate."""


class Bits(NamedTuple):
    """Bits of one frame at the nominal and at the data bit rate."""

    nominal: int
    data: int

    def seconds(self, bitrate: int, data_bitrate: int) -> float:
        """Time on the wire; rates in bit/s."""
        return self.nominal / bitrate + self.data / data_bitrate


def bits_of(frame: Frame) -> Bits:
    """Bits of a data frame, stuff bits included. Raises ValueError for a length that is none."""
    return _fd(frame) if frame.flags & FD else Bits(_classic(frame), 0)


def _classic(frame: Frame) -> int:
    bits = [0, *_identifier(frame)]  # start of frame
    # Remote request, then (with 29 bits: two reserved ones; with 11: extension, reserved) all 0.
    bits += [0, 0, 0, *_number(len(frame.data), 4), *_payload(frame.data)]
    bits += _number(_crc15(bits), 15)
    return len(bits) + _stuffed(bits)[0] + CLASSIC_TAIL


def _fd(frame: Frame) -> Bits:
    if len(frame.data) not in FD_LENGTHS:
        raise ValueError(f"{len(frame.data)} bytes: CAN FD has no such length")
    code = sorted(FD_LENGTHS).index(len(frame.data))
    switch = int(bool(frame.flags & BRS))
    # 11 bits: RRS, IDE, FDF, res, BRS; 29 bits: RRS, FDF, res, BRS.
    extended = bool(frame.flags & EXTENDED)
    control = [0, 1, 0, switch] if extended else [0, 0, 1, 0, switch]
    head = [0, *_identifier(frame), *control]
    body = [0, *_number(code, 4), *_payload(frame.data)]  # error state, length, data
    # At the end of the data a fixed stuff bit takes the place of a dynamic one.
    stuffed, in_head = _stuffed((head + body)[:-1], len(head))
    crc = 21 if len(frame.data) > 16 else 17
    # Stuff count and parity (4), CRC, a fixed stuff bit before each four of them; CRC delimiter.
    after = 4 + crc + (4 + crc + 3) // 4 + 1
    nominal = len(head) + in_head + FD_TAIL
    data = len(body) + stuffed - in_head + after
    return Bits(nominal, data) if switch else Bits(nominal + data, 0)


def _identifier(frame: Frame) -> list[int]:
    if frame.flags & EXTENDED:
        # SRR and IDE, both recessive, between the two parts.
        return [*_number(frame.can_id >> 18, 11), 1, 1, *_number(frame.can_id & 0x3FFFF, 18)]
    return _number(frame.can_id, 11)


def _number(value: int, width: int) -> list[int]:
    return [value >> k & 1 for k in range(width - 1, -1, -1)]


def _payload(data: bytes) -> list[int]:
    return [byte >> k & 1 for byte in data for k in range(7, -1, -1)]


def _stuffed(bits: list[int], head: int = 0) -> tuple[int, int]:
    """Stuff bits of a sequence, and how many of them lie in its first `head` bits."""
    count = in_head = 0
    run, last = 0, -1
    for k, bit in enumerate(bits):
        run = run + 1 if bit == last else 1
        last = bit
        if run == 5:
            count += 1
            in_head += k < head
            run, last = 1, 1 - bit
    return count, in_head


def _crc15(bits: list[int]) -> int:
    crc = 0
    for bit in bits:
        crc = (crc << 1) ^ (CRC15 if (crc >> 14 & 1) ^ bit else 0)
        crc &= 0x7FFF
    return crc
