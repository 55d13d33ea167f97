"""Errors of the drives' sensors: noise, offset, gain, range; bias, stuck, lost.

May know: numbers. May not know: bits (quantisation is the codec's), buses, clocks.
"""

from __future__ import annotations

from typing import Final

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


STATOR, DRIVE_END, NON_DRIVE_END, AMBIENT = range(4)
POINTS: Final = 4
PHASES: Final = 3
BEYOND: Final = 1e9

_CURRENT, _TEMPERATURE, _OFFSET = 2, 3, 11
"""Purposes of the random streams: one generator per purpose and drive."""


class CurrentSensors:
    """Three phase currents per drive, measured together.

    Reading = gain x current + offset + noise; beyond `range_a` it is BEYOND with the current's
    sign, a number no message can hold, so that it becomes the saturated end value.
    """

    def __init__(
        self, seed: int, drives: int, noise_var: float, offset_a: float | Array,
        gain: float | Array, range_a: float,
    ) -> None:  # fmt: skip
        """`noise_var` A^2 per phase, white; offset and gain of all phases or (N, 3)."""
        self._rngs = [np.random.default_rng([seed, _CURRENT, d]) for d in range(drives)]
        self._sigma = float(np.sqrt(noise_var))
        self._offset, self._gain, self._range = offset_a, gain, range_a

    def read(self, i_ab: Array) -> Array:
        """(n, N, 2) alpha-beta currents, A -> (n, N, 3) phase readings, A."""
        i_a, i_b = i_ab[..., 0], i_ab[..., 1]
        half = np.sqrt(3.0) / 2.0
        true = np.stack([i_a, -0.5 * i_a + half * i_b, -0.5 * i_a - half * i_b], axis=-1)
        noise = np.stack([r.standard_normal((len(i_ab), PHASES)) for r in self._rngs], axis=1)
        reading = self._gain * true + self._offset + self._sigma * noise
        return np.where(np.abs(reading) > self._range, np.copysign(BEYOND, reading), reading)


class TemperatureSensors:
    """Stator, drive end, non-drive end, ambient per motor: noise and a constant offset each."""

    def __init__(
        self, seed: int, train_seed: int, drives: int, noise_k: float, offset_k: float
    ) -> None:
        """Offsets (one sigma `offset_k`) belong to the train, noise to the run."""
        self._rngs = [np.random.default_rng([seed, _TEMPERATURE, d]) for d in range(drives)]
        draws = [
            np.random.default_rng([train_seed, _OFFSET, d]).standard_normal(POINTS)
            for d in range(drives)
        ]
        self.offset = offset_k * np.clip(np.stack(draws), -2.5, 2.5)
        self._noise = noise_k

    def read(self, true: Array) -> Array:
        """(N, 4) true temperatures, degC -> (N, 4) readings before faults, degC."""
        noise = np.stack([r.standard_normal(POINTS) for r in self._rngs])
        out: Array = true + self.offset + self._noise * noise
        return out


class Hold:
    """Memory of stuck channels: the reading stays what it was when the fault began."""

    def __init__(self, shape: tuple[int, ...]) -> None:
        """`shape` of one set of readings."""
        self.held = np.full(shape, np.nan)

    def apply(self, readings: Array, stuck: NDArray[np.bool_]) -> Array:
        """Readings with the stuck ones replaced; both of the shape given."""
        begins = stuck & np.isnan(self.held)
        self.held = np.where(begins, readings, np.where(stuck, self.held, np.nan))
        return np.where(stuck, self.held, readings)
