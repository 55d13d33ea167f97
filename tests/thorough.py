"""Parameters of which some are for every change, and all before a release."""

import pytest


def some(now, later):
    """`now` by `make test`, `later` by `make test-all` only; tuples are several arguments."""
    rows = [one if isinstance(one, tuple) else (one,) for one in later]
    return [*now, *(pytest.param(*row, marks=pytest.mark.thorough) for row in rows)]
