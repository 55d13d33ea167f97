"""Current sensors of one drive in Python, to compare `current_calibration.c` with."""

from __future__ import annotations

import math
from typing import Final

import numpy as np

TURN: Final = 2.0 * math.pi
IMPLAUSIBLE: Final = 1e5
OFFSET_MAX: Final = 0.05
IMAGE_MAX: Final = 0.08


class Sensors:
    """Offset and image of one drive, from whole revolutions in pairs; and a line from a circle."""

    def __init__(self, I_rated: float) -> None:
        """I_rated: A."""
        self.I_rated = I_rated
        self.offset = self.image = self.offset_applied = self.image_applied = 0j
        self.turns, self.mean_square = 0, 0.0
        self.line, self.seen, self.step_s, self.single_axis = 0j, 0.0, 0.0, False
        self.angles: list[tuple[float, complex]] = []
        """Of the revolution under way: angle, rad, and current."""
        self.before = np.zeros(3, dtype=complex)

    def add(self, z: complex, tau: float, gap: float, w: float | None) -> complex:
        """The current z made even. tau, gap: s; w: electrical speed, rad/s, None if unknown."""
        near = min(tau / 0.05, 1.0)
        self.offset_applied += near * (self.offset - self.offset_applied)
        self.image_applied += near * (self.image - self.image_applied)
        n, centred = complex(self.image_applied), complex(z - self.offset_applied)
        plausible = abs(z.real) + abs(z.imag) < IMPLAUSIBLE
        if plausible:
            self._ellipticity(z, tau + gap)
        step = abs(w) * tau if w is not None and plausible and gap == 0.0 else 0.0
        if 0.0 < step <= 0.63:
            self._learn(z, step)
        else:
            self.angles, self.mean_square = [], 0.0
        return (centred - n * centred.conjugate()) / (1.0 - abs(n) ** 2)

    def _ellipticity(self, z: complex, passed: float) -> None:
        near, whole = min(passed / 0.012, 1.0), max(abs(z), 0.1 * self.I_rated) ** 2
        self.line += near * (z**2 / whole - self.line)
        self.seen += near * (abs(z) ** 2 / whole - self.seen)
        self.step_s = passed

    def _learn(self, z: complex, step: float) -> None:
        left = TURN - sum(angle for angle, _ in self.angles)
        self.angles.append((min(step, left), z))
        if step >= left:
            self._finish()
            self.angles = [(step - left, z)]

    def _finish(self) -> None:
        angle, z = (np.array(column) for column in zip(*self.angles, strict=True))
        ramp = (np.cumsum(angle) - 0.5 * angle) / TURN
        powers = np.stack([z, z**2, np.abs(z) ** 2])
        uniform, rising = powers @ angle, powers @ (ramp * angle)
        first, second, square = (self.before + uniform - rising) / TURN
        self.before = rising
        last, self.mean_square = self.mean_square, uniform[2].real / TURN
        alike = abs(self.mean_square - last) <= 0.1 * last
        if self.mean_square < (0.2 * self.I_rated) ** 2 or not alike:
            return
        variance = square.real - abs(first) ** 2
        if variance <= 0.5 * square.real:
            return
        image = 0.5 * (second - first**2) / variance
        if abs(first) <= OFFSET_MAX * self.I_rated and abs(image) <= IMAGE_MAX:
            self.turns = min(self.turns + 1, 16)
            self.offset += (first - self.offset) / self.turns
            self.image += (image - self.image) / self.turns

    def is_single_axis(self, w: float) -> bool:
        """Does the current swing on one line; w: electrical speed, rad/s."""
        if 3.0 / 0.012 <= abs(w) <= 2.5 / max(self.step_s, 1e-9) and self.seen >= 0.75:
            self.single_axis = abs(self.line) > (0.3 if self.single_axis else 0.5) * self.seen
        return self.single_axis
