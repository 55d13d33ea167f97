"""Load our packages although a user's files have the same names.

Python searches the folder of a test, and with `python -m pytest` the current folder, before the
installed packages: `import sim` finds a `sim.py` there, even from our own modules.
"""

from __future__ import annotations

import sys
from contextlib import suppress
from importlib import import_module
from importlib.machinery import ModuleSpec, PathFinder
from pathlib import Path
from pkgutil import walk_packages
from typing import Final

OURS: Final = ("dbc", "estimators", "sim")
_ROOT: Final = Path(__file__).parents[3]
_loaded: Final[set[str]] = set()
"""Packages that were hidden, and of which our modules are loaded now."""


class _Finder:
    """Finds our packages in the folder of this installation."""

    @staticmethod
    def find_spec(name: str, *_: object) -> ModuleSpec | None:
        """See `importlib.abc.MetaPathFinder`."""
        return PathFinder.find_spec(name, [str(_ROOT)]) if name in OURS else None


def _is_hidden(name: str, folder: Path) -> bool:
    if name in sys.modules:
        origin = getattr(sys.modules[name], "__file__", None)
    else:
        spec = PathFinder.find_spec(name, [str(folder), *sys.path])
        if spec is None:  # an editable install has a finder of its own
            return False
        origin = spec.origin
    return origin is None or Path(origin).resolve() != (_ROOT / name / "__init__.py").resolve()


def load_hidden(folder: Path) -> None:
    """Load our packages if files of the user, in this folder or on the path, hide them.

    Afterwards `import sim` gives the user's module and `sim.scenario` ours, because Python looks up
    the full name among the loaded modules first. So all modules are loaded here, and those of ours
    that import a bare package name. Nothing is done if no name is hidden.
    """
    hidden = [name for name in OURS if name not in _loaded and _is_hidden(name, folder)]
    if not hidden:
        return
    theirs = {
        name: sys.modules.pop(name) for name in [*sys.modules] if name.split(".")[0] in hidden
    }
    sys.meta_path.insert(0, _Finder)
    try:
        for name in OURS:
            for module in walk_packages(import_module(name).__path__, f"{name}."):
                with suppress(ImportError):  # needs an extra that is not installed
                    import_module(module.name)
        import_module("gateway.hil.pytest.scenarios")
        _loaded.update(hidden)
    finally:
        sys.meta_path.remove(_Finder)
        for name in hidden:
            sys.modules.pop(name, None)
        sys.modules.update({name: theirs[name] for name in theirs if name not in sys.modules})
