"""Records in tests: the same numbers, NaN where the other has NaN."""

import numpy as np


def same_numbers(mine, wanted, name=""):
    """Raises AssertionError where two arrays differ, of records by field.

    The same bytes are the same numbers: `assert_array_equal`, which also says what differs, takes
    twenty times as long and is asked only where they are not.
    """
    if same_bytes(mine, wanted):
        return
    if mine.dtype.names is None:
        if not np.array_equal(mine, wanted):
            np.testing.assert_array_equal(mine, wanted, name)
    else:
        for field in mine.dtype.names:
            same_numbers(mine[field], wanted[field], field)


def near_numbers(mine, wanted, name="", rtol=1e-9, atol=1e-12):
    """Raises AssertionError where two arrays are not close."""
    if not same_bytes(mine, wanted):
        np.testing.assert_allclose(mine, wanted, rtol, atol, err_msg=name)


def same_values(mine, wanted, name=""):
    """Raises AssertionError where two values, or two lists of them, differ."""
    if mine != wanted:
        np.testing.assert_equal(mine, wanted, name)


def same_bytes(mine, wanted):
    """Of two arrays of one shape, and with one type of number."""
    return (
        isinstance(wanted, np.ndarray | np.generic)
        and (mine.dtype, mine.shape) == (wanted.dtype, wanted.shape)
        and mine.tobytes() == wanted.tobytes()
    )
