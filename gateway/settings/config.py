"""Configuration: TOML, read once and validated as a whole; every problem has its path and cure.

May know: file names and numbers. May not know: buses, clocks, the DBC's contents.
"""

from __future__ import annotations

import hashlib
import re
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any, Final, Self

from pydantic import Field, ValidationError, model_validator

from dbc.text import InputError, TomlError, near, printable, read_bytes, read_toml, toml_text
from dbc.toml_files import Strict, did_you_mean, lines_of, numbered
from dbc.value_errors import wording
from gateway.settings.motors import BENCH_MOTOR, TRACTION_350KW, Motor
from gateway.settings.sections import (
    Adhesion,
    Authentication,
    Bus,
    Canopen,
    Dbc,
    Drive,
    Estimator,
    Loop,
    Thermal,
)
from gateway.settings.signal_map import share

__all__ = ["BENCH_MOTOR", "TRACTION_350KW", "Config", "ConfigError", "Motor", "load", "parse"]

BUILTIN_DBC = {"traction.dbc", "traction_fd.dbc"}


class ConfigError(InputError):
    """The configuration cannot be used. `problems` lists all of them, one line each."""

    def __init__(self, source: str, problems: list[str]) -> None:
        """Keep the list; the exception's text joins all problems."""
        self.problems = [printable(problem) for problem in problems]
        super().__init__(f"{source}: " + "; ".join(self.problems))


