"""How to install the libraries of an extra of this package."""

from __future__ import annotations

import re

_OF_EXTRA = re.compile(r"""^(?P<what>[^;]+?)\s*;\s*extra\s*==\s*["'](?P<extra>[^"']+)["']\s*$""")


def how_to_install(extra: str) -> str:
    """A command that installs an extra's packages, even if no index has this program."""
    from importlib.metadata import PackageNotFoundError, requires

    try:
        lines = requires("traction-gateway") or []
    except PackageNotFoundError:  # run from its sources
        lines = []
    found = [match for line in lines if (match := _OF_EXTRA.match(line))]
    names = [f"'{match['what']}'" for match in found if match["extra"] == extra]
    return f"pip install {' '.join(names)}" if names else f"pip install '.[{extra}]' in its sources"
