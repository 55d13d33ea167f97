"""Check the raw frames of a recording against the DBC: lengths, cycle times, identifiers."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from dbc.codec import Codec
from dbc.e2e import crc_ok
from dbc.frame import ERROR, EXTENDED, FD, MS, REMOTE, Nanos
from dbc.frames import MAX_DATA_BYTES, Block
from dbc.spec import ABSENT, EXTENDED_KEY, MessageSpec
from gateway.mapping.fit import Finding
from gateway.mapping.plan import OWN_CANOPEN, Plan

LEAST_STEPS: Final = 3
"""Fewest intervals for a cycle time."""
CYCLE: Final = (0.5, 1.5)
"""Smallest and largest measured cycle time, as a share of the configured one: above it, every
frame counts as one after a lost one."""
SILENCE_PERIODS: Final = 20
SILENCE_NS: Final[Nanos] = 1000 * MS
"""An interval longer than both is a silence, and no part of the cycle time."""
CHECKED: Final = 100
"""Number of frames of each of the gateway's identifiers that are checked."""
SHOWN: Final = 6
"""Most identifiers in one line."""
Times = NDArray[np.int64]


class Cycle(NamedTuple):
    """Cycle time of one identifier; ms is None if the time stamps do not show it.

    stamps: number of different ones; grouped: a recorder with a buffer has stamped the frames.
    """

    ms: float | None
    frames: int
    stamps: int
    grouped: bool = False

    @property
    def problem(self) -> str:
        """Why there is no cycle time, as text that follows a noun."""
        if self.frames <= LEAST_STEPS:
            return f"only {self.frames} frames"
        return f"{self.frames} frames have only {self.stamps} different time stamps"


def keys(block: Block) -> Times:
    """Identifiers of a block as `MessageSpec.key` has them."""
    out = block.can_id.astype(np.int64)
    return out | np.where(block.flags & EXTENDED, EXTENDED_KEY, 0)


def cycle(t_ns: Times) -> Cycle:
    """Cycle time of one identifier's frames.

    There is none if fewer than half of the stamps differ: the recorder stamps bursts, not frames.
    """
    t_ns = np.sort(t_ns)
    steps = np.diff(t_ns)
    stamps = int(np.count_nonzero(steps)) + 1 if len(t_ns) else 0
    if len(steps) < LEAST_STEPS or 2 * stamps <= len(t_ns):
        return Cycle(None, len(t_ns), stamps)
    middle = float(np.median(steps))
    mean = float(np.mean(steps[steps <= max(SILENCE_PERIODS * middle, SILENCE_NS)]))
    # A recorder with a buffer stamps frames in groups: the median is then the time inside a group.
    grouped = disagrees(middle, mean)
    ms = (mean if grouped else middle) / MS
    return Cycle(max(round(ms) if ms >= 2 else round(ms, 1), 0.1), len(t_ns), stamps, grouped)


def disagrees(measured_ms: float, configured_ms: float) -> bool:
    """Whether a measured cycle time contradicts the configured one."""
    least, most = CYCLE
    return not least * configured_ms < measured_ms < most * configured_ms


