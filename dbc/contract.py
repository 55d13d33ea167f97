"""Messages, signals, units and states that the gateway needs from a DBC; `bind` compares them.

The contract is deliberately written by hand, independently of the DBC files: at start-up the
gateway reports where the two disagree. Scaling, bit positions, ids and cycle times are free (they
come from the DBC); names, units, widths of states and meanings of codes are fixed.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from enum import Enum
from typing import Final

NOT_AVAILABLE: Final = "NotAvailable"
"""Label of the not-available code in a `VAL_` table."""


class Direction(Enum):
    """Direction of a message, seen from the gateway."""

    CONSUMED = "consumed"
    PRODUCED = "produced"


@dataclass(frozen=True, slots=True)
class SignalNeed:
    """One signal: its unit on the wire, and the label of each code that has a meaning."""

    name: str
    unit: str = ""
    codes: Mapping[int, str] = field(default_factory=dict)
    bits: int = 0
    """Required width; 0 leaves it free."""


@dataclass(frozen=True, slots=True)
class MessageNeed:
    """One kind of message: `Drive{n}_<kind>` if `per_drive`, else `Gateway_<kind>`."""

    kind: str
    direction: Direction
    signals: tuple[SignalNeed, ...]
    per_drive: bool = True
    length: int = 8
    fd: bool = False
    cyclic: bool = True
    optional: bool = False
    """The DBC may leave it out; a caller that wants to send it has to check that it is there."""

    def name(self, node: int) -> str:
        """Name in the DBC; `node` is ignored for the gateway's own messages."""
        return f"Drive{node}_{self.kind}" if self.per_drive else f"Gateway_{self.kind}"


@dataclass(frozen=True, slots=True)
class Contract:
    """A set of message kinds."""

    messages: tuple[MessageNeed, ...]

    def named(self, nodes: tuple[int, ...]) -> Iterator[tuple[str, MessageNeed, int]]:
        """Yield (name, need, node or 0) of every message that these drives and the gateway need."""
        for need in self.messages:
            if not need.per_drive:
                yield need.name(0), need, 0
            for node in nodes if need.per_drive else ():
                yield need.name(node), need, node


def _coded(name: str, *labels: str, first: int = 0, bits: int = 4) -> SignalNeed:
    return SignalNeed(name, "", dict(enumerate(labels, first)), bits)


def _state(name: str, good: str = "NoFault", bad: str = "Fault") -> SignalNeed:
    return SignalNeed(name, "", {0: "Unknown", 1: good, 2: bad}, bits=2)


_QUALITY = _coded("Quality", "Initialising", "Valid", "Degraded", bits=0)
_REASON = _coded(
    "Reason", "None", "Starting", "Stale", "Corrupted", "Sequence", "Range", "NotAvailable",
    "Diverged", "TooFewDrives", "Overrun", "Intruder", "Config",
)  # fmt: skip
_ALL = range(1, 17)


def _numbers(*pairs: tuple[str, str]) -> tuple[SignalNeed, ...]:
    return tuple(SignalNeed(name, unit) for name, unit in pairs)


