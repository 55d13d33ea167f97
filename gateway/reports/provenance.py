"""Provenance of a report: program version and commit, SHA-256 of files, configuration as TOML."""

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
    """Version of the program; commit: "" if unknown; changed: with uncommitted changes."""

    version: str
    commit: str = ""
    changed: bool = False

    def __str__(self) -> str:
        """Name, version and commit in one line."""
        where = f", commit {self.commit[:12]}" if self.commit else ""
        return f"{NAME} {self.version}{where}{' with changes' if self.changed else ''}"


def program() -> Program:
    """The running program, from the data of its installation or from its git checkout."""
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
    """Output of git; empty without git, or if git rejects the folder."""
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
    """SHA-256 of a file, with constant memory. Raises OSError."""
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def as_toml(config: Config) -> str:
    """TOML of all keys with a value, defaults included; `load` returns the same configuration."""
    return tomli_w.dumps(config.model_dump(mode="json", exclude_none=True))
