"""Compiled reading of what `recvmmsg` has filled: C structures to the columns of a block.

Twin for one frame: `gateway.drivers.wire.unpack`.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from dbc._lean import inlined, lean

Bytes = NDArray[np.uint8]
Ints = NDArray[np.int64]

_CLASSIC_SIZE, _FD_SIZE = 16, 72
_HEAD = 8
_EXTENDED, _REMOTE, _ERROR, _FD, _BRS, _ESI = 1, 2, 4, 8, 16, 32  # dbc.frame
_SOL_SOCKET, _STAMP, _DROPS = 1, 35, 40
TRUNCATED = 0x20
"""MSG_TRUNC, of a message's flags: it was longer than a frame is."""
FRAMES, MALFORMED, ERRORS, DROPPED, LAST_DROPS = range(5)
"""Of `tally`: usable rows, others, error frames among the rows, frames that the kernel has dropped
since, and its counter (which wraps), kept from call to call."""


@inlined
def _word(rows: Bytes, k: int, at: int, size: int) -> int:
    """Unsigned little-endian number of `size` bytes in row k."""
    number = np.int64(0)
    for b in range(size):
        number |= np.int64(rows[k, at + b]) << (8 * b)
    return int(number)


@lean
def unpack_rows(
    data: Bytes, sizes: NDArray[np.uint32], seen: NDArray[np.int32], control: Bytes,
    control_sizes: NDArray[np.uint64], n: int, native: int, stamp_ns: Ints,
    can_id: NDArray[np.uint32], flags: Bytes, length: Bytes, out: Bytes, dlc: NDArray[np.int8],
    channel: NDArray[np.uint16], tally: Ints, real_ns: int, now_ns: int, bound_ns: int,
) -> None:  # fmt: skip
    """Read n messages of `sizes` bytes; fills one row for each that is a CAN frame.

    data (M, 72); seen (M,): flags of each message; control (M, C) and how much of it is used,
    which is set back to C; native: bytes of a C long. stamp_ns: `transport.monotonic_stamp` of
    the kernel's stamp with real_ns, now_ns and bound_ns; now where there is none.
    out (n, 64), zero behind the length. tally (5,): see above.
    """
    row = malformed = errors = 0
    tally[DROPPED] = 0
    for k in range(n):
        stamp = 0
        at, header = 0, native + 8
        used = int(control_sizes[k])
        control_sizes[k] = control.shape[1]
        while at + header <= used:
            size = _word(control, k, at, native)
            if size < header:
                break
            level, kind = _word(control, k, at + native, 4), _word(control, k, at + native + 4, 4)
            if level == _SOL_SOCKET and kind == _STAMP:
                seconds = _word(control, k, at + header, native)
                stamp = seconds * 1_000_000_000 + _word(control, k, at + header + native, native)
            elif level == _SOL_SOCKET and kind == _DROPS:
                drops = _word(control, k, at + header, 4)
                tally[DROPPED] += (drops - tally[LAST_DROPS]) & 0xFFFF_FFFF
                tally[LAST_DROPS] = drops
            at += (size + native - 1) // native * native
        if seen[k] & TRUNCATED or sizes[k] not in (_CLASSIC_SIZE, _FD_SIZE):
            malformed += 1
            continue
        fd = sizes[k] == _FD_SIZE
        word = _word(data, k, 0, 4)
        said, raw = int(data[k, 4]), int(data[k, 7])
        extended = word & 0x8000_0000 != 0
        age = 0 if stamp == 0 else min(max(real_ns - stamp, 0), bound_ns)
        stamp_ns[row] = now_ns - age
        channel[row] = 0
        can_id[row] = word & (0x1FFF_FFFF if extended else 0x7FF)
        kind = _EXTENDED if extended else 0
        if fd:
            kind |= _FD | (_BRS if data[k, 5] & 1 else 0) | (_ESI if data[k, 5] & 2 else 0)
        count = min(said, 64 if fd else 8)
        dlc[row] = -1
        if word & 0x2000_0000:
            can_id[row] = word & 0x1FFF_FFFF
            kind = _ERROR
            count = min(said, 8)
            errors += 1
        elif not fd:
            if said == 8 and 9 <= raw <= 15:
                dlc[row] = raw
            if word & 0x4000_0000:
                kind |= _REMOTE
                count = 0
                if dlc[row] < 0 and said > 0:
                    dlc[row] = min(said, 8)  # a length byte says up to 255
        flags[row] = kind
        length[row] = count
        for b in range(count):
            out[row, b] = data[k, _HEAD + b]
        for b in range(count, 64):
            out[row, b] = 0
        row += 1
    tally[FRAMES], tally[MALFORMED], tally[ERRORS] = row, malformed, errors
