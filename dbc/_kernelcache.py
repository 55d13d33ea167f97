"""Compiled functions are kept on disk, with a stamp of everything that they were compiled from.

numba's own cache looks at the function's own file only: after a change of a constant or a helper
in another module the old machine code goes on running. Here the stamp is a hash over all sources
of the product that the function's module imports, directly or through others, and over the
versions of Python, numba, llvmlite and NumPy, and the layout of the compiled core's records. A
stamp over all sources would need fewer lines, but
then every edit would compile everything anew, which takes minutes; a kernel's module imports 0 to
97 of 300.

A file is the stamp, a hash over stamp, key and content, the content (one pickle) and the key, for
people. What is missing, stale, cut short or garbage is compiled anew; what cannot be written stays
in memory, and that is logged once.
"""

from __future__ import annotations

import glob
import hashlib
import logging
import os
import pickle
import re
import sys
import uuid
from collections.abc import Callable
from contextlib import suppress
from functools import cache
from pathlib import Path
from typing import Any, Final, TypeVar

import llvmlite
import numba
import numpy as np
from numba.core import caching
from numba.core.compiler import CompileResult
from numba.core.serialize import dumps
from numba.core.sigutils import normalize_signature

from dbc.records import LAYOUT

F = TypeVar("F", bound=Callable[..., Any])
log = logging.getLogger(__name__)

PRODUCT: Final = ("dbc", "estimators", "gateway", "sim")
SIZE: Final = hashlib.sha256().digest_size
VERSIONS: Final = (
    f"{sys.version} {numba.__version__} {llvmlite.__version__} {np.__version__} {LAYOUT}"
)
_IMPORTS: Final = re.compile(
    r"^[ \t]*(?:from[ \t]+([\w.]+)[ \t]+import[ \t]+(\([^)]*\)|.*)|import[ \t]+(.*))", re.MULTILINE
)
_LOCATORS: Final = (
    caching.UserProvidedCacheLocator, caching.InTreeCacheLocator, caching.UserWideCacheLocator,
)  # fmt: skip


class Settings:
    """Of this process. `folder`: in place of where numba would look; `write`: whether to."""

    folder: Path | None = None
    write = True
    compiled = 0
    """Functions that were not found, and were compiled."""
    lost = 0
    """Of these, those that could not be kept."""


def njit(*, cache: bool = False, **options: Any) -> Callable[[F], F]:
    """As `numba.njit`, with this cache in place of numba's."""

    def compiled(function: F) -> F:
        kernel = numba.njit(**options)(function)
        if cache and kernel is not function:  # it is where NUMBA_DISABLE_JIT=1
            kernel._cache = KernelCache(function)
        return kernel  # type: ignore[no-any-return]

    return compiled


class KernelCache(caching._Cache):
    """What numba asks for one function. Nothing in here raises."""

    def __init__(self, function: Callable[..., Any]) -> None:
        """The sources are hashed now: these, and not what lies there later, are what runs."""
        self._function = function
        self._name = ".".join(
            (function.__module__, function.__qualname__, str(sys.implementation.cache_tag))
        )
        self._stamp = stamp(function.__module__, function.__code__.co_filename)

    @property
    def cache_path(self) -> str | None:
        """The folder, if there is one."""
        if self._stamp is None:
            return None
        folder = Settings.folder or _folder(self._function.__code__.co_filename)
        return None if folder is None else str(folder)

    def load_overload(self, sig: Any, target_context: Any) -> Any:
        """The compiled function, or None."""
        target_context.refresh()
        try:
            if (folder := self.cache_path) is None:
                return None
            key = self._key(sig, target_context.codegen())
            data = self._path(folder, key).read_bytes()
            head, content = data[: 2 * SIZE], data[2 * SIZE :].removesuffix(key)
            if head != self._head(key, content):
                return None
            return CompileResult._rebuild(target_context, *pickle.loads(content))  # noqa: S301 - who writes there may run code here: docs/threats.md
        except FileNotFoundError:
            return None
        except Exception as error:
            log.debug("%s is compiled anew: %s", self._name, error)
            return None

    def save_overload(self, sig: Any, data: Any) -> None:
        """Keep what was compiled, and delete what is stale of the same function."""
        Settings.compiled += 1
        if data.library.has_dynamic_globals or any(not one.can_cache for one in data.lifted):
            return  # it holds addresses of this process
        if not Settings.write:
            return
        if (folder := self.cache_path) is None:
            _lost("no sources, or no folder that can be written to")
            return
        key = self._key(sig, data.codegen)
        content = dumps(data._reduce())
        head, path = self._head(key, content), self._path(folder, key)
        new = path.with_name(f"{path.name}.tmp.{uuid.uuid4().hex}")
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
            new.write_bytes(head + content + key)
            new.replace(path)
        except OSError as error:
            _lost(error.strerror or str(error))
            with suppress(OSError):
                new.unlink()
            return
        self._sweep(path.parent, head[:SIZE])

    def _sweep(self, folder: Path, stamp: bytes) -> None:
        """Delete this function's files with another stamp, as far as nobody else is about it."""
        for other in folder.glob(f"{glob.escape(self._name)}.*.nbc"):
            with suppress(OSError):
                with other.open("rb") as file:
                    stale = file.read(SIZE) != stamp
                if stale:
                    other.unlink()

    def _key(self, sig: Any, codegen: Any) -> bytes:
        """Types of the arguments, processor, and what a function of a function holds."""
        held = [cell.cell_contents for cell in self._function.__closure__ or ()]
        code = self._function.__code__
        types, _ = normalize_signature(sig)
        text = f"{_spelt(types)} {codegen.magic_tuple()} {code.co_firstlineno} {code.co_code!r}"
        return text.encode() + (dumps(held) if held else b"")

    def _path(self, folder: str, key: bytes) -> Path:
        return Path(folder) / f"{self._name}.{hashlib.sha256(key).hexdigest()[:16]}.nbc"

    def _head(self, key: bytes, content: bytes) -> bytes:
        stamped = self._stamp or b""
        return stamped + hashlib.sha256(stamped + key + content).digest()

    def enable(self) -> None:
        """It always is."""

    def disable(self) -> None:
        """It never is."""

    def flush(self) -> None:
        """What is stale is never used."""


