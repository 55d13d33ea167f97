"""What these tests in a guest share with those who start it: environment, a reason to skip."""

import os

STALLS = "inconclusive: this machine stood still or lost frames in every attempt"
"""What a test on a bus in real time says instead of a verdict."""
_PASSED_ON = ("LANG", "LC_ALL", "PYTHONPATH", "PYTHONWARNINGS", "TZ")


def environment(folder):
    """A few variables of ours; its home is `folder`."""
    passed = {key: os.environ[key] for key in _PASSED_ON if key in os.environ}
    own = {"HOME": str(folder), "TMPDIR": str(folder)}
    return {**passed, **own, "PYTHONDONTWRITEBYTECODE": "1", "PYTHONUNBUFFERED": "1"}
