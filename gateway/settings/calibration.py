"""Thermal calibration: constants of each motor and its sensors, measured in fault-free runs.

They are in a TOML file that `traction-gateway calibrate` writes and the gateway reads at start.
Without it the thermal flags stay unknown: a limit that was not measured is a guess.
"""

from __future__ import annotations

import hashlib
from collections.abc import Iterator
from pathlib import Path
from typing import Annotated, Any

import numpy as np
from numpy.typing import NDArray
from pydantic import ConfigDict, Field, PrivateAttr, ValidationError

from dbc.text import read_bytes, read_toml, toml_text
from dbc.toml_files import Strict, numbered, within
from dbc.value_errors import wording
from estimators.thermal import model
from estimators.thermal.monitor import OWN_K, RAISE, Coverage, Known
from estimators.thermal.promise import Hours, promise_of
from estimators.tolerance import STORED, Promise
from gateway.settings.config import Config, ConfigError, check_seal
from gateway.settings.sections import Adhesion

POINTS = ("stator", "drive_end", "non_drive_end")
COVERAGE = Coverage._fields
"""Keys of a motor's heat: how consistent its filters were in fault-free runs."""
_FORMATS = {"rates": ".5e", "duty": ".6g"}
ADDED = ("own_k", "held_back_h", "largest_log_odds")
"""Keys of the fleet's heat that older files lack."""
NO_HEAT = (
    "the calibration has no thermal model, so nothing can be promised; leave this key out, or "
    "calibrate with a model"
)
NO_HOURS = (
    "the calibration has no held-back fault-free hours; set this key and run 'traction-gateway "
    "calibrate' with one more log"
)


AGAIN = "run 'traction-gateway calibrate' again"
Kelvin = Annotated[float, within(-300, 300, "K", AGAIN)]
Noise = Annotated[float, within(0, 100, "K", AGAIN)]
Limit = Annotated[float, within(0.01, 100, "K", f"beyond that no fault would be found: {AGAIN}")]
Gain = Annotated[float, within(0.01, 100, "", f"no motor warms like that: {AGAIN}")]
Rate = Annotated[float, within(-1e3, 1e3, "", AGAIN)]
Held = Annotated[float, within(0, 1e7, "s", AGAIN)]
Step = Annotated[float, within(0, 400, "K", AGAIN)]
Duty = Annotated[float, within(-1e9, 1e9, "", AGAIN)]
Share = Annotated[float, within(0, 1, "", AGAIN)]
LogOdds = Annotated[float, within(-100, 100, "", AGAIN)]
Hour = Annotated[int, within(1, 10**7, "h", AGAIN)]
Three = tuple[Kelvin, Kelvin, Kelvin]


class Deferred(Strict):
    """Model that pydantic builds only when a calibration is read; most configurations have none."""

    model_config = ConfigDict(defer_build=True)


class MotorHeat(Deferred):
    """One motor's thermal model, see `estimators.thermal.model` and `monitor.Known`.

    rates: of its lumps, in the order of `model.NAMES`; offset_k: offsets of the sensors; centre_k:
    difference from the other motors in health; noise_k: noise of one-second readings; inflation,
    covered, lag_one, false_share: see `monitor.Coverage` (None: the file is older than these keys,
    or the log was too short to measure them).
    """

    rates: tuple[Rate, ...] = Field(min_length=model.RATES, max_length=model.RATES)
    offset_k: Three
    centre_k: Three
    noise_k: tuple[Noise, Noise, Noise]
    inflation: Annotated[float, within(1, 100, "", AGAIN)] | None = None
    covered: tuple[Share, Share] | None = None
    lag_one: Annotated[float, within(-1, 1, "", AGAIN)] | None = None
    false_share: Share | None = None


class FleetHeat(Deferred):
    """What the motors' models have in common.

    scale: of the disturbances that every motor has; duty: mean speed rad/s, mean squared current
    A^2, cooling and heating K/s of the runs it was learnt from, for which sizes of faults are
    given; own_k: random deviation of a lump, K per root of a minute, measured on held-back data
    (None: the file is older than this key, `monitor.OWN_K` is used); held_back_h,
    largest_log_odds: `Hours` of `promise` (None: calibrated without a stated rate of false alarms).
    """

    scale: Annotated[float, within(1e-6, 1e6, "", AGAIN)]
    duty: tuple[Duty, Duty, Duty, Duty]
    own_k: Annotated[float, within(1e-6, 10, "K", AGAIN)] | None = None
    held_back_h: Hour | None = None
    largest_log_odds: (
        Annotated[tuple[LogOdds, ...], Field(min_length=1, max_length=STORED)] | None
    ) = None


