"""Signed configuration: ed25519 over the digests of configuration, DBC and calibration.

The signature is a text file beside the configuration. The verifier needs the public key from
another source: a key that came with the configuration could be the key of an attacker.
"""

from __future__ import annotations

import base64
import binascii
import hashlib
import os
from collections.abc import Mapping
from functools import partial
from pathlib import Path
from typing import Final

from cryptography.exceptions import InvalidSignature, UnsupportedAlgorithm
from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey, Ed25519PublicKey
from cryptography.hazmat.primitives.serialization import (
    Encoding,
    NoEncryption,
    PrivateFormat,
    PublicFormat,
    load_pem_private_key,
    load_pem_public_key,
)

from gateway.io.credentials import private_file
from gateway.settings.config import Config, ConfigError, check_seal

TITLE: Final = "traction-gateway signed configuration 1"
"""First signed line; it also rejects signatures made for another purpose."""
ROLES: Final = ("config", "dbc", "calibration")
NONE: Final = "none"
_LONGEST: Final = 4096


def default_signature(config: Path) -> Path:
    """Default path of a configuration's signature."""
    return config.with_name(config.name + ".sig")


def digests(path: Path, config: Config) -> dict[str, str]:
    """SHA-256 of the files that this configuration consists of, by role. Raises OSError."""
    calibration = config.calibration_path
    return {
        "config": _digest(path),
        "dbc": _digest(config.dbc_path),
        "calibration": _digest(calibration) if calibration else NONE,
    }


def statement(seals: Mapping[str, str]) -> bytes:
    """The signed bytes: the title and a line per role, always the same for the same files."""
    return "".join([f"{TITLE}\n", *(f"{role} {seals[role]}\n" for role in ROLES)]).encode("ascii")


def sign(path: Path, config: Config, key: Path) -> tuple[str, dict[str, str]]:
    """(text of the signature file, signed digest by role). Raises ConfigError for the key."""
    seals = digests(path, config)
    signed = statement(seals)
    signature = base64.b64encode(_private_key(key).sign(signed)).decode("ascii")
    return f"{signed.decode('ascii')}signature {signature}\n", seals


def verified(signature: Path, public_key: Path) -> dict[str, str]:
    """Signed digests of a signature file, by role. Raises ConfigError unless it is this key's.

    The file must be byte for byte what `sign` writes, so nothing in it is unsigned.
    """
    key = _public_key(public_key)
    try:
        with signature.open("rb") as file:
            content = file.read(_LONGEST)
    except OSError as error:
        problem = f"no signature: {error.strerror}; make one with 'traction-gateway sign'"
        raise ConfigError(str(signature), [problem]) from None
    signed, _, last = content.rpartition(b"signature ")
    seals = dict(line.partition(" ")[::2] for line in signed.decode("latin-1").splitlines()[1:])
    try:
        raw = base64.b64decode(last, validate=False)
        if set(seals) != set(ROLES) or statement(seals) != signed:
            raise ConfigError(str(signature), ["is not a signature of a configuration"])
        if base64.b64encode(raw) + b"\n" != last:
            raise ConfigError(str(signature), ["is not a signature of a configuration"])
        key.verify(raw, signed)
    except (InvalidSignature, binascii.Error, UnicodeEncodeError):
        problem = (
            f"the signature was not made with the key of {public_key}, or the signed digests were "
            "changed"
        )
        raise ConfigError(str(signature), [problem]) from None
    return seals


def check_files(config: Config) -> None:
    """Raises ConfigError if files were signed and DBC or calibration is not the signed one.

    This is done before either is parsed; the parser checks what it has read once more.
    """
    if not config.sealed:
        return
    for role, path in (("dbc", config.dbc_path), ("calibration", config.calibration_path)):
        if path is None:
            continue
        try:
            check_seal(path, path.read_bytes(), config.sealed[role])
        except OSError as error:
            raise ConfigError(str(path), [f"cannot be read: {error.strerror}"]) from None


def check_digest(config: Config, digest: str) -> None:
    """Raises ConfigError unless this is the digest of the DBC that was signed."""
    if digest != config.sealed["dbc"]:
        raise ConfigError(str(config.dbc_path), ["was changed while it was read; start again"])


def make_keys(private: Path, public: Path) -> None:
    """Write a new key pair as PEM; only its owner may read the private key.

    Raises OSError if one of the files exists.
    """
    key = Ed25519PrivateKey.generate()
    pem = key.private_bytes(Encoding.PEM, PrivateFormat.PKCS8, NoEncryption())
    write_private(private, pem)
    with public.open("xb") as file:
        file.write(key.public_key().public_bytes(Encoding.PEM, PublicFormat.SubjectPublicKeyInfo))


def write_private(path: Path, content: bytes) -> None:
    """Write a new file that only its owner may read. Raises OSError if the file exists."""
    with open(path, "xb", opener=partial(os.open, mode=0o600)) as file:
        file.write(content)
        os.fsync(file.fileno())


def _digest(path: Path) -> str:
    return hashlib.sha256(path.read_bytes()).hexdigest()


def _private_key(path: Path) -> Ed25519PrivateKey:
    _, content = private_file(str(path), Path())
    try:
        key = load_pem_private_key(content, None)
    except TypeError:
        problem = "is encrypted; decrypt it with 'openssl pkey -in .. -out ..' for the signing"
        raise ConfigError(str(path), [problem]) from None
    except (ValueError, UnsupportedAlgorithm):
        key = None
    if not isinstance(key, Ed25519PrivateKey):
        problem = "is no private ed25519 key in PEM; make one with 'traction-gateway keygen'"
        raise ConfigError(str(path), [problem])
    return key


def _public_key(path: Path) -> Ed25519PublicKey:
    try:
        key = load_pem_public_key(path.read_bytes())
    except OSError as error:
        raise ConfigError(str(path), [f"no public key: {error.strerror}"]) from None
    except (ValueError, UnsupportedAlgorithm):
        key = None
    if not isinstance(key, Ed25519PublicKey):
        problem = "is no public ed25519 key in PEM; 'traction-gateway keygen' makes it beside the "
        raise ConfigError(str(path), [problem + "private one"])
    return key