class Traffic:
    """Frames of the drives' messages, and of the gateway's own identifiers."""

    def __init__(
        self, codec: Codec, planned: Sequence[Plan], nodes: Iterable[int], *, creep: bool
    ) -> None:
        """codec: that of the configuration's DBC; creep: as `Codec.own`."""
        self._plans = {plan.node: plan for plan in planned}
        self._messages = {
            node: [s for s in codec.messages if s.node == node and not s.is_gateway]
            if node not in self._plans
            else self._plans[node].codec.messages
            for node in nodes
        }
        self._wanted = {spec.key for specs in self._messages.values() for spec in specs}
        self._own: Mapping[int, MessageSpec] = {s.key: s for s in codec.own(creep=creep)}
        self._times: dict[int, list[Times]] = {}
        self._parts: dict[int, dict[str, list[Times]]] = {}
        """Times of a multiplexed message's frames with each mapped signal, by identifier."""
        self._shapes: dict[int, Counter[tuple[int, bool]]] = {}
        """Number of frames by length and whether they are CAN FD, by identifier."""
        self._strangers: Counter[int] = Counter()
        self._checked: Counter[int] = Counter()

    def add(self, block: Block) -> None:
        """Count the frames of a block."""
        data = (block.flags & (ERROR | REMOTE)) == 0
        there = np.where(data, keys(block), -1)
        present = set(np.unique(there).tolist())
        for key in self._wanted & present:
            rows = np.flatnonzero(there == key)
            self._times.setdefault(key, []).append(block.t_ns[rows])
            self._add_parts(key, block.pick(rows))
            shapes = self._shapes.setdefault(key, Counter())
            fd = (block.flags[rows] & FD) != 0
            shapes.update(zip(block.length[rows].tolist(), fd.tolist(), strict=True))
        for key in (self._own.keys() | OWN_CANOPEN) & present:
            self._check_own(key, block, np.flatnonzero(there == key))

    def _add_parts(self, key: int, block: Block) -> None:
        for plan in self._plans.values():
            for spec in plan.codec.messages:
                used = {s.name for s in plan.signals.use.values() if s.message == spec.name}
                parts = [k for k, s in enumerate(spec.signals) if s.mux_parent and s.name in used]
                if spec.key != key or not parts:
                    continue
                index = np.full(block.size, spec.index, np.int32)
                _, validity = plan.codec.decode_rows(index, block.data[:, :MAX_DATA_BYTES])
                times = self._parts.setdefault(key, {})
                for k in parts:
                    there = validity[:, k] != ABSENT
                    times.setdefault(spec.signals[k].name, []).append(block.t_ns[there])

    def _cycle(self, spec: MessageSpec) -> Cycle:
        """Cycle time of a message; of a multiplexed one, that of its rarest mapped signal."""
        parts = self._parts.get(spec.key, {}).values() or [self._times[spec.key]]
        return max((cycle(np.concatenate(part)) for part in parts), key=lambda c: c.ms or 0.0)

    def _check_own(self, key: int, block: Block, rows: NDArray[np.intp]) -> None:
        spec = self._own.get(key)
        for row in rows[: CHECKED - self._checked[key]].tolist():
            self._checked[key] += 1
            payload = block.data[row, : block.length.item(row)].tobytes()
            self._strangers[key] += not _is_ours(spec, key, payload)

    def strangers(self) -> list[Finding]:
        """Finding: frames of other nodes that have the gateway's own identifiers."""
        found = [key for key, n in sorted(self._strangers.items()) if n]
        if not found:
            return []
        named = {key: spec.name for key, spec in self._own.items()} | OWN_CANOPEN
        names = [f"{key & ~EXTENDED_KEY:#x} ({named[key]})" for key in found]
        more = f" and {len(names) - SHOWN} more" if len(names) > SHOWN else ""
        return [Finding(
            False,
            f"another node sends with the gateway's identifiers {', '.join(names[:SHOWN])}{more}, "
            "so a gateway on this bus makes its flags Unknown (reason Intruder): change or delete "
            "these messages in a copy of the DBC (`traction-gateway dbc -o own.dbc`), and name it "
            "in [dbc] file",
        )]  # fmt: skip

    def unusable(self, node: int) -> list[Finding]:
        """Findings: mapped messages whose frames have another length or format in the log."""
        if node not in self._plans:
            return []
        return [
            Finding(False, text) for spec in self._messages[node] for text in self._shaped(spec)
        ]

    def _shaped(self, spec: MessageSpec) -> Iterator[str]:
        shapes = self._shapes.get(spec.key, Counter())
        for (length, fd), n in sorted(shapes.items()):
            if 2 * n <= shapes.total():
                continue
            what = f"{n} frames of {spec.can_id:#x} {spec.name}"
            if not spec.has_format(fd):
                yield f"{what} are {_format(fd)}, the DBC says {_format(not fd)}: correct it there"
            elif length != spec.length:
                yield (f"{what} have {length} bytes, the DBC says {spec.length}: correct it there, "
                       "or take the DBC of this very inverter")  # fmt: skip

    def cycles(self, node: int) -> list[Finding]:
        """Findings on the cycle times of a drive: what contradicts, what is not known."""
        wrong, right, out = [], {}, []
        grouped: list[str] = []
        for spec in self._messages[node]:
            if spec.key not in self._times or not spec.cycle_ns:
                continue
            measured, own_ms = self._cycle(spec), spec.cycle_ns / MS
            if measured.ms is None:
                text = f"cycle time of {spec.name} cannot be checked: {measured.problem}"
                out.append(Finding(None, text))
            elif disagrees(measured.ms, own_ms):
                wrong.append(f"{spec.name} every {measured.ms:g} ms, configured {own_ms:g} ms")
                right[spec.name] = measured.ms
            grouped += [spec.name] if measured.grouped else []
        if grouped:
            text = f"the log's time stamps of {', '.join(grouped)} come in groups, from a recorder "
            out.append(Finding(None, f"{text}with a buffer: a replay cannot follow the motor"))
        if wrong:
            out.insert(0, Finding(False, f"{'; '.join(wrong)}: {self._cure(node, right)}"))
        return out

    def _cure(self, node: int, right: Mapping[str, float]) -> str:
        """What to change for these cycle times, by message."""
        if node not in self._plans:
            return "correct GenMsgCycleTime in a copy of the DBC, and name it in [dbc] file"
        cycles = {**self._plans[node].signals.cycle_ms, **right}
        return (
            f"set cycle_ms = {{ {', '.join(f'{name} = {ms:g}' for name, ms in cycles.items())} }}"
        )

    def not_received(self, node: int) -> list[Finding]:
        """Finding: mapped messages of which the log has no frame, though it has others."""
        if node not in self._plans:
            return []
        names = [
            f"{spec.name} ({spec.can_id:#x})"
            for spec in self._messages[node]
            if spec.key not in self._times
        ]
        if not names or not self.receives(node):
            return []
        return [Finding(None, f"the log has no frame of {', '.join(names)}")]

    def receives(self, node: int) -> bool:
        """Whether the log has any message of a drive, of whatever length."""
        return any(spec.key in self._times for spec in self._messages[node])


def _is_ours(spec: MessageSpec | None, key: int, payload: bytes) -> bool:
    """Whether a frame with an identifier of the gateway can be from a gateway."""
    if spec is None:  # CANopen has no checksum, so only the length shows a stranger
        return len(payload) == (1 if OWN_CANOPEN[key].endswith("heartbeat") else 8)
    return len(payload) == spec.length and crc_ok(spec, payload)


def _format(fd: bool) -> str:
    return "CAN FD" if fd else "classic CAN"
