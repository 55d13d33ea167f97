"""Messages entered into a `Batch` as the kernel would."""

import struct

import numpy as np

from gateway.io.wire import FD_SIZE

NATIVE = struct.calcsize("@l")
TRUNCATED = 0x20
"""MSG_TRUNC."""


def put(batch, payload, control):
    """One message; control: (level, type, data) each."""
    k = batch.filled
    entries = b"".join(
        (struct.pack("@Nii", NATIVE + 8 + len(data), level, kind) + data).ljust(
            NATIVE + 8 + -(-len(data) // NATIVE) * NATIVE, b"\0"
        )
        for level, kind, data in control
    )
    kept = payload[:FD_SIZE]
    batch.data[k, : len(kept)] = np.frombuffer(kept, dtype=np.uint8)
    batch.control[k, : len(entries)] = np.frombuffer(entries, dtype=np.uint8)
    batch.control_sizes[k], batch.sizes[k] = len(entries), len(kept)
    batch.flags[k] = 0 if len(kept) == len(payload) else TRUNCATED
    batch.filled += 1
