"""Authentication of flag frames: the MAC and the sender; receivers are `dbc.secoc_receiver`. Pure.

A flag frame is followed by `Gateway_Auth`: the low 16 bits of a 64-bit freshness value, and the
first four bytes of the AES-CMAC (RFC 4493) over identifier, flag frame and freshness.
The upper 24 bits of the freshness are the number of the sender's start, the lower 40 a count of
flag frames. It needs no clock, and never repeats under one key as long as no start number does.

This module works on bits and keys; it does not know where a key comes from. It loads
`cryptography`, so that only callers with a key import it.
"""

from __future__ import annotations

from typing import Final

from cryptography.hazmat.primitives.ciphers.algorithms import AES
from cryptography.hazmat.primitives.cmac import CMAC

KEY_BYTES: Final = 16
MAC_BYTES: Final = 4
SENT_BITS: Final = 16
"""Bits of the freshness that are sent; the receiver has to know the others."""
COUNT_BITS: Final = 40
"""Bits of the count of flag frames: enough for 300 years at the fastest loop, one each tick."""
TRIP_BITS: Final = 24
FRESHNESS_BITS: Final = COUNT_BITS + TRIP_BITS
LAST_TRIP: Final = (1 << TRIP_BITS) - 1


class Macs:
    """Truncated MACs under one key, which must not be used for anything else."""

    def __init__(self, key: bytes) -> None:
        """AES-128: raises ValueError for a key of other than 16 bytes."""
        if len(key) != KEY_BYTES:
            msg = f"a key has {KEY_BYTES} bytes, not {len(key)}"
            raise ValueError(msg)
        self._keyed = CMAC(AES(key))

    def whole(self, message: bytes) -> bytes:
        """The whole MAC of 16 bytes, RFC 4493."""
        # A copy of a keyed object saves the key schedule for every frame.
        mac = self._keyed.copy()
        mac.update(message)
        return mac.finalize()

    def of(self, key_id: int, data: bytes, freshness: int) -> int:
        """`Mac` of a flag frame: the first four bytes, in their order on the wire.

        key_id: identifier, bit 31 set for 29-bit ones (`MessageSpec.key`). Identifier and
        freshness have fixed widths, so that different frames never give the same message.
        """
        message = key_id.to_bytes(4, "big") + data + freshness.to_bytes(FRESHNESS_BITS // 8, "big")
        return int.from_bytes(self.whole(message)[:MAC_BYTES], "little")


class Authenticator:
    """The sender: one count over all flag frames that it authenticates."""

    def __init__(self, key: bytes, trip: int) -> None:
        """trip: number of this start, 1 .. `LAST_TRIP`, higher than any before under this key.

        Raises ValueError for another key length or number.
        """
        if not 0 < trip <= LAST_TRIP:
            msg = f"start number {trip} is not in 1 .. {LAST_TRIP}"
            raise ValueError(msg)
        self._macs = Macs(key)
        self.freshness = trip << COUNT_BITS
        """Freshness of the last frame that was authenticated."""

    def sign(self, key_id: int, data: bytes) -> tuple[int, int]:
        """(`Freshness`, `Mac`) of the next flag frame."""
        self.freshness += 1
        return self.freshness & ((1 << SENT_BITS) - 1), self._macs.of(key_id, data, self.freshness)
