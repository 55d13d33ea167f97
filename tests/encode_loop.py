"""Frames of several messages, encoded and protected as `gateway/core/transmit.c` does it."""

import numpy as np
from _traction_core import ffi, lib

from dbc.records import pointer


def given_of(specs, given):
    """Which signals of each message carry a value, (M, S)."""
    width = max(len(spec.signals) for spec in specs)
    found = np.zeros((len(specs), width), np.uint8)
    for row, spec in zip(found, specs, strict=True):
        row[[spec.column(name) for name in given[spec.name]]] = 1
    return found


def encode_rows(message, value, counter, codec, given, config, payload):
    """N frames: message (n,) their numbers, value (n, S), counter (n,); fills payload (n, 64)."""
    tables, configs = ffi.cast("struct codec *", codec), pointer("struct e2e_config", config)
    for row, m in enumerate(message.tolist()):
        data = pointer("uint8_t", payload[row])
        lib.encode_frame(
            tables, m, pointer("double", value[row]), pointer("uint8_t", given[m]), data
        )
        lib.e2e_protect(ffi.addressof(configs[m]), data, int(counter[row]) & 0xFF)
