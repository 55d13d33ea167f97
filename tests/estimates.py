"""A bank of filters in tests: stepped with sound inputs, its findings as objects."""

from typing import NamedTuple

import numpy as np

from gateway.core import inputs
from gateway.core.codes import Health, Reason
from tests.receivers import Received


class DriveEstimate(NamedTuple):
    """One drive after a tick; numbers are None while nothing is tracked."""

    health: Health
    speed_rad_s: float | None = None
    load_nm: float | None = None
    load_sigma_nm: float | None = None
    nis: float | None = None
    reason: Reason = Reason.STARTING
    """Why, where it is not tracking."""


def estimates_of(told):
    """What is told of every drive."""
    rows = zip(
        told.health.tolist(), told.speed.tolist(), told.load.tolist(), told.sigma.tolist(),
        told.nis.tolist(), told.reason.tolist(), strict=True,
    )  # fmt: skip
    return [
        DriveEstimate(Health(health), reason=Reason(reason))
        if np.isnan(speed)
        else DriveEstimate(Health(health), speed, load, sigma, nis)
        for health, speed, load, sigma, nis, reason in rows
    ]


def step(bank, samples, heard, now):
    """One tick; heard: which drives' newest sample is within its limit."""
    m, come = len(samples.drive), inputs.statuses(len(heard))
    come["reason"], come["sample_fresh"] = Reason.NONE, heard
    box = Received(len(heard), rows=m // 8 + 1)
    for mine, given in zip(box.samples, samples, strict=True):
        mine[:m] = given
    box.pointer.tick.samples = m
    bank.reserve(m)
    bank.run(box.pointer, come, now)
    return estimates_of(bank.told)
