"""Optional libraries: whether they are installed, and how to install them."""

from __future__ import annotations

import re
from collections.abc import Sequence
from importlib.util import find_spec

from gateway.settings.config import ConfigError

_OF_EXTRA = re.compile(r"""^(?P<what>[^;]+?)\s*;\s*extra\s*==\s*["'](?P<extra>[^"']+)["']\s*$""")


def how_to_install(extra: str) -> str:
    """A command that brings what the extra names; it needs no index that has this program."""
    from importlib.metadata import PackageNotFoundError, requires

    try:
        lines = requires("traction-gateway") or []
    except PackageNotFoundError:  # run from its sources
        lines = []
    found = [match for line in lines if (match := _OF_EXTRA.match(line))]
    names = [f"'{match['what']}'" for match in found if match["extra"] == extra]
    return f"pip install {' '.join(names)}" if names else f"pip install '.[{extra}]' in its sources"


def pictures(what: str) -> None:
    """Raises ConfigError where no picture can be drawn. what: who needs them."""
    need(("matplotlib",), "pictures", what)


def need(modules: Sequence[str], extra: str, what: str = "") -> None:
    """Raises ConfigError that says what to install where any of them is not there.

    what: who needs it.
    """
    missing = [name for name in modules if find_spec(name) is None]
    if missing:
        needs = f"needs {', '.join(missing)}"
        raise ConfigError(f"{what}: {needs}" if what else needs, [how_to_install(extra)])
