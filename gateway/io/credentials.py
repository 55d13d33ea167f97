"""Keys and the number of this start, from files that only their owner may read.

A credential of the service manager (`LoadCredential=`, in `$CREDENTIALS_DIRECTORY`) takes
precedence over a file beside the configuration. The contents of a key file are never shown or
logged.
"""

from __future__ import annotations

import fcntl
import os
import stat
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Final

from gateway.settings.config import Config, ConfigError
from gateway.settings.sections import Authentication

if TYPE_CHECKING:
    from dbc.secoc_sender import Authenticator

_MOST_BYTES: Final = 4096
_KEY_BYTES: Final = 16


def flag_authenticator(config: Config) -> Authenticator | None:
    """The authenticator of sent flags, with a new start number; None if not configured.

    Raises ConfigError for a key or a count of starts that cannot be used.
    """
    chosen = config.authentication
    if chosen is None:
        return None
    from dbc.secoc_sender import Authenticator

    key = flag_key(chosen.key, config.base)
    return Authenticator(key, next_trip(trip_path(chosen, config.base)))


def flag_key(name: str, base: Path) -> bytes:
    """The key of 16 bytes: 32 hexadecimal digits, or the bytes themselves. Raises ConfigError."""
    path, content = private_file(name, base)
    text = content.strip()
    try:
        key = content if len(content) == _KEY_BYTES else bytes.fromhex(text.decode("ascii"))
    except ValueError:
        key = b""
    if len(key) != _KEY_BYTES or len(set(key)) == 1:
        problem = "is not a key; make one with 'traction-gateway keygen --flags -o FILE'"
        raise ConfigError(str(path), [problem])
    return key


def private_file(name: str, base: Path) -> tuple[Path, bytes]:
    """(path, content) of a credential, or of a file that only its owner may access.

    Raises ConfigError.
    """
    given = os.environ.get("CREDENTIALS_DIRECTORY")
    if given and Path(name).name == name and (credential := Path(given, name)).is_file():
        # The service manager guards the directory; modes in it may show access lists instead.
        return credential, _content(credential, private=False)
    path = base / name
    return path, _content(path, private=True)


def _content(path: Path, *, private: bool) -> bytes:
    try:
        # Opened once, so that the file that is checked is the file that is read; O_NONBLOCK, so
        # that opening a FIFO put in place of the file does not hang.
        with open(path, "rb", opener=partial(_opened, os.O_NONBLOCK)) as file:
            about = os.fstat(file.fileno())
            problems = [] if stat.S_ISREG(about.st_mode) else ["is not a regular file"]
            if private and about.st_mode & 0o077:
                problems.append(f"others may read or write it; chmod 600 {path}")
            if private and about.st_uid not in (0, os.geteuid()):
                problems.append(
                    f"belongs to user {about.st_uid}, not to root or the current user; chown it"
                )
            if problems:
                raise ConfigError(str(path), problems)
            return file.read(_MOST_BYTES)
    except OSError as error:
        problem = f"cannot be read: {error.strerror}; give it as a credential or beside the config"
        raise ConfigError(str(path), [problem]) from None


def _opened(more: int, path: str, flags: int) -> int:
    return os.open(path, flags | more, 0o600)


def trip_path(chosen: Authentication, base: Path) -> Path:
    """The file that counts starts: in the service's state directory if any, else in `base`."""
    given = os.environ.get("STATE_DIRECTORY", "").split(":")[0]
    return Path(given, chosen.trip) if given else base / chosen.trip


def next_trip(path: Path) -> int:
    """The number of this start, on disk before it is used. Raises ConfigError.

    If a number were used twice, an eavesdropper would already have valid MACs. So a file that
    cannot be read, or that does not hold a number, is an error and does not restart at 1.
    """
    try:
        new = not path.exists()
        with open(path, "r+b", opener=partial(_opened, os.O_CREAT | os.O_NOFOLLOW)) as file:
            fcntl.flock(file, fcntl.LOCK_EX)
            number = _after(path, file.read(64), new=new)
            # In place and of fixed width, so that a power cut leaves the old digits or the new.
            os.pwrite(file.fileno(), f"{number:08d}\n".encode("ascii"), 0)
            os.ftruncate(file.fileno(), 9)
            os.fsync(file.fileno())
        if new:
            _sync_folder(path.parent)
    except OSError as error:
        problem = (
            f"the trip counter cannot be counted up: {error.strerror}; it needs a writable file in "
            "a writable folder"
        )
        raise ConfigError(str(path), [problem]) from None
    return number


def _after(path: Path, content: bytes, *, new: bool) -> int:
    text = content.decode("ascii", errors="replace").strip()
    if not (text.isascii() and text.isdigit() and len(text) < 9) and not (new and not content):
        problem = (
            "contains no trip counter; write a number higher than that of any start with this key"
        )
        raise ConfigError(str(path), [problem])
    number = int(text or "0") + 1
    if number >= 1 << 24:
        problem = "the 24-bit trip counter is used up: make a new key, then delete this file"
        raise ConfigError(str(path), [problem])
    return number


def _sync_folder(folder: Path) -> None:
    """Sync a folder, so that the name of a new file survives a power cut as well."""
    handle = os.open(folder, os.O_RDONLY | os.O_DIRECTORY)
    try:
        os.fsync(handle)
    finally:
        os.close(handle)
