"""Records in tests: the same numbers, NaN where the other has NaN."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray


def same_numbers(mine: NDArray[Any], wanted: Any) -> None:
    """Raises AssertionError where two arrays differ, of records by field."""
    if mine.dtype.names is None:
        np.testing.assert_array_equal(mine, wanted)
    else:
        for name in mine.dtype.names:
            np.testing.assert_array_equal(mine[name], wanted[name], name)