_CURRENTS = MessageNeed(
    "PhaseCurrents",
    Direction.CONSUMED,
    (_QUALITY, *_numbers(("Ia", "A"), ("Ib", "A"), ("Ic", "A"))),
)
_VOLTAGES = MessageNeed(
    "StatorVoltages",
    Direction.CONSUMED,
    (_QUALITY, *_numbers(("Ualpha", "V"), ("Ubeta", "V"), ("Udc", "V"))),
)
_SAMPLES = MessageNeed(
    "Samples",
    Direction.CONSUMED,
    (
        _QUALITY,
        SignalNeed("SampleIndex", bits=16),
        SignalNeed("Udc", "V"),
        *(
            SignalNeed(f"{name}_{k}", unit)
            for k in range(8)
            for name, unit in (("Ia", "A"), ("Ib", "A"), ("Ualpha", "V"), ("Ubeta", "V"))
        ),
    ),
    length=64,
    fd=True,
)
_SHARED = (
    MessageNeed(
        "Motion",
        Direction.CONSUMED,
        (_QUALITY, *_numbers(("Speed", "rpm"), ("ElectricalAngle", "deg"), ("Torque", "Nm"))),
    ),
    MessageNeed(
        "Status",
        Direction.CONSUMED,
        (
            _QUALITY,
            *_numbers(("Irms", "A"), ("TorqueCommand", "Nm")),
            _coded("State", "Off", "Ready", "Operation", "Fault"),
            SignalNeed("FaultCode"),
        ),
    ),
    MessageNeed(
        "Temperatures",
        Direction.CONSUMED,
        (
            _QUALITY,
            *_numbers(*((name, "degC") for name in ("Tstator", "Tde", "Tnde", "Tambient"))),
        ),
    ),
    MessageNeed(
        "Estimate",
        Direction.PRODUCED,
        (
            _coded(
                "Health", "Unknown", "Converging", "Tracking", "Predicting", "Diverged",
                "InputInvalid",
            ),
            *_numbers(
                ("Speed", "rpm"), ("LoadTorque", "Nm"), ("LossProbability", "%"), ("Nis", "")
            ),
        ),
    ),
    MessageNeed(
        "Thermal",
        Direction.PRODUCED,
        (
            _coded(
                "FaultClass", "Unknown", "None", "Overheating", "CoolingLoss", "Bearing",
                "SensorBias", "SensorStuck", "SensorLost", "WindingResistance",
            ),
            *_numbers(("Tmixed", "degC"), ("Maisd", "K")),
            _coded(
                "FaultSensor", "None", "Stator", "DriveEnd", "NonDriveEnd", "Ambient", "Current"
            ),
            *_numbers(("Jumps", ""), ("DegradationRate", "K/h")),
        ),
    ),
    MessageNeed(
        "Adhesion",
        Direction.PRODUCED,
        (
            _QUALITY,
            *_numbers(
                ("Creep", "%"), ("Utilisation", "%"), ("CreepSigma", "%"), ("UtilisationSigma", "%")
            ),
        ),
        optional=True,
    ),
    MessageNeed(
        "Adhesion",
        Direction.PRODUCED,
        (
            _REASON,
            *(_state(f"Adhesion{n}", "Adhering", "AdhesionLost") for n in _ALL),
            _coded(
                "Detector", "VariationalBayes", "VariationalMessagePassing", "KMeans", "Median",
                "Switching",
                first=1, bits=3,
            ),
            _state("CommonMode", "NotDetected", "AllDrives"),
            SignalNeed("Age", "ms"),
        ),
        per_drive=False,
    ),
    MessageNeed(
        "Faults",
        Direction.PRODUCED,
        (
            _REASON,
            *(_state(f"Thermal{n}") for n in _ALL),
            *map(_state, ("SensorFault", "CommFault", "EstimatorFault", "Overrun")),
            SignalNeed("Age", "ms"),
        ),
        per_drive=False,
    ),
    MessageNeed(
        "Info",
        Direction.PRODUCED,
        (
            SignalNeed("ConfigHash", bits=24),
            *_numbers(("LatencyP99", "us"), ("LatenessP99", "us")),
        ),
        per_drive=False,
    ),
    MessageNeed(
        "Auth",
        Direction.PRODUCED,
        (SignalNeed("Freshness", bits=16), SignalNeed("Mac", bits=32)),
        per_drive=False,
        cyclic=False,
    ),
    MessageNeed(
        "Status",
        Direction.PRODUCED,
        (
            _coded("State", "Starting", "Running", "Degraded", "Silent", first=1),
            *_numbers(
                ("DeadlineMisses", ""), ("RejectedFrames", ""), ("LostFrames", ""),
                ("BusLoad", "%"),
            ),
        ),
        per_drive=False,
    ),
)  # fmt: skip

CLASSIC: Final = Contract((_CURRENTS, _VOLTAGES, *_SHARED))
"""The set of `traction.dbc`."""
FD: Final = Contract((_SAMPLES, *_SHARED))
"""The set of `traction_fd.dbc`: `Samples` replaces currents and voltages."""
ANY: Final = Contract(())
"""No expectations: any DBC that is consistent in itself."""
