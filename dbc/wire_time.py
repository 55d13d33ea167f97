"""Length of frames on the wire in bits, with the stuff bits that their content needs.

Classic CAN: ISO 11898-1, 11-bit and 29-bit identifiers, CRC-15. CAN FD: dynamic stuff bits up to
the end of the data, then the stuff count and a CRC of 17 or 21 bits with fixed stuff bits. Bits
after the stuffed part (delimiters, acknowledge, end of frame, intermission) are counted as well.
`longest_seconds` does not look at the content.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Sequence
from typing import Final

import numpy as np
from numpy.typing import NDArray

from dbc.frame import BRS, EXTENDED, FD, FD_LENGTHS, Frame

CRC15: Final = 0x4599
CLASSIC_TAIL: Final = 1 + 2 + 7 + 3
"""CRC delimiter, acknowledge and its delimiter, end of frame, intermission."""
FD_TAIL: Final = 2 + 7 + 3
"""The same without the CRC delimiter, which is still at the data rate."""

Bits = NDArray[np.uint8]
"""(B, n): a row for each bit on the wire, a column for each frame."""
Counts = NDArray[np.int64]


def bits_of(frames: Sequence[Frame]) -> tuple[Counts, Counts]:
    """Bits of n data frames, each (n,), at the nominal and the data bit rate, stuff bits included.

    Raises ValueError for a length that CAN FD does not have.
    """
    nominal, data = np.zeros((2, len(frames)), np.int64)
    alike = defaultdict(list)
    for k, frame in enumerate(frames):
        alike[len(frame.data), frame.flags & (FD | BRS | EXTENDED)].append(k)
    for (length, flags), places in alike.items():
        some = [frames[k] for k in places]
        head = _start(some, extended=bool(flags & EXTENDED))
        payload = np.frombuffer(b"".join(f.data for f in some), np.uint8).reshape(len(some), length)
        body = np.unpackbits(payload, axis=1).T
        if flags & FD:
            nominal[places], data[places] = _fd(head, body, length, flags)
        else:
            nominal[places] = _classic(head, body, length)
    return nominal, data


def longest_seconds(length: int, bitrate: float, data_bitrate: float | None = None) -> float:
    """Longest time, s, for which a frame with an 11-bit identifier occupies the bus.

    data_bitrate: of a CAN FD frame, with the bits of the data part and their worst stuffing;
    None: classic CAN. Rates in bit/s.
    """
    if data_bitrate is None:
        return (47 + 8 * length + (33 + 8 * length) // 4) / bitrate
    crc = 21 + 6 if length > 16 else 17 + 5
    bits = 8 * length + 9
    return 34 / bitrate + (bits + crc + bits // 4) / data_bitrate


def _classic(head: Bits, body: Bits, length: int) -> Counts:
    # RTR, then two reserved bits (29-bit identifier) or IDE and a reserved bit (11-bit): all 0.
    bits = np.vstack([head, _same(f"000{length:04b}", head), body])
    bits = np.vstack([bits, _columns(_crc15(bits), 15)])
    return len(bits) + _stuffed(bits)[0] + CLASSIC_TAIL


def _fd(head: Bits, body: Bits, length: int, flags: int) -> tuple[Counts, Counts]:
    if length not in FD_LENGTHS:
        raise ValueError(f"{length} bytes: CAN FD has no such length")
    switch = int(bool(flags & BRS))
    # 11 bits: RRS, IDE, FDF, res, BRS; 29 bits: RRS, FDF, res, BRS.
    control = f"010{switch}" if flags & EXTENDED else f"0010{switch}"
    head = np.vstack([head, _same(control, head)])
    # ESI, length code, data.
    body = np.vstack([_same(f"0{sorted(FD_LENGTHS).index(length):04b}", head), body])
    # At the end of the data a fixed stuff bit takes the place of a dynamic one.
    stuffed, in_head = _stuffed(np.vstack([head, body])[:-1], len(head))
    crc = 21 if length > 16 else 17
    # Stuff count and parity (4), CRC, a fixed stuff bit before each four of them; CRC delimiter.
    after = 4 + crc + (4 + crc + 3) // 4 + 1
    nominal = len(head) + in_head + FD_TAIL
    data = len(body) + stuffed - in_head + after
    return (nominal, data) if switch else (nominal + data, np.zeros_like(data))


def _start(frames: Sequence[Frame], *, extended: bool) -> Bits:
    """Start of frame and identifier."""
    number = np.array([frame.can_id for frame in frames])
    if not extended:
        return _columns(number, 12)  # its first bit is the start of frame: 0
    # SRR and IDE, both recessive, between the two parts.
    return _columns((number >> 18) << 20 | 0b11 << 18 | number & 0x3FFFF, 32)


def _columns(values: Counts, width: int) -> Bits:
    """(width, n): the bits of n numbers, most significant first."""
    return (values >> np.arange(width - 1, -1, -1)[:, None] & 1).astype(np.uint8)


def _same(bits: str, like: Bits) -> Bits:
    """The same bits for every frame."""
    return np.repeat(np.array([[int(b)] for b in bits], np.uint8), like.shape[1], axis=1)


def _stuffed(bits: Bits, head: int = 0) -> tuple[Counts, Counts]:
    """(n,): stuff bits of each frame, and how many of them lie in its first `head` bits."""
    n = bits.shape[1]
    count, in_head = np.zeros((2, n), np.int64)
    run, last = np.zeros(n, np.uint8), np.full(n, 2, np.uint8)
    for k, bit in enumerate(bits):
        run = run * (bit == last) + 1
        full = run == 5
        count += full
        if k < head:
            in_head += full
        # A stuff bit is the complement, and the first bit of its run.
        run[full] = 1
        last = bit ^ full
    return count, in_head


def _crc15(bits: Bits) -> Counts:
    crc = np.zeros(bits.shape[1], np.int64)
    for bit in bits:
        crc = (crc << 1 & 0x7FFF) ^ CRC15 * ((crc >> 14 & 1) ^ bit)
    return crc
