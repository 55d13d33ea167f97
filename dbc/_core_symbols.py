"""Functions of the compiled core by their symbols, for loops that numba still compiles.

A symbol is looked up when compiled code is loaded, so such a loop can be kept on disk. Goes when
the last of those loops is C (docs/adr/0005-c-core.md).
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import _traction_core
import llvmlite.binding as llvm
import numba
from _traction_core import ffi, lib

_NUMBERS = {
    "double": numba.types.float64, "int": numba.types.int32, "int32_t": numba.types.int32,
    "int64_t": numba.types.int64, "uint8_t": numba.types.uint8, "void": numba.types.void,
}  # fmt: skip


def symbol(name: str) -> Callable[..., Any]:
    """A function that takes addresses for pointers. Uncompiled: the same by cffi."""
    kind = ffi.typeof(getattr(lib, name))
    if numba.config.DISABLE_JIT:  # type: ignore[attr-defined,unused-ignore]
        function = getattr(lib, name)
        return lambda *given: function(*map(ffi.cast, kind.args, given))
    llvm.load_library_permanently(_traction_core.__file__)
    arguments = [_NUMBERS.get(one.cname, numba.types.intp) for one in kind.args]
    return numba.types.ExternalFunction(name, _NUMBERS[kind.result.cname](*arguments))