class MotorCalibration(Deferred):
    """One motor: how it differs from the fleet in health, and how its sensors behave.

    A healthy reading is offset + gain x the fleet's mean. The offset comes from the sensor and its
    place, the gain from the cooling (3 % less air makes 3 % more rise, whatever the duty).
    """

    node: Annotated[int, within(1, 16, "", "the n of Drive{n}_Temperatures")]
    gain: tuple[Gain, Gain, Gain]
    offset_k: Three
    longest_hold_s: tuple[Held, Held, Held]
    largest_step_k: tuple[Step, Step, Step]
    heat: MotorHeat | None = None


class Calibration(Deferred):
    """The fleet: MAISD limits of each point and the centring of each motor.

    window_s: averaging window with which the limits were measured.
    maisd_limit_k, deviation_limit_k: (stator, drive end, non-drive end).
    """

    window_s: Annotated[
        float, within(0.1, 3600, "s", "use [thermal] window_s of the configuration")
    ]
    maisd_limit_k: tuple[Limit, Limit, Limit]
    deviation_limit_k: tuple[Limit, Limit, Limit]
    motor: tuple[MotorCalibration, ...]
    heat: FleetHeat | None = None
    _promise: Promise | None = PrivateAttr(None)

    @property
    def promise(self) -> Promise | None:
        """Promise for the thermal model's alarms; None where no rate is stated."""
        return self._promise

    def promising(self, rate: float) -> Calibration:
        """Return a copy with the limit for `rate` false alarms in 1000 h.

        Raises ConfigError without a thermal model, or without held-back hours.
        """
        heat = self.heat
        if heat is None:
            raise ConfigError("thermal.false_alarms_per_1000_h", [NO_HEAT])
        if heat.held_back_h is None or heat.largest_log_odds is None:
            raise ConfigError("thermal.false_alarms_per_1000_h", [NO_HOURS])
        out = self.model_copy()
        hours = Hours(heat.held_back_h, heat.largest_log_odds)
        out._promise = promise_of(hours, rate)  # noqa: SLF001 (a copy of our own)
        return out

    def checksum(self) -> str:
        """SHA-256 of everything that was learnt; part of the configuration's hash on the bus."""
        # A key that a file lacks because it is older than the key is left out of its checksum.
        older: dict[str, Any] = {}
        if self.heat is not None:
            older["heat"] = {key for key in ADDED if getattr(self.heat, key) is None}
        older["motor"] = {
            k: {"heat": set(COVERAGE)}
            for k, motor in enumerate(self.motor)
            if motor.heat is not None and motor.heat.inflation is None
        }
        text = self.model_dump_json(exclude=older)
        return hashlib.sha256(text.encode()).hexdigest()

    def known(self, nodes: tuple[int, ...]) -> Known | None:
        """Constants of the thermal model, in the order of `nodes`; None if the logs gave none."""
        table = {m.node: m.heat for m in self.motor}
        cells = [table[n] for n in nodes]
        own = [cell for cell in cells if cell is not None]
        if self.heat is None or len(own) < len(cells):
            return None
        return Known(
            parameters=np.array([[*cell.rates, *cell.offset_k] for cell in own]),
            centre=np.array([cell.centre_k for cell in own]),
            noise=np.array([cell.noise_k for cell in own]),
            scale=self.heat.scale,
            duty=np.array(self.heat.duty),
            own_k=OWN_K if self.heat.own_k is None else self.heat.own_k,
            raise_probability=RAISE if self._promise is None else self._promise.limit,
            coverage=Coverage(
                np.array([cell.inflation or 1.0 for cell in own]),
                np.array([cell.covered or (np.nan, np.nan) for cell in own]),
                np.array([np.nan if cell.lag_one is None else cell.lag_one for cell in own]),
                np.array([cell.false_share or 0.0 for cell in own]),
            ),
        )

    def centring(self, nodes: tuple[int, ...]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Gains and offsets, each (M, 3), in the order of `nodes`; KeyError for unknown nodes."""
        table = {m.node: m for m in self.motor}
        cells = [table[n] for n in nodes]
        return np.array([c.gain for c in cells]), np.array([c.offset_k for c in cells])


def of(config: Config) -> Calibration | None:
    """Load the calibration of a configuration, if any. Raises ConfigError with every problem."""
    path = config.calibration_path
    if path is None:
        return None
    with config.naming("thermal.calibration", path):
        out = load(path, config.nodes, config.thermal.window_s, config.sealed.get("calibration"))
    rate = config.thermal.false_alarms_per_1000_h
    return out if rate is None else out.promising(rate)


def promise_lines(cells: Calibration | None, adhesion: Adhesion | None = None) -> list[str]:
    """Lines that state the promised rates of false alarms; empty where no rate is stated."""
    stated = {
        "adhesion": adhesion.promise if adhesion else None,
        "thermal": cells.promise if cells else None,
    }
    return [f"{name}: {promise}" for name, promise in stated.items() if promise is not None]


def config_hash(config: Config, dbc: str, cells: Calibration | None) -> int:
    """Hash of configuration, DBC (`dbc` is its digest) and calibration, 24 bits: `ConfigHash`.

    It covers the foreign DBCs from which drives' signals are mapped.
    """
    mapped = [config.base / d.signals.dbc for d in config.drive if d.signals is not None]
    theirs = "".join(hashlib.sha256(path.read_bytes()).hexdigest() for path in mapped)
    return config.hash24(dbc + theirs, cells.checksum() if cells else "")


def problems_of(error: ValidationError) -> list[str]:
    """One line for each value that is not valid."""
    return [f"{'.'.join(map(str, item['loc']))}: {wording(item)}" for item in error.errors()]


def load(
    path: Path, nodes: tuple[int, ...], window_s: float, sealed: str | None = None
) -> Calibration:
    """Read a calibration and compare it with the configured drives.

    sealed: SHA-256 from the signature; a file with another SHA-256 is not even parsed. Raises
    ConfigError with every problem.
    """
    try:
        content = read_bytes(path)
        if sealed is not None:
            check_seal(path, content, sealed)
        text = toml_text(content)
        table = read_toml(text)
        stored = table.pop("checksum", None)
        calibration = Calibration.model_validate(table)
    except FileNotFoundError:
        problem = "no such file; make one with 'traction-gateway calibrate LOG -o FILE'"
        raise ConfigError(str(path), [problem]) from None
    except ValidationError as error:
        raise ConfigError(str(path), numbered(problems_of(error), text)) from None
    except (OSError, ValueError) as error:
        # ValueError: not UTF-8, not TOML, or a NUL in the file name.
        raise ConfigError(str(path), [f"cannot be read as TOML: {error}"]) from None
    known = {m.node for m in calibration.motor}
    problems = []
    if stored != calibration.checksum():
        problem = "checksum: the file was changed after 'traction-gateway calibrate'; run it again"
        problems.append(problem)
    problems += [
        f"motor: node {n} is configured but not calibrated; add a log with this node"
        for n in nodes
        if n not in known
    ]
    if abs(calibration.window_s - window_s) > 1e-9:
        problems.append(
            f"window_s: calibrated for {calibration.window_s} s, configured {window_s} s; "
            "set the calibrated window_s, or calibrate again"
        )
    if problems:
        raise ConfigError(str(path), numbered(problems, text))
    return calibration


def _keys(table: Deferred) -> Iterator[str]:
    """Yield the lines of a table's own keys, without those of the tables in it."""
    for name in type(table).model_fields:
        value = getattr(table, name)
        if name in ("motor", "heat") or value is None:
            continue
        if isinstance(value, tuple):
            value = "[" + ", ".join(f"{v:{_FORMATS.get(name, '.3f')}}" for v in value) + "]"
        elif name in COVERAGE:
            value = f"{value:.3f}"
        yield f"{name} = {value}"


def to_toml(calibration: Calibration) -> str:
    """Text of the file, with a checksum over the numbers as they are written in it."""
    tables: list[tuple[str, Deferred | None]] = [("\n[heat]", calibration.heat)]
    for motor in calibration.motor:
        tables += [("\n[[motor]]", motor), ("[motor.heat]", motor.heat)]
    lines = list(_keys(calibration))
    for title, table in tables:
        lines += [] if table is None else [title, *_keys(table)]
    body = "\n".join(lines) + "\n"
    # A checksum of the rounded numbers, because those will be read.
    checksum = Calibration.model_validate(read_toml(body)).checksum()
    return (
        "# Thermal calibration from fault-free data; written by 'traction-gateway calibrate'.\n"
        "# Order of points: stator, drive end, non-drive end.\n"
        f'checksum = "{checksum}"\n{body}'
    )
