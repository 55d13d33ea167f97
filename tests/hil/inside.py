"""What a job of these tests sees of the environment."""

import os

_PASSED_ON = ("LANG", "LC_ALL", "PYTHONPATH", "PYTHONWARNINGS", "TZ")


def environment(folder):
    """A few variables of ours; its home is `folder`."""
    passed = {key: os.environ[key] for key in _PASSED_ON if key in os.environ}
    own = {"HOME": str(folder), "TMPDIR": str(folder)}
    return {**passed, **own, "PYTHONDONTWRITEBYTECODE": "1", "PYTHONUNBUFFERED": "1"}
