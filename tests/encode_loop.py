"""Frames of several messages in a compiled loop: encoded and protected, as the outbox does it."""

import numpy as np

from dbc._codec_kernels import encode_frame
from dbc._e2e_kernels import e2e_protect
from dbc._lean import lean


def given_of(specs, given):
    """Which signals of each message carry a value, (M, S)."""
    width = max(len(spec.signals) for spec in specs)
    found = np.zeros((len(specs), width), np.uint8)
    for row, spec in zip(found, specs, strict=True):
        row[[spec.column(name) for name in given[spec.name]]] = 1
    return found


@lean
def encode_rows(message, value, counter, codec, given, config, payload):
    """N frames: message (n,) their numbers, value (n, S), counter (n,); fills payload (n, 64)."""
    for row in range(message.shape[0]):
        encode_frame(codec, message[row], value, given, payload, row)
        e2e_protect(payload, row, message[row], counter[row] & 0xFF, config)
