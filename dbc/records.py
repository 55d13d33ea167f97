"""NumPy types of the core's records, made from `gateway/core/records.h` by the compiler's layout.

A record is read by name, `state[c]["counter"]`; its fields, units and meanings stand in that file.
"""

from __future__ import annotations

from typing import Any, Final

import numpy as np
from _traction_core import ffi
from numpy.typing import NDArray

Records = NDArray[np.void]
"""One record per row."""


def dtype_of(ctype: Any) -> Any:
    """The NumPy type of a C type: struct, array, integer or floating-point number."""
    if ctype.kind == "struct":
        fields = ctype.fields
        return np.dtype({
            "names": [name for name, _ in fields],
            "formats": [dtype_of(field.type) for _, field in fields],
            "offsets": [field.offset for _, field in fields],
            "itemsize": ffi.sizeof(ctype),
        })  # fmt: skip
    if ctype.kind == "array":
        return np.dtype((dtype_of(ctype.item), (ctype.length,)))
    return np.dtype(ctype.cname.removesuffix("_t"))


E2E_CONFIG: Final = dtype_of(ffi.typeof("struct e2e_config"))
E2E_STATE: Final = dtype_of(ffi.typeof("struct e2e_state"))
FLAG: Final = dtype_of(ffi.typeof("struct flag"))
FLAG_TIMING: Final = dtype_of(ffi.typeof("struct flag_timing"))
FLAG_RULES: Final = dtype_of(ffi.typeof("struct flag_rules"))
FLAG_INPUTS: Final = dtype_of(ffi.typeof("struct flag_inputs"))
TRAIN_INPUTS: Final = dtype_of(ffi.typeof("struct train_inputs"))
DRIVE_EVIDENCE: Final = dtype_of(ffi.typeof("struct drive_evidence"))
DRIVE_STATUS: Final = dtype_of(ffi.typeof("struct drive_status"))
TRAIN_STATUS: Final = dtype_of(ffi.typeof("struct train_status"))
VB_PRIORS: Final = dtype_of(ffi.typeof("struct vb_priors"))
LOAD_SPREAD: Final = dtype_of(ffi.typeof("struct load_spread"))
LOAD_RATIO: Final = dtype_of(ffi.typeof("struct load_ratio"))
LOAD_OBSERVATION: Final = dtype_of(ffi.typeof("struct load_observation"))
COMMAND_RESPONSE: Final = dtype_of(ffi.typeof("struct command_response"))
ROTOR: Final = dtype_of(ffi.typeof("struct rotor"))
ROTOR_INPUTS: Final = dtype_of(ffi.typeof("struct rotor_inputs"))
LAYOUT: Final = " ".join(map(str, (
    E2E_CONFIG, E2E_STATE,
    FLAG, FLAG_TIMING, FLAG_RULES, FLAG_INPUTS, TRAIN_INPUTS, DRIVE_EVIDENCE, DRIVE_STATUS,
    TRAIN_STATUS, VB_PRIORS, LOAD_SPREAD, LOAD_RATIO, LOAD_OBSERVATION, COMMAND_RESPONSE,
    ROTOR, ROTOR_INPUTS,
)))  # fmt: skip
"""What compiled loops depend on that address these records."""
