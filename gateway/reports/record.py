"""What a run leaves behind: `flags.csv`, `estimates.csv`, and when flags changed."""

from __future__ import annotations

import csv
from contextlib import ExitStack
from pathlib import Path
from types import TracebackType
from typing import Self

from gateway.core.codes import FaultClass, Flag, Health, Reason
from gateway.core.view import DriveView, GatewayView
from gateway.io.whole_file import whole

ADHESION = {Flag.UNKNOWN: "Unknown", Flag.GOOD: "Adhering", Flag.BAD: "AdhesionLost"}
FAULT = {Flag.UNKNOWN: "Unknown", Flag.GOOD: "NoFault", Flag.BAD: "Fault"}
FLAGS, ESTIMATES = "flags.csv", "estimates.csv"
FLAGS_HEADER = ("t_s", "drive", "adhesion", "thermal", "reason")
ESTIMATES_HEADER = (
    "t_s", "drive", "health", "speed_rad_s", "load_nm", "load_sigma_nm", "loss_probability",
    "nis", "fault_class", "mixed_c", "maisd_k", "degradation_k_h", "degradation_sigma_k_h",
    "hours_to_limit",
)  # fmt: skip

DIGITS = (0, 4, 4, 4, 4, 3, 0, 2, 3, 4, 4, 1)
"""After the point, of the columns behind the drive."""


def camel(name: str) -> str:
    """`NOT_AVAILABLE` as the DBC writes it: `NotAvailable`."""
    return "".join(part.capitalize() for part in name.split("_"))


class Recorder:
    """Collects views tick by tick; writes both tables while it goes. Context manager.

    The tables get their names when it is left; after an exception there are none.
    """

    def __init__(self, folder: Path | None) -> None:
        """folder: where the tables go, None for none."""
        self.changes: list[tuple[int, int, str, str]] = []
        self._last: dict[int, tuple[Flag, Flag]] = {}
        self._files = ExitStack()
        self._flags = self._estimates = None
        if folder is not None:
            parts = [self._files.enter_context(whole(folder / n)) for n in (FLAGS, ESTIMATES)]
            self._flags, self._estimates = (
                csv.writer(
                    self._files.enter_context(part.open("w", newline="", encoding="utf-8")),
                    lineterminator="\n",
                )
                for part in parts
            )
            self._flags.writerow(FLAGS_HEADER)
            self._estimates.writerow(ESTIMATES_HEADER)

    def add(self, view: GatewayView) -> None:
        """Take one tick."""
        for d in view.drives:
            flags = d.adhesion, d.thermal
            if self._last.get(d.node) != flags:
                self._change(view.t_ns, d)
                self._last[d.node] = flags
            if self._flags is None or self._estimates is None:
                continue
            t_s = f"{view.t_ns // 1_000_000_000}.{view.t_ns % 1_000_000_000:09d}"
            self._flags.writerow((t_s, d.node, *flag_words(d)))
            numbers = map(_text, estimated(d), DIGITS)
            self._estimates.writerow((t_s, d.node, *numbers))

    def _change(self, t_ns: int, drive: DriveView) -> None:
        adhesion, thermal = self._last.get(drive.node, (None, None))
        if drive.adhesion is not adhesion:
            self.changes.append((t_ns, drive.node, "adhesion", ADHESION[drive.adhesion]))
        if drive.thermal is not thermal:
            self.changes.append((t_ns, drive.node, "thermal", FAULT[drive.thermal]))

    def close(self) -> None:
        """Finish the tables. Raises OSError."""
        self._files.close()

    def __enter__(self) -> Self:
        """Itself."""
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        """Finish the tables, or take them away. Raises OSError."""
        self._files.__exit__(kind, error, trace)


def flag_words(drive: DriveView) -> tuple[str, str, str]:
    """Adhesion, thermal, and why one of them is unknown, as in `flags.csv`."""
    reason = drive.adhesion_reason or drive.thermal_reason
    return ADHESION[drive.adhesion], FAULT[drive.thermal], camel(Reason(reason).name)


def estimated(drive: DriveView) -> tuple[str | float | None, ...]:
    """What follows the drive in `estimates.csv`; None: not known."""
    wear = drive.wear
    return (
        camel(Health(drive.health).name), drive.speed_rad_s, drive.load_nm, drive.load_sigma_nm,
        drive.loss_probability, drive.nis, camel(FaultClass(drive.fault_class).name),
        drive.mixed_c, drive.maisd_k, wear.rate_k_h, wear.sigma_k_h, wear.hours,
    )  # fmt: skip


def _text(value: str | float | None, digits: int) -> str:
    """A word, a number, or nothing where it is not known."""
    if isinstance(value, str):
        return value
    return "" if value is None else f"{value:.{digits}f}"
