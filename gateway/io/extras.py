"""Optional libraries: whether they are installed, and how to install them."""

from __future__ import annotations

import re
from collections.abc import Sequence
from importlib.util import find_spec

from gateway.settings.config import ConfigError

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


def pictures(what: str) -> None:
    """Raises ConfigError if pictures cannot be drawn. what: name of the feature that needs them."""
    need(("matplotlib",), "pictures", what)


def need(modules: Sequence[str], extra: str, what: str = "") -> None:
    """Raises ConfigError, which says what to install, if one of `modules` is missing.

    what: name of the feature that needs them.
    """
    missing = [name for name in modules if find_spec(name) is None]
    if missing:
        needs = f"needs {', '.join(missing)}"
        raise ConfigError(f"{what}: {needs}" if what else needs, [how_to_install(extra)])