class Config(Strict):
    """The whole configuration, immutable."""

    bus: Bus = Bus()
    loop: Loop = Loop()
    dbc: Dbc = Dbc()
    drive: tuple[Drive, ...] = tuple(Drive(node=n) for n in (1, 2, 3))
    motor: dict[str, Motor] = Field(default_factory=dict)
    estimator: Estimator = Estimator()
    adhesion: Adhesion = Adhesion()
    thermal: Thermal = Thermal()
    canopen: Canopen = Canopen()
    authentication: Authentication | None = None
    base: Path = Field(Path(), exclude=True)
    sealed: dict[str, str] = Field(default_factory=dict, exclude=True)
    """SHA-256 of the signed files, by name: dbc, calibration. Empty: unsigned."""
    source: str = Field("configuration", exclude=True)
    """Name of the file; with `text`, its content, used in messages."""
    shared_signals: dict[int, str] = Field(default_factory=dict, exclude=True)
    """By position of a drive, the name of the `[inverter.NAME]` whose signals it has."""
    text: str = Field("", exclude=True)

    @model_validator(mode="after")
    def _consistent(self) -> Self:
        problems = []
        nodes = [d.node for d in self.drive]
        if not nodes:
            problems.append("drive: at least one [[drive]] is needed")
        problems += [
            f"drive: node {node} is used twice; give each drive its own node"
            for node in sorted({n for n in nodes if nodes.count(n) > 1})
        ]
        for position, drive in enumerate(self.drive):
            if drive.motor not in self.motors:
                problems.append(
                    f"drive.{position}.motor: no [motor.{drive.motor}]; "
                    f"known: {', '.join(sorted(self.motors))}{near(drive.motor, self.motors)}"
                )
        if self.adhesion.observe != "torque" and "paper_vb" not in self.adhesion.detector:
            problems.append(
                f"adhesion.observe: detector {self.adhesion.detector!r} compares torque only; "
                "'speed' and 'both' need detector = 'paper_vb' or 'paper_vb_reuse'"
            )
        for key in ("tolerance", "reuse"):
            if getattr(self.adhesion, key) and "paper_vb" not in self.adhesion.detector:
                problems.append(
                    f"adhesion.{key}: detector {self.adhesion.detector!r} has no such key; "
                    "leave it at 0, "
                    "or use detector = 'paper_vb'"
                )
        stated = [self.adhesion.false_alarms_per_1000_h, self.adhesion.fault_free]
        if (stated[0] is None) != (stated[1] is None):
            problems.append(
                "adhesion.false_alarms_per_1000_h: needs fault_free, and fault_free needs it; "
                "`traction-gateway calibrate --adhesion LOG..` prints fault_free"
            )
        if self.thermal.false_alarms_per_1000_h is not None and self.thermal.method != "model":
            problems.append(
                "thermal.false_alarms_per_1000_h: method 'maisd' has no such limit; leave it out, "
                "or use method = 'model'"
            )
        if self.bus.on_intruder == "tell" and self.authentication is None:
            problems.append(
                "bus.on_intruder: 'tell' needs [authentication]: without it no receiver can tell "
                "the gateway's flags from an intruder's"
            )
        if problems:
            raise ValueError("\n".join(problems))
        return self

    def all_of(self, *steps: Callable[[], Any]) -> list[Any]:
        """Results of independent steps. Raises the error of one, or one with those of several."""
        results, errors = [], []
        for step in steps:
            try:
                results.append(step())
            except InputError as error:
                errors.append(error)
        if len(errors) == 1:
            raise errors[0]
        if errors:
            raise ConfigError(self.source, [" ".join(str(error).split()) for error in errors])
        return results

    def error(self, problems: list[str]) -> ConfigError:
        """Return an error with these problems and the lines of the file where they are."""
        return ConfigError(self.source, numbered(dict.fromkeys(problems), self.text))

    @contextmanager
    def naming(self, key: str, path: Path) -> Iterator[None]:
        """Name the key, and its line, of a file that does not exist."""
        try:
            yield
        except InputError as error:
            if path.exists():
                raise
            raise self.error([" ".join([f"{key}:", *str(error).split()])]) from None

    def signals_path(self, position: int, key: str = "") -> str:
        """Path of the drive's signals in the file, or of a key of them; position: of the drive."""
        path = f"drive.{position}.signals"
        if position in self.shared_signals:
            own = f"drive.{position}.{key}"
            if key and tuple(own.split(".")) in lines_of(self.text):
                return own
            path = f"inverter.{self.shared_signals[position]}"
        return f"{path}.{key}" if key else path

    @property
    def on_intruder(self) -> str:
        """Reaction to another node that sends our identifiers.

        With authentication receivers reject forged frames; if the flags became unknown as well,
        one forged frame would be enough to blind the receivers.
        """
        return self.bus.on_intruder or ("tell" if self.authentication else "unknown")

    @property
    def motors(self) -> dict[str, Motor]:
        """All motors by name; the built-in ones are always there unless redefined."""
        return {"bench": BENCH_MOTOR, "traction_350kw": TRACTION_350KW, **self.motor}

    def unmapped(self) -> Config:
        """The same drives, as if they spoke our message set: only such drives can be simulated."""
        if all(drive.signals is None for drive in self.drive):
            return self
        drives = tuple(drive.model_copy(update={"signals": None}) for drive in self.drive)
        return self.model_copy(update={"drive": drives})

    @property
    def nodes(self) -> tuple[int, ...]:
        """Node numbers of the configured drives, in configuration order."""
        return tuple(d.node for d in self.drive)

    @property
    def dbc_path(self) -> Path:
        """Path of the DBC: beside the configuration, else the shipped file of that name."""
        beside = self.base / self.dbc.file
        if self.dbc.file in BUILTIN_DBC and not beside.is_file():
            return shipped_dbc(self.dbc.file)
        return beside

    @property
    def calibration_path(self) -> Path | None:
        """Path of the thermal calibration, relative to the configuration; None without one."""
        return self.base / self.thermal.calibration if self.thermal.calibration else None

    def hash24(self, dbc: str = "", calibration: str = "") -> int:
        """Hash of this configuration, 24 bits, as sent on the bus (`Gateway_Info.ConfigHash`).

        dbc: digest of the DBC file; calibration: checksum of the thermal one, if there is any.
        """
        digest = hashlib.sha256((self.model_dump_json() + dbc + calibration).encode()).digest()
        return int.from_bytes(digest[:3], "little")


