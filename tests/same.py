"""Records in tests: the same numbers, NaN where the other has NaN."""

import numpy as np


def same_numbers(mine, wanted):
    """Raises AssertionError where two arrays differ, of records by field."""
    if mine.dtype.names is None:
        np.testing.assert_array_equal(mine, wanted)
    else:
        for name in mine.dtype.names:
            np.testing.assert_array_equal(mine[name], wanted[name], name)
