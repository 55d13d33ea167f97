"""What a run leaves behind: `flags.csv`, `estimates.csv`, and when flags changed."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import ExitStack
from pathlib import Path
from types import TracebackType
from typing import TYPE_CHECKING, Final, Self

import numpy as np
from numpy.typing import NDArray

from gateway.core.codes import FaultClass, Flag, Health, Reason
from gateway.core.flags import FlagKind
from gateway.core.view import DriveView, GatewayView
from gateway.io.whole_file import whole

if TYPE_CHECKING:
    from gateway.reports.ticks import Ticks

ADHESION = {Flag.UNKNOWN: "Unknown", Flag.GOOD: "Adhering", Flag.BAD: "AdhesionLost"}
FAULT = {Flag.UNKNOWN: "Unknown", Flag.GOOD: "NoFault", Flag.BAD: "Fault"}
Change = tuple[int, int, str, str]
"""Time in ns, node, flag, what it says from then on."""
FLAGS, ESTIMATES = "flags.csv", "estimates.csv"
FLAGS_HEADER = ("t_s", "drive", "adhesion", "thermal", "reason")
ESTIMATES_HEADER = (
    "t_s", "drive", "health", "speed_rad_s", "load_nm", "load_sigma_nm", "loss_probability",
    "nis", "fault_class", "mixed_c", "maisd_k", "degradation_k_h", "degradation_sigma_k_h",
    "hours_to_limit",
)  # fmt: skip

_LINE: Final = "%s,%d,%s,%.4f,%.4f,%.4f,%.4f,%.3f,%s,%.2f,%.3f,%.4f,%.4f,%.1f\n"
_NUMBERS: Final = ("speed_rad_s", "load_nm", "load_sigma_nm", "loss_probability", "nis", "mixed_c",
                   "maisd_k")  # fmt: skip
NEITHER: Final = -1
"""No flag says this."""


def camel(name: str) -> str:
    """`NOT_AVAILABLE` as the DBC writes it: `NotAvailable`."""
    return "".join(part.capitalize() for part in name.split("_"))


_ADHESION: Final = {int(flag): word for flag, word in ADHESION.items()}
_FAULT: Final = {int(flag): word for flag, word in FAULT.items()}
_REASONS, _HEALTH, _CLASSES = (
    {int(one): camel(one.name) for one in kind} for kind in (Reason, Health, FaultClass)
)


class Changes:
    """When the flags of the drives changed, and their first values."""

    def __init__(self) -> None:
        """None yet."""
        self.changes: list[Change] = []
        self._last: dict[int, tuple[Flag, Flag]] = {}

    def add(self, view: GatewayView) -> None:
        """Take one tick."""
        for d in view.drives:
            self.note(view.t_ns, d.node, d.adhesion, d.thermal)

    def note(self, t_ns: int, node: int, adhesion: Flag, thermal: Flag) -> None:
        """What a drive's flags say in a tick."""
        before = self._last.get(node, (None, None))
        self._last[node] = adhesion, thermal
        if adhesion is not before[0]:
            self.changes.append((t_ns, node, "adhesion", ADHESION[adhesion]))
        if thermal is not before[1]:
            self.changes.append((t_ns, node, "thermal", FAULT[thermal]))


class Recorder:
    """Writes both tables while ticks come. Context manager.

    The tables get their names when it is left; after an exception there are none.
    """

    def __init__(self, folder: Path, nodes: Sequence[int]) -> None:
        """folder: where the tables go; nodes: in the order of the ticks' drives."""
        self.nodes = nodes
        self.noted = Changes()
        self._files = ExitStack()
        parts = [self._files.enter_context(whole(folder / n)) for n in (FLAGS, ESTIMATES)]
        self._flags, self._estimates = (
            self._files.enter_context(part.open("w", newline="", encoding="utf-8"))
            for part in parts
        )
        self._flags.write(",".join(FLAGS_HEADER) + "\n")
        self._estimates.write(",".join(ESTIMATES_HEADER) + "\n")
        self._before = np.full((1, len(nodes), 2), NEITHER, np.int64)

    def add(self, ticks: Ticks) -> None:
        """Take ticks."""
        states = ticks.drives["flag"]["state"][:, :, [FlagKind.ADHESION, FlagKind.THERMAL]]
        self._note_changes(ticks.t_ns, states.astype(np.int64))
        times = [f"{t // 1_000_000_000}.{t % 1_000_000_000:09d}" for t in ticks.t_ns.tolist()]
        stamps = [(time, node) for time in times for node in self.nodes]
        drives = ticks.drives.reshape(-1)
        reasons = np.where(
            drives["adhesion_reason"], drives["adhesion_reason"], drives["thermal_reason"]
        )
        says = zip(stamps, states.reshape(-1, 2).tolist(), reasons.tolist(), strict=True)
        self._flags.write("".join(
            f"{time},{node},{_ADHESION[a]},{_FAULT[t]},{_REASONS[why]}\n"
            for (time, node), (a, t), why in says
        ))  # fmt: skip
        numbers = np.column_stack(
            [*(drives[name] for name in _NUMBERS), ticks.wear.reshape(-1, ticks.wear.shape[2])]
        )
        healths, kinds = drives["health"].tolist(), drives["fault_class"].tolist()
        rows = zip(stamps, numbers.tolist(), healths, kinds, strict=True)
        text = "".join(
            _LINE % (time, node, _HEALTH[health], *n[:5], _CLASSES[kind], *n[5:])
            for (time, node), n, health, kind in rows
        )
        self._estimates.write(text.replace(",nan", ","))

    def _note_changes(self, t_ns: NDArray[np.int64], states: NDArray[np.int64]) -> None:
        """states: (K, N, 2)."""
        before = np.concatenate([self._before, states[:-1]])
        self._before = states[-1:]
        for k, j in np.argwhere((states != before).any(axis=2)).tolist():
            adhesion, thermal = states[k, j].tolist()
            self.noted.note(t_ns.item(k), self.nodes[j], Flag(adhesion), Flag(thermal))

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
