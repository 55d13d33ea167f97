"""Optional libraries: whether they are installed, and how to install them."""

from __future__ import annotations

from collections.abc import Sequence
from importlib.util import find_spec

from dbc.extras import how_to_install
from gateway.settings.config import ConfigError


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
