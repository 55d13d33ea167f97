"""NumPy types of the core's records in `gateway/core/records.h`, with the compiler's layout.

Fields are read by name, `state[c]["counter"]`; that file describes them and gives their units.
"""

from __future__ import annotations

from collections.abc import Mapping
from copy import deepcopy
from functools import cache
from typing import Any, Final

import numpy as np
from _traction_core import ffi
from numpy.typing import NDArray

Records = NDArray[np.void]
"""One record per row."""
Columns = np.recarray[Any, np.dtype[Any]]
"""Records read by columns: `filters.x` is (N, 5), `filters.steps[k] = 0` writes into record k."""


_NAMES: Final = {"_cffi_double_complex_t": "complex128", "size_t": "uintp"}
"""NumPy's name of a type for which cffi uses another name."""


@cache
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
    return np.dtype(_NAMES.get(ctype.cname, ctype.cname.removesuffix("_t")))


def __getattr__(name: str) -> Any:
    """Find `CHANNEL`, the NumPy type of `struct channel`, and so that of every other record."""
    try:
        return dtype_of(ffi.typeof(f"struct {name.lower()}"))
    except ffi.error:
        raise AttributeError(f"no record {name}") from None


def zeros(n: int, dtype: Any) -> Columns:
    """Return n records of zeros."""
    return np.zeros(n, dtype).view(np.recarray)


def pointer(ctype: str, array: NDArray[Any]) -> Any:
    """Address of a contiguous array as a pointer to numbers or records of this C type.

    Raises ValueError for an array that is not contiguous. The array has to outlive its use.
    """
    return ffi.from_buffer(f"{ctype}[]", array)


def point_to(record: Records, arrays: Mapping[str, NDArray[Any]]) -> None:
    """Put the arrays' addresses into the fields of these names. The arrays have to outlive it."""
    for name, array in arrays.items():
        record[name] = array.ctypes.data


class Addressed:
    """An object whose records hold addresses of its arrays; a copy gets those of its own arrays."""

    def link(self) -> None:
        """Create everything that depends on the addresses of the arrays."""
        raise NotImplementedError

    def __deepcopy__(self, memo: dict[int, Any]) -> Addressed:
        """Copy the arrays and link the copy to them."""
        made = type(self).__new__(type(self))
        memo[id(self)] = made
        for name, value in vars(self).items():
            if not isinstance(value, ffi.CData):
                setattr(made, name, deepcopy(value, memo))
        made.link()
        return made
