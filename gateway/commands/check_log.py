"""`check --log`: whether units, signs and motor parameters fit a recording."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable
from pathlib import Path
from typing import Final

import numpy as np
from numpy.typing import NDArray

from dbc.codec import Codec
from dbc.e2e import crc_ok
from dbc.frame import ERROR, REMOTE
from dbc.frames import Block
from dbc.logs.opening import open_reader
from dbc.spec import MessageSpec
from gateway.commands.common import pattern_of
from gateway.commands.progress import Progress
from gateway.io.log_file import NO_FRAME, BadLogError, OneChannel
from gateway.mapping import command_fit, fit, rating_fit, temperature_fit
from gateway.mapping.bus_fit import Traffic
from gateway.mapping.plan import NO_MESSAGE, fitted, plans
from gateway.mapping.translate import Translator
from gateway.settings.config import Config
from gateway.settings.sections import Drive
from gateway.settings.signal_map import SENSORS

LOOKED_AT_S: Final = 60.0
SUB_SAMPLES: Final = 8
CHECKED: Final = 100
"""Number of frames of each message whose length and checksum are checked."""
_RPM: Final = np.pi / 30.0
_Array = NDArray[np.float64]
_Vector = NDArray[np.complex128]
Columns = dict[str, _Array]


def print_findings(
    path: Path, line: str | None, channel: str | None, config: Config, codec: Codec
) -> list[str]:
    """Print a line for each comparison; return what does not fit. Raises as a replay does."""
    reader = open_reader(path, strict=False, line=pattern_of(path, line))
    values = _Values(config, codec)
    with Progress("first minute of the log", LOOKED_AT_S) as progress:
        if not values.add_all(OneChannel(reader.blocks(), channel), progress):
            raise BadLogError(f"{path}: {NO_FRAME}")
    problems = _print("gateway", values.traffic.strangers())
    motors = {drive.node: config.motors[drive.motor] for drive in config.drive}
    asked = [values.commanded(node, motor.T_rated) for node, motor in motors.items()]
    alone, crossed = command_fit.fell_alone(asked), command_fit.crossed(asked)
    for drive, one in zip(config.drive, asked, strict=True):
        lines = values.of_frames(drive.node)
        absent = values.absent(drive.node, explained=any(one.fits is False for one in lines))
        measured, motor = values.of_drive(drive.node), motors[drive.node]
        lines += rating_fit.findings(measured, motor, drive.motor)
        lines += absent or fit.findings(measured, motor)
        lines += temperature_fit.findings(values.temperatures(drive))
        lines += command_fit.repeats_torque(one)
        lines += [found[drive.node] for found in (crossed, alone) if drive.node in found]
        problems += _print(f"drive {drive.node}", lines)
    return problems


def _print(whose: str, findings: list[fit.Finding]) -> list[str]:
    """Print the findings; return those that do not fit."""
    problems = []
    for k, found in enumerate(findings):
        verdict = {True: "fits", False: "DOES NOT FIT", None: "unknown"}[found.fits]
        print(f"{whose if k == 0 else '':<14} {verdict}: {found.text}")
        if found.fits is False:
            problems.append(f"{whose}: {found.text}")
    return problems


class _Values:
    """Decoded columns of the first minute, by our messages."""

    def __init__(self, config: Config, codec: Codec) -> None:
        planned = plans(config)
        self.traffic = Traffic(codec, planned, config.nodes, creep=config.adhesion.send_creep)
        self._codec = fitted(codec, planned)
        self._derived: dict[int, list[int]] = {drive.node: [] for drive in config.drive}
        """Times of samples in which one phase is computed from the others, by node."""
        note = self._note_derived
        self._translator = Translator(planned, self._codec, note) if planned else None
        self._parts: dict[int, list[tuple[_Array, _Array]]] = {}
        self._counts: Counter[str] = Counter()
        self._own = {drive.node for drive in config.drive if drive.signals is None}
        """Drives that send our messages."""
        self._checked: Counter[int] = Counter()
        """Number of frames whose length and checksum were checked, by message."""
        self._bad: dict[int, Counter[str]] = {}
        """Number of checked frames that a replay rejects, by message and cause."""

    def add_all(self, blocks: Iterable[Block], progress: Progress) -> bool:
        """Add the first minute; returns whether there is a frame."""
        first_ns: int | None = None
        for block in blocks:
            if not block.size:
                continue
            first_ns = block.t_ns.item(0) if first_ns is None else first_ns
            self._add(block)
            progress.to((block.t_ns.item(-1) - first_ns) / 1e9)
            if block.t_ns.item(-1) - first_ns > LOOKED_AT_S * 1e9:
                break
        return first_ns is not None

    def _note_derived(self, node: int, t_ns: int) -> None:
        self._derived[node].append(t_ns)

    def _add(self, block: Block) -> None:
        self.traffic.add(block)
        if self._translator is not None:
            block = self._translator.translate(block, int(block.t_ns.max()), self._counts)
        for spec in self._codec.messages:
            if spec.is_gateway or not spec.node:
                continue
            rows = np.flatnonzero(block.can_id == spec.can_id)
            if spec.node in self._own:
                self._check_frames(spec, block, rows)
            rows = rows[block.length[rows] == spec.length]
            if rows.size:
                index = np.full(len(rows), spec.index, np.int32)
                value, validity = self._codec.decode_rows(index, block.data[rows])
                value = np.where(validity == 0, value, np.nan)
                self._parts.setdefault(spec.index, []).append((block.t_ns[rows] / 1e9, value))

    def _columns(self, node: int, kind: str) -> tuple[MessageSpec | None, Columns]:
        spec = self._codec.by_name.get(f"Drive{node}_{kind}")
        parts = self._parts.get(spec.index, []) if spec is not None else []
        if spec is None or not parts:
            return spec, {}
        value = np.concatenate([part[1] for part in parts])
        columns = {signal.name: value[:, k] for k, signal in enumerate(spec.signals)}
        return spec, {"t": np.concatenate([part[0] for part in parts]), **columns}

    def _check_frames(self, spec: MessageSpec, block: Block, rows: NDArray[np.intp]) -> None:
        for row in rows[: CHECKED - self._checked[spec.index]].tolist():
            if block.flags.item(row) & (ERROR | REMOTE):
                continue
            self._checked[spec.index] += 1
            size = block.length.item(row)
            bad = self._bad.setdefault(spec.index, Counter())
            if size != spec.length:
                bad[f"{size} bytes, the DBC says {spec.length}: correct [dbc] file"] += 1
            elif not crc_ok(spec, block.data[row, :size].tobytes()):
                bad["a wrong checksum: the drive has another data ID, or no E2E protection"] += 1

    def of_frames(self, node: int) -> list[fit.Finding]:
        """Findings on frames: those that a replay rejects, cycle times, messages not received."""
        traffic = self.traffic
        unusable = self._unusable(node) + traffic.unusable(node)
        return unusable + traffic.cycles(node) + traffic.not_received(node)

    def _unusable(self, node: int) -> list[fit.Finding]:
        """Findings: messages of which a replay rejects more than half for one cause."""
        return [
            fit.Finding(False, f"{spec.name}: {n} of {self._checked[spec.index]} frames have {why}")
            for spec in self._codec.messages
            if spec.node == node
            for why, n in self._bad.get(spec.index, {}).items()
            if 2 * n > self._checked[spec.index]
        ]

    def absent(self, node: int, *, explained: bool) -> list[fit.Finding]:
        """Finding that the log has no usable message of this drive, if so; not if explained."""
        mine = [s.index for s in self._codec.messages if s.node == node and not s.is_gateway]
        if self._parts.keys() & mine:
            return []
        if not mine:
            return [fit.Finding(False, NO_MESSAGE)]
        if explained:
            return []
        if self.traffic.receives(node):
            text = "its messages are in the log, but their values complete none of ours"
            return [fit.Finding(None, f"{text}: the mapped signals come too far apart in time")]
        text = "the log has none of its messages: correct node or id_offset, or --log-channel"
        return [fit.Finding(False, text)]

    def of_drive(self, node: int) -> fit.Measured:
        """Signals of one drive, SI; arrays are empty where the log has none."""
        t, current, phase_sum, voltage = self._electrical(node)
        _, motion = self._columns(node, "Motion")
        _, status = self._columns(node, "Status")
        none = np.zeros(0)
        speed = motion.get("Speed", none) * _RPM
        good = np.isfinite(speed)
        torque = motion.get("Torque", none)
        irms = status.get("Irms", none)
        return fit.Measured(
            t, current, phase_sum, voltage, motion.get("t", none)[good], speed[good], torque[good],
            status.get("t", none)[np.isfinite(irms)], irms[np.isfinite(irms)],
        )  # fmt: skip

    def temperatures(self, drive: Drive) -> Columns:
        """Temperatures of one drive's sensors and of the air, degC; none where the log has none."""
        _, columns = self._columns(drive.node, "Temperatures")
        sent = ["Tambient", *(name for name, sensor in SENSORS.items() if sensor in drive.sensors)]
        if drive.signals is not None:
            sent = [name for name in sent if name in drive.signals.use]
        return {name: columns[name] for name in sent if name in columns}

    def commanded(self, node: int, rated_nm: float) -> command_fit.Commanded:
        """Torque commands of one drive with its torque; empty where the log has none."""
        none = np.zeros(0)
        _, motion = self._columns(node, "Motion")
        _, status = self._columns(node, "Status")
        t, command = status.get("t", none), status.get("TorqueCommand", none)
        motion_t, torque = motion.get("t", none), motion.get("Torque", none)
        made = np.full(len(t), np.nan)
        if len(motion_t):
            # The last torque before the command, because an echo repeats what was measured.
            at = np.searchsorted(motion_t, t, side="right") - 1
            made[at >= 0] = torque[at[at >= 0]]
        return command_fit.Commanded(node, t, command, made, rated_nm)

    def _electrical(self, node: int) -> tuple[_Array, _Vector, _Array, _Vector]:
        """Times, current, sum of the phases, voltage."""
        none = np.zeros(0)
        spec, samples = self._columns(node, "Samples")
        if spec is not None and samples:
            columns = {
                name: np.stack([samples[f"{name}_{k}"] for k in range(SUB_SAMPLES)], 1).ravel()
                for name in ("Ia", "Ib", "Ualpha", "Ubeta")
            }
            back = np.arange(1 - SUB_SAMPLES, 1) * spec.cycle_ns / 1e9 / SUB_SAMPLES
            t = (samples["t"][:, None] + back).ravel()
            current = fit.space_vector(columns["Ia"], columns["Ib"])
            good = np.isfinite(current)
            return t[good], current[good], none, (columns["Ualpha"] + 1j * columns["Ubeta"])[good]
        spec, phases = self._columns(node, "PhaseCurrents")
        if spec is None or not phases:
            return none, none.astype(complex), none, none.astype(complex)
        current = fit.space_vector(phases["Ia"], phases["Ib"])
        good = np.isfinite(current)
        t, total = phases["t"][good], (phases["Ia"] + phases["Ib"] + phases["Ic"])[good]
        _, volts = self._columns(node, "StatorVoltages")
        vector = volts.get("Ualpha", none) + 1j * volts.get("Ubeta", none)
        voltage = fit.joined(t, volts.get("t", none), vector, 0.5 * spec.cycle_ns / 1e9)
        # A phase computed from the others makes the sum zero, so it cannot be checked there.
        total[np.isin(t, np.array(self._derived[node]) / 1e9)] = np.nan
        total = total if np.isfinite(total).any() else none
        return t, current[good], total, voltage
