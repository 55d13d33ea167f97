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


def pointer(ctype: str, array: NDArray[Any]) -> Any:
    """Address of a contiguous array as a pointer to numbers or records of this C type.

    Raises ValueError for an array that is not contiguous. The array has to outlive its use.
    """
    return ffi.from_buffer(f"{ctype}[]", array)


E2E_CONFIG: Final = dtype_of(ffi.typeof("struct e2e_config"))
E2E_STATE: Final = dtype_of(ffi.typeof("struct e2e_state"))
MIXTURE: Final = dtype_of(ffi.typeof("struct mixture"))
SIGMA_MIXED_CONFIG: Final = dtype_of(ffi.typeof("struct sigma_mixed_config"))
SIGMA_MIXED_SAMPLE: Final = dtype_of(ffi.typeof("struct sigma_mixed_sample"))
THERMAL_PARAMETERS: Final = dtype_of(ffi.typeof("struct thermal_parameters"))
THERMAL_INPUT: Final = dtype_of(ffi.typeof("struct thermal_input"))
STEP_CONFIG: Final = dtype_of(ffi.typeof("struct step_config"))
STEP_STATE: Final = dtype_of(ffi.typeof("struct step_state"))
IMM_FAULT: Final = dtype_of(ffi.typeof("struct imm_fault"))
IMM_CONFIG: Final = dtype_of(ffi.typeof("struct imm_config"))
IMM_SURROUNDINGS: Final = dtype_of(ffi.typeof("struct imm_surroundings"))
IMM_STATE: Final = dtype_of(ffi.typeof("struct imm_state"))
THERMAL_SUMS: Final = dtype_of(ffi.typeof("struct thermal_sums"))
THERMAL_BURST: Final = dtype_of(ffi.typeof("struct thermal_burst"))
THERMAL_MOTOR_CONFIG: Final = dtype_of(ffi.typeof("struct thermal_motor_config"))
THERMAL_CONFIG: Final = dtype_of(ffi.typeof("struct thermal_config"))
THERMAL_MOTOR: Final = dtype_of(ffi.typeof("struct thermal_motor"))
HYPOTHESIS_CONFIG: Final = dtype_of(ffi.typeof("struct hypothesis_config"))
HYPOTHESIS_SPREAD: Final = dtype_of(ffi.typeof("struct hypothesis_spread"))
HYPOTHESIS_STATE: Final = dtype_of(ffi.typeof("struct hypothesis_state"))
TEMPERATURE_SENSOR: Final = dtype_of(ffi.typeof("struct temperature_sensor"))
TEMPERATURE_DRIVE: Final = dtype_of(ffi.typeof("struct temperature_drive"))
LAYOUT: Final = f"{E2E_CONFIG} {E2E_STATE} {TEMPERATURE_DRIVE}"
"""What compiled loops depend on that address these records."""