def _spelt(given: Any) -> str:
    """Types, with the fields of named tuples: their order is compiled in."""
    fields = getattr(given, "fields", None)
    inner = given if isinstance(given, tuple) else getattr(given, "types", ())
    inner = [_spelt(one) for one in (*inner, *filter(None, [getattr(given, "dtype", None)]))]
    named = getattr(given, "instance_class", None)
    return f"{given} {named} {fields if named else ''} {inner}"


@cache
def stamp(module: str, file: str) -> bytes | None:
    """Hash over the sources that a module is made of; `file`: its own. None: there are none."""
    root = os.path.abspath(os.path.join(os.path.dirname(file), *[".."] * module.count(".")))  # noqa: PTH100,PTH118,PTH120 - quick
    tops = {*PRODUCT, module.partition(".")[0]}
    found: dict[str, str] = {}
    left = [module]
    while left:
        name = left.pop()
        if name not in found and (top := name.partition(".")[0]) in tops:
            path = sources(root, top).get(name)
            if path is None:
                continue
            try:
                found[name], more = _source(path)
            except OSError:
                return None
            left += more
    if module not in found:
        return None
    text = VERSIONS + "".join(f"\n{name} {digest}" for name, digest in sorted(found.items()))
    return hashlib.sha256(text.encode()).digest()


@cache
def sources(root: str, top: str) -> dict[str, str]:
    """Module -> file, of all modules of the package `top` in the folder `root`."""
    found = {}
    for folder, _, names in os.walk(os.path.join(root, top)):  # noqa: PTH118 - quick
        package = folder[len(root) + 1 :].replace(os.sep, ".")
        for name in names:
            if name.endswith(".py"):
                module = f"{package}.{name[:-3]}".removesuffix(".__init__")
                found[module] = f"{folder}{os.sep}{name}"
    return found


@cache
def _source(path: str) -> tuple[str, list[str]]:
    """A file's hash, and what it may import: modules, and names that are none."""
    with open(path, "rb") as file:  # noqa: PTH123 - quick
        data = file.read()
    more: list[str] = []
    for origin, names, plain in _IMPORTS.findall(data.decode(errors="replace")):
        words = re.findall(r"[\w.]+", names or plain)
        more += [origin, *(f"{origin}.{word}" for word in words)] if origin else words
    return hashlib.sha256(data).hexdigest(), more


@cache
def _folder(file: str) -> Path | None:
    """Where numba keeps what is compiled from a file: NUMBA_CACHE_DIR, beside it, or at home."""
    for locator in _LOCATORS:
        if found := locator.from_function(_spelt, file):  # any function will do: the file counts
            return Path(found.get_cache_path())
    return None


def _lost(why: str) -> None:
    Settings.lost += 1
    _say(why)


@cache
def _say(why: str) -> None:
    log.warning(
        "compiled code cannot be kept (%s), so every start compiles: set NUMBA_CACHE_DIR to a "
        "folder that can be written to, or see `traction-gateway warm`", why
    )  # fmt: skip
