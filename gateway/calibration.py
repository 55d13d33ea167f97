"""Thermal calibration: what fault-free data says about each motor's sensors.

A TOML file, written by `traction-gateway calibrate`, read at start. Without it the thermal
flags stay unknown: a limit that was not measured is a guess.
"""

from __future__ import annotations

import tomllib
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, ValidationError

from gateway.config import ConfigError, Strict

POINTS = ("stator", "drive_end", "non_drive_end")


class MotorCalibration(Strict):
    """One motor: how it differs from the fleet in health, and how its sensors behave.

    A healthy reading is offset + gain x the fleet's mean: the offset is the sensor's and the
    place's, the gain the cooling's (3 % less air is 3 % more rise, whatever the duty).
    """

    node: int = Field(ge=1, le=16)
    gain: tuple[float, float, float]
    offset_k: tuple[float, float, float]
    longest_hold_s: tuple[float, float, float]
    largest_step_k: tuple[float, float, float]


class Calibration(Strict):
    """The fleet: MAISD limits per point and every motor's centring.

    window_s: averaging window the limits were measured with.
    maisd_limit_k, deviation_limit_k: (stator, drive end, non-drive end).
    """

    window_s: float = Field(gt=0)
    maisd_limit_k: tuple[float, float, float]
    deviation_limit_k: tuple[float, float, float]
    motor: tuple[MotorCalibration, ...]

    def centring(self, nodes: tuple[int, ...]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Gains and offsets, each (M, 3), in the order of `nodes`. KeyError for an unknown node."""
        table = {m.node: m for m in self.motor}
        cells = [table[n] for n in nodes]
        return np.array([c.gain for c in cells]), np.array([c.offset_k for c in cells])


def load(path: Path, nodes: tuple[int, ...], window_s: float) -> Calibration:
    """Read and compare with the configured drives. Raises ConfigError with every problem."""
    try:
        calibration = Calibration.model_validate(tomllib.loads(path.read_text(encoding="utf-8")))
    except FileNotFoundError:
        problem = "no such file; make one with 'traction-gateway calibrate LOG -o FILE'"
        raise ConfigError(str(path), [problem]) from None
    except (OSError, UnicodeDecodeError, tomllib.TOMLDecodeError) as error:
        raise ConfigError(str(path), [f"cannot be read as TOML: {error}"]) from None
    except ValidationError as error:
        lines = [f"{'.'.join(str(p) for p in e['loc'])}: {e['msg']}" for e in error.errors()]
        raise ConfigError(str(path), lines) from None
    known = {m.node for m in calibration.motor}
    problems = [
        f"motor: node {n} is configured but not calibrated; calibrate with a log that has it"
        for n in nodes
        if n not in known
    ]
    if abs(calibration.window_s - window_s) > 1e-9:
        problems.append(
            f"window_s: measured with {calibration.window_s} s, configured {window_s} s; "
            "limits hold for one window only"
        )
    if problems:
        raise ConfigError(str(path), problems)
    return calibration


def to_toml(calibration: Calibration) -> str:
    """Text of the file; numbers rounded to a thousandth (sensors resolve a tenth)."""

    def numbers(values: tuple[float, ...]) -> str:
        return "[" + ", ".join(f"{v:.3f}" for v in values) + "]"

    lines = [
        "# Thermal calibration from fault-free data; written by 'traction-gateway calibrate'.",
        "# Order of points: stator, drive end, non-drive end.",
        f"window_s = {calibration.window_s}",
        f"maisd_limit_k = {numbers(calibration.maisd_limit_k)}",
        f"deviation_limit_k = {numbers(calibration.deviation_limit_k)}",
    ]
    for motor in calibration.motor:
        lines += [
            "",
            "[[motor]]",
            f"node = {motor.node}",
            f"gain = {numbers(motor.gain)}",
            f"offset_k = {numbers(motor.offset_k)}",
            f"longest_hold_s = {numbers(motor.longest_hold_s)}",
            f"largest_step_k = {numbers(motor.largest_step_k)}",
        ]
    return "\n".join(lines) + "\n"
