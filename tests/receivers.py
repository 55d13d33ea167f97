"""A `struct receiver` in tests, with just what the stations behind it read."""

import math

import numpy as np
from _traction_core import ffi

from dbc.records import CHANNEL, RECEIVER
from gateway.core.receiving import drive_inputs
from tests.sample_rows import readings, workspace


class Received:
    """Of N drives: their channels, what they have sent, readings and samples of a tick."""

    def __init__(self, drives, channels=0, rows=64):
        self.channels, self.drives = np.zeros(channels, CHANNEL), drive_inputs(drives)
        self.samples, self.readings = workspace(rows), readings(rows)
        self.before = np.zeros_like(self.samples.gap)
        self.record = np.zeros(1, RECEIVER)
        self.record["channel_count"], self.record["drive_count"] = channels, drives
        arrays = {
            "channels": self.channels, "drives": self.drives, "sample_before": self.before,
            **{f"sample_{name}": each for name, each in self.samples._asdict().items()},
            **{f"motion_{name}": each for name, each in self.readings._asdict().items()},
        }  # fmt: skip
        for name, array in arrays.items():
            self.record[name] = array.ctypes.data
        self.pointer = ffi.from_buffer("struct receiver *", self.record)

    def tick(self, motions=(), samples=()):
        """Rows of the next tick.

        motions: drive, stamp, speed, torque and, if it is sent, angle; samples: drive, (u alpha,
        u beta), (i alpha, i beta), steps, gap.
        """
        for k, row in enumerate(motions):
            for column, value in zip(self.readings, (*row, math.nan), strict=False):
                column[k] = value
        for k, row in enumerate(samples):
            for column, value in zip(self.samples, row, strict=True):
                column[k] = value
        self.pointer.tick.motions = len(motions)
        self.note_samples(len(samples))

    def note_samples(self, count):
        """So many rows of samples are there: which of them are those of one drive."""
        self.pointer.tick.samples = count
        newest = self.drives["newest_sample"]
        newest[:] = -1
        for row, drive in enumerate(self.samples.drive[:count].tolist()):
            self.before[row], newest[drive] = newest[drive], row
