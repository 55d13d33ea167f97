"""Which program, file and configuration: version, commit, SHA-256, TOML. For reports."""

from __future__ import annotations

import hashlib
import json
import subprocess
from importlib import metadata
from pathlib import Path
from typing import NamedTuple

import tomli_w

import gateway
from gateway.settings.config import Config

NAME = "traction-gateway"


class Program(NamedTuple):
    """commit: "" where it is not known; changed: there were changes that are not in it."""

    version: str
    commit: str = ""
    changed: bool = False

    def __str__(self) -> str:
        """As a person says it."""
        where = f", commit {self.commit[:12]}" if self.commit else ""
        return f"{NAME} {self.version}{where}{' with changes' if self.changed else ''}"


def program() -> Program:
    """What runs: from the installation, or from the checkout that this package stands in."""
    version = metadata.version(NAME)
    direct_url = metadata.distribution(NAME).read_text("direct_url.json")
    if direct_url and (commit := json.loads(direct_url).get("vcs_info", {}).get("commit_id")):
        return Program(version, commit)
    root = Path(gateway.__path__[0]).resolve().parent
    if not (root / ".git").exists():
        return Program(version)
    head = _git(root, "rev-parse", "HEAD")
    return Program(version, head, bool(head and _git(root, "status", "--porcelain", "-uno")))


def _git(root: Path, *words: str) -> str:
    """What git says; nothing where there is none, or it does not trust the folder."""
    try:
        done = subprocess.run(
            ["git", "-C", str(root), *words],
            capture_output=True,
            text=True,
            check=False,
            timeout=10,
        )
    except (OSError, subprocess.TimeoutExpired):
        return ""
    return done.stdout.strip() if done.returncode == 0 else ""


def sha256(path: Path) -> str:
    """Of a file, in flat memory. Raises OSError."""
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def as_toml(config: Config) -> str:
    """Every key that has a value, defaults included; `load` of it gives the same configuration."""
    return tomli_w.dumps(config.model_dump(mode="json", exclude_none=True))
