"""What a run leaves behind: `flags.csv`, `estimates.csv`, and when flags changed."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from contextlib import AbstractContextManager, ExitStack
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import numpy as np
from numpy.typing import NDArray

from gateway.core.codes import FaultClass, Flag, Health, Reason
from gateway.core.flags import FlagKind
from gateway.core.view import GatewayView
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

_FLAGS_LINE: Final = "%s,%d,%s,%s,%s\n"
_LINE: Final = "%s,%d,%s,%.4f,%.4f,%.4f,%.4f,%.3f,%s,%.2f,%.3f,%.4f,%.4f,%.1f\n"
NEITHER: Final = -1
"""No flag says this."""


def camel(name: str) -> str:
    """`NOT_AVAILABLE` as the DBC writes it: `NotAvailable`."""
    return "".join(part.capitalize() for part in name.split("_"))


Column = NDArray[Any]


def _by_code(words: Mapping[Any, str]) -> Column:
    """(256,): the word of each code."""
    made = np.full(256, None, dtype=object)
    for code, word in words.items():
        made[code] = word
    return made


_ADHESION, _FAULT = _by_code(ADHESION), _by_code(FAULT)
_REASONS, _HEALTH, _CLASSES = (
    _by_code({one: camel(one.name) for one in kind}) for kind in (Reason, Health, FaultClass)
)


def flag_columns(ticks: Ticks) -> tuple[Column, ...]:
    """What follows the drive in `flags.csv`, each (K N,)."""
    drives = ticks.drives.reshape(-1)
    states, why = drives["flag"]["state"], drives["adhesion_reason"]
    return (
        _ADHESION[states[:, FlagKind.ADHESION]], _FAULT[states[:, FlagKind.THERMAL]],
        _REASONS[np.where(why, why, drives["thermal_reason"])],
    )  # fmt: skip


def estimate_columns(ticks: Ticks) -> tuple[Column, ...]:
    """What follows the drive in `estimates.csv`, each (K N,); NaN: not known."""
    drives, wear = ticks.drives.reshape(-1), ticks.wear.reshape(-1, ticks.wear.shape[2])
    return (
        _HEALTH[drives["health"]], drives["speed_rad_s"], drives["load_nm"],
        drives["load_sigma_nm"], drives["loss_probability"], drives["nis"],
        _CLASSES[drives["fault_class"]], drives["mixed_c"], drives["maisd_k"], *wear.T,
    )  # fmt: skip


class Changes:
    """When the flags of the drives changed, and their first values."""

    def __init__(self) -> None:
        """None yet."""
        self.changes: list[Change] = []
        self._last: dict[int, tuple[Flag, Flag]] = {}
        self._before: NDArray[np.int64] | None = None

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

    def add_ticks(self, ticks: Ticks, nodes: Sequence[int]) -> None:
        """Take ticks; nodes: in the order of their drives."""
        states = ticks.drives["flag"]["state"][:, :, [FlagKind.ADHESION, FlagKind.THERMAL]]
        states = states.astype(np.int64)
        first = np.full_like(states[:1], NEITHER) if self._before is None else self._before
        before = np.concatenate([first, states[:-1]])
        self._before = states[-1:]
        for k, j in np.argwhere((states != before).any(axis=2)).tolist():
            adhesion, thermal = states[k, j].tolist()
            self.note(ticks.t_ns.item(k), nodes[j], Flag(adhesion), Flag(thermal))


class Recorder(AbstractContextManager["Recorder"]):
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

    def add(self, ticks: Ticks) -> None:
        """Take ticks."""
        self.noted.add_ticks(ticks, self.nodes)
        times = [f"{t // 1_000_000_000}.{t % 1_000_000_000:09d}" for t in ticks.t_ns.tolist()]
        times = [time for time in times for _ in self.nodes]
        nodes = [*self.nodes] * len(ticks.t_ns)
        says = zip(times, nodes, *(c.tolist() for c in flag_columns(ticks)), strict=True)
        self._flags.write("".join(_FLAGS_LINE % row for row in says))
        rows = zip(times, nodes, *(c.tolist() for c in estimate_columns(ticks)), strict=True)
        self._estimates.write("".join(_LINE % row for row in rows).replace(",nan", ","))

    def close(self) -> None:
        """Finish the tables. Raises OSError."""
        self._files.close()

    def __exit__(self, *error: Any) -> None:
        """Finish the tables, or take them away. Raises OSError."""
        self._files.__exit__(*error)