def shipped_dbc(name: str) -> Path:
    """Path of a DBC that ships with the package."""
    return Path(__file__).parents[2] / "dbc" / name


_KEY: Final = re.compile(r"[A-Za-z]\w*: ")


def _lines(error: ValidationError, shared: Mapping[int, str]) -> list[str]:
    """One line per problem: path, what is wrong, what was given.

    shared: by position of a drive, the name of the inverter whose signals it has.
    """
    lines = []
    for item in error.errors():
        loc = item["loc"]
        if loc[:1] == ("drive",) and loc[2:3] == ("signals",) and loc[1] in shared:
            loc = ("inverter", shared[int(loc[1])], *loc[3:])
        path = ".".join(str(p) for p in loc)
        text = wording(item)
        if item["type"] == "extra_forbidden":
            meant = did_you_mean(Config, item["loc"])
            text = f"unknown key{meant or '; remove it or correct its name'}"
        for part in text.split("\n"):
            # A model's own message starts with a key, or concerns the model as a whole.
            joint = "." if _KEY.match(part) else ": "
            lines.append(f"{path}{joint}{part}" if path else part)
    return list(dict.fromkeys(lines))


def parse(
    raw: dict[str, Any], source: str = "configuration", base: Path = Path(), text: str = ""
) -> Config:
    """Validate a parsed TOML document. Raises ConfigError with every problem.

    text: the TOML that was parsed, to find the lines of the problems.
    """
    document, shared, problems = share(raw)
    try:
        own = {"base": base, "source": source, "text": text, "shared_signals": shared}
        config = Config.model_validate({**document, **own})
    except ValidationError as error:
        raise ConfigError(source, numbered(problems + _lines(error, shared), text)) from None
    if problems:
        raise ConfigError(source, numbered(problems, text))
    return config


def check_seal(path: Path, content: bytes, sealed: str) -> None:
    """Raise ConfigError unless the content has the SHA-256 of the signed file."""
    if hashlib.sha256(content).hexdigest() != sealed:
        raise ConfigError(
            str(path),
            ["is not the file that was signed; restore that one, or sign again after a review"],
        )


def load(
    path: Path | None, sealed: dict[str, str] | None = None, **changes: dict[str, Any]
) -> Config:
    """Read and validate a file; None gives the default: three drives on nodes 1-3.

    sealed: SHA-256 of the signed files, by name; this file, `config`, is not even parsed if its
    SHA-256 differs. changes: keys that override the file's, as `section={"key": value}`.
    """
    config = parse(changes, "options")  # so that no file is named for a wrong option
    if path is None:
        return config
    try:
        content = read_bytes(path)
        if sealed is not None:
            check_seal(path, content, sealed["config"])
        text = toml_text(content)
        raw = read_toml(text)
    except FileNotFoundError:
        raise ConfigError(str(path), ["no such file"]) from None
    except OSError as error:
        raise ConfigError(str(path), [f"cannot be read: {error.strerror}"]) from None
    except TomlError as error:
        dbc = "; this is a DBC: name a configuration, see `traction-gateway init --dbc FILE`"
        cure = dbc if path.suffix.lower() == ".dbc" else ""
        raise ConfigError(str(path), [f"cannot be read as TOML: {error}{cure}"]) from None
    inner = [key for key in ("base", "sealed", "source", "text", "shared_signals") if key in raw]
    if inner:
        problems = [f"{key}: unknown key; remove it or correct its name" for key in inner]
        raise ConfigError(str(path), numbered(problems, text))
    for section, keys in changes.items():
        if isinstance(raw.get(section, {}), dict):
            raw[section] = {**raw.get(section, {}), **keys}
    config = parse(raw, str(path), path.parent, text)
    return config if sealed is None else config.model_copy(update={"sealed": sealed})
