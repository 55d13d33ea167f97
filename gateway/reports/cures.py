"""What to do about a flag that was never known, by the reason why."""

from __future__ import annotations

import shlex
from collections.abc import Sequence
from pathlib import Path

from gateway.core.codes import Reason
from gateway.mapping import lacks
from gateway.reports.record import camel
from gateway.settings.config import Config
from gateway.settings.sections import FEWEST_COMPARED


def check_of(config: Path | None, log: Path, line: str | None) -> str:
    """The command that compares a configuration with a log, to be copied."""
    words = ["traction-gateway", "check", str(config or "CONFIG"), "--log", str(log)]
    return shlex.join(words + ([] if line is None else ["--line", line]))


def cure(
    flag: str, reasons: Sequence[Reason], config: Config, nodes: Sequence[int], check: str = ""
) -> tuple[str, str]:
    """For a flag of these drives that was never known: level of the message, and what to do.

    check: command that compares the configuration with the log, see `check_of`.
    """
    if flag == "thermal":
        return "note", _thermal_cure(reasons, config, nodes)
    if Reason.CONFIG in reasons:
        return "warning", (f"a drive lacks signals for this flag: `{check}` names them")
    wrong = f"wrong channel, DBC or motor? run `{check}`"
    return "warning", f"{wrong}, or see {_explained(reasons)}"


def _thermal_cure(reasons: Sequence[Reason], config: Config, nodes: Sequence[int]) -> str:
    thermal = config.thermal
    if thermal.method == "maisd" and len(config.nodes) < FEWEST_COMPARED:
        return "method 'maisd' compares the motors of two drives or more"
    signals = [drive.signals for drive in config.drive if drive.node in nodes]
    absent = {text for one in signals if one is not None for text in lacks.thermal(one)}
    if thermal.method == "model" and absent:
        return f"method 'model' cannot judge a mapped drive: {', '.join(sorted(absent))}"
    limits = "make limits with `traction-gateway calibrate`"
    if Reason.CONFIG in reasons:
        return f"{limits}, or see `traction-gateway explain config`"
    return f"see {_explained(reasons)}" + ("" if thermal.calibration else f"; then {limits}")


def _explained(reasons: Sequence[Reason]) -> str:
    return ", ".join(f"`traction-gateway explain {camel(reason.name)}`" for reason in reasons)
