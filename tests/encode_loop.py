"""Frames of several messages, encoded and protected by the compiled core as the outbox does it."""

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
    codec, configs = ffi.cast("struct codec *", codec), pointer("struct e2e_config", config)
    for m, row, count, data in zip(message, value, counter, payload, strict=True):
        lib.encode_frame(
            codec, m, pointer("double", row), pointer("uint8_t", given[m]), pointer("uint8_t", data)
        )
        lib.e2e_protect(configs + int(m), pointer("uint8_t", data), int(count) & 0xFF)
