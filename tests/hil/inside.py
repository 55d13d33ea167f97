"""What a job of these tests sees of the environment."""

from __future__ import annotations

import os
from pathlib import Path

_PASSED_ON = ("LANG", "LC_ALL", "PYTHONPATH", "PYTHONWARNINGS", "TZ")


def environment(folder: Path) -> dict[str, str]:
    """A few variables of ours; its home is `folder`."""
    passed = {key: os.environ[key] for key in _PASSED_ON if key in os.environ}
    own = {"HOME": str(folder), "TMPDIR": str(folder)}
    return {**passed, **own, "PYTHONDONTWRITEBYTECODE": "1", "PYTHONUNBUFFERED": "1"}
