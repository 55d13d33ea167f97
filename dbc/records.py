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
Columns = np.recarray[Any, np.dtype[Any]]
"""The same, read by columns: `filters.x` is (N, 5), `filters.steps[k] = 0` writes into record k."""


_NAMES: Final = {"_cffi_double_complex_t": "complex128"}
"""Where cffi's name is not NumPy's."""


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
    return np.dtype(_NAMES.get(ctype.cname, ctype.cname.removesuffix("_t")))


def zeros(n: int, dtype: Any) -> Columns:
    """N records of zeros."""
    return np.zeros(n, dtype).view(np.recarray)


def pointer(kind: str, records: Columns | NDArray[Any], k: int = 0) -> Any:
    """To record k, for a C function; kind: of the pointer, "struct filter *"."""
    return ffi.cast(kind, records.ctypes.data) + k


E2E_CONFIG: Final = dtype_of(ffi.typeof("struct e2e_config"))
E2E_STATE: Final = dtype_of(ffi.typeof("struct e2e_state"))
PMSM: Final = dtype_of(ffi.typeof("struct pmsm"))
FILTER_SAMPLE: Final = dtype_of(ffi.typeof("struct filter_sample"))
ACQUISITION_LIMITS: Final = dtype_of(ffi.typeof("struct acquisition_limits"))
ACQUISITION: Final = dtype_of(ffi.typeof("struct acquisition"))
REVOLUTION_SUMS: Final = dtype_of(ffi.typeof("struct revolution_sums"))
CURRENT_CALIBRATION: Final = dtype_of(ffi.typeof("struct current_calibration"))
FILTER: Final = dtype_of(ffi.typeof("struct filter"))
FILTER_NOISE: Final = dtype_of(ffi.typeof("struct filter_noise"))
FILTER_SETTINGS: Final = dtype_of(ffi.typeof("struct filter_settings"))
LAYOUT: Final = (
    f"{E2E_CONFIG} {E2E_STATE} {PMSM} {FILTER_SAMPLE} {ACQUISITION_LIMITS} {ACQUISITION} "
    f"{CURRENT_CALIBRATION} {FILTER} {FILTER_NOISE} {FILTER_SETTINGS}"
)
"""What compiled loops depend on that address these records."""
