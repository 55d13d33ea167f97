"""NumPy types of the core's records, made from `gateway/core/records.h` by the compiler's layout.

A record is read by name, `state[c]["counter"]`; its fields, units and meanings stand in that file.
"""

from __future__ import annotations

from copy import deepcopy
from typing import Any, Final

import numpy as np
from _traction_core import ffi
from numpy.typing import NDArray

Records = NDArray[np.void]
"""One record per row."""


def dtype_of(ctype: Any) -> Any:
    """The NumPy type of a C type: struct, array, integer, floating-point number or address."""
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
    if ctype.kind == "pointer":
        return np.dtype(np.uintp)
    return np.dtype(ctype.cname.removesuffix("_t"))


E2E_CONFIG: Final = dtype_of(ffi.typeof("struct e2e_config"))
E2E_STATE: Final = dtype_of(ffi.typeof("struct e2e_state"))
SIGNAL: Final = dtype_of(ffi.typeof("struct signal"))
MESSAGE: Final = dtype_of(ffi.typeof("struct message"))
MUX_RANGE: Final = dtype_of(ffi.typeof("struct mux_range"))
CODEC: Final = dtype_of(ffi.typeof("struct codec"))
CHANNEL: Final = dtype_of(ffi.typeof("struct channel"))
SEQUENCE_GUARD: Final = dtype_of(ffi.typeof("struct sequence_guard"))
HALF_SAMPLE: Final = dtype_of(ffi.typeof("struct half_sample"))
DRIVE_INPUT: Final = dtype_of(ffi.typeof("struct drive_input"))
HEARTBEAT: Final = dtype_of(ffi.typeof("struct heartbeat"))
SUPERVISION: Final = dtype_of(ffi.typeof("struct supervision"))
ID_ENTRY: Final = dtype_of(ffi.typeof("struct id_entry"))
RECEIVED: Final = dtype_of(ffi.typeof("struct received"))
RECEIVER: Final = dtype_of(ffi.typeof("struct receiver"))
LAYOUT: Final = f"{E2E_CONFIG} {E2E_STATE} {RECEIVED}"
"""What compiled loops depend on that address these records."""


class Addressed:
    """Something whose records hold addresses of its arrays; a copy has addresses of its own."""

    def link(self) -> None:
        """Make everything that depends on where the arrays lie."""
        raise NotImplementedError

    def __deepcopy__(self, memo: dict[int, Any]) -> Addressed:
        """The arrays once more, linked anew."""
        made = type(self).__new__(type(self))
        memo[id(self)] = made
        for name, value in vars(self).items():
            if not isinstance(value, ffi.CData):
                setattr(made, name, deepcopy(value, memo))
        made.link()
        return made
