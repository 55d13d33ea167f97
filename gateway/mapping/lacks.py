"""What a drive's messages and mapped signals lack for each flag, as text."""

from __future__ import annotations

from collections.abc import Collection
from pathlib import Path
from typing import Final

from gateway.mapping.plan import CARRIES, NO_MESSAGE, given
from gateway.settings.config import Config, ConfigError
from gateway.settings.signal_map import VOLTAGES, Signals

NEEDS: Final = (
    ("no phase currents", ("PhaseCurrents", "Samples")),
    ("no voltages", ("StatorVoltages", "Samples")),
    ("no torque or command", ("Status",)),
)
"""(lack, kinds of messages): without any of these kinds, adhesion is never known."""
_TORQUES: Final = ("Torque", "Iq")


def adhesion(kinds: Collection[str], signals: Signals | None = None) -> list[str]:
    """Why adhesion of a drive with these kinds of messages can never be known; empty if it can.

    signals: of a mapped drive. A mapped signal is not missing, even if no message can be made of
    it because others are missing.
    """
    lacks = [text for text, any_of in NEEDS if not set(any_of) & set(kinds)]
    if signals is None:
        return lacks
    use = signals.use.keys()
    mapped = {
        "no voltages": any(form[0] in use for form in VOLTAGES),
        "no torque or command": bool(use & {"TorqueCommand", *_TORQUES}),
    }
    lacks = [text for text in lacks if not mapped.get(text, False)]
    if "Id" in use and not signals.phases:
        lacks = [text.replace("no phase currents", "no electrical angle") for text in lacks]
    return lacks


def thermal(signals: Signals) -> list[str]:
    """Why the thermal model can never judge a mapped drive; empty if it can."""
    use = signals.use.keys()
    return [
        text
        for text, there in (
            ("no temperature", use & set(CARRIES["Temperatures"])),
            ("no RMS current", signals.phases or use & {"Irms", "Id"}),
            ("no measured speed", "Speed" in use),
            ("no torque", use & set(_TORQUES)),
            ("no ambient temperature", "Tambient" in use),
        )
        if not there
    ]


def incomplete(config: Config, dbc: Path, nodes: Collection[int]) -> ConfigError:
    """Error for drives of which no message can be received. dbc: of the configuration."""
    problems = [
        f"{config.signals_path(position, 'use')}: drive {drive.node}: {NO_MESSAGE}"
        for position, drive in enumerate(config.drive)
        if drive.node in nodes and drive.signals is not None and not given(drive.signals)
    ]
    if problems:
        return config.error(problems)
    return ConfigError(str(dbc), [f"no messages of drive {node}" for node in nodes])
