"""How many examples a property test looks at: `pytest --fuzz FACTOR` looks at more."""

from hypothesis import settings

_USUAL = 100


def examples(count):
    """So many examples, times the factor of the run. Asked at import, by the decorators."""
    return count * settings().max_examples // _USUAL


def load_gate():
    """The same examples every time, so that the gate fails for what was changed.

    No deadline: the first example pays for compiling, it would judge the compiler.
    """
    settings.register_profile("gate", deadline=None, derandomize=True, max_examples=_USUAL)
    settings.load_profile("gate")


def load_fuzz(factor):
    """Random examples, `factor` times as many."""
    many = _USUAL * factor
    settings.register_profile("fuzz", deadline=None, max_examples=many, print_blob=True)
    settings.load_profile("fuzz")
