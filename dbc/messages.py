"""The message table of the two DBC files, as `dbc.generate` writes them.

Programs and people read the DBC files. The table saves typing 133 messages by hand, twice, and
reading them with cantools at every start.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import cache

DRIVES = range(1, 17)

NOT_AVAILABLE = "NotAvailable"
GATEWAY = "Gateway"


@dataclass(frozen=True)
class Field:
    """One signal as the contract writes it; ranges and codes are raw."""

    name: str
    start: int
    length: int
    comment: str
    unit: str = ""
    scale: str = "1"
    offset: str = "0"
    signed: bool = False
    low: int = 0
    high: int = 0
    code: int | None = None
    start_raw: int | None = None
    labels: Mapping[int, str] = field(default_factory=dict)


@dataclass(frozen=True)
class Entry:
    """One message of the table; `{n}` in texts is the drive number."""

    name: str
    base_id: int
    sender: str
    cycle_ms: int
    comment: str
    fields: tuple[Field, ...]
    receivers: tuple[str, ...] = (GATEWAY,)
    send_type: str = "Cyclic"
    fd: bool = False


def measured(
    name: str, start: int, length: int, comment: str, unit: str, scale: str, **kw: object
) -> Field:
    """A number with the widest range beside its not-available code, which is its start value."""
    signed = bool(kw.pop("signed", False))
    code = (1 << (length - signed)) - 1
    plain = Field(
        name, start, length, comment, unit, scale, signed=signed,
        low=1 - code if signed else 0, high=code - 1, code=code, start_raw=code,
    )  # fmt: skip
    return replace(plain, **kw)  # type: ignore[arg-type]


def counted(name: str, start: int, length: int, comment: str) -> Field:
    """A count: starts at 0 and saturates one below the not-available code."""
    return measured(name, start, length, comment, "", "1", start_raw=0)


def plain(name: str, start: int, length: int, comment: str, high: int | None = None) -> Field:
    """Bits without a not-available code."""
    top = (1 << length) - 1 if high is None else high
    return Field(name, start, length, comment, high=top, start_raw=0)


def chosen(
    name: str, start: int, length: int, comment: str, *names: str, first: int = 0, at: int = -1
) -> Field:
    """An enumeration counted from `first`; four bits and more also have a not-available code."""
    code = 15 if length >= 4 else None
    labels = dict(enumerate(names, first))
    return Field(
        name, start, length, comment, low=first, high=first + len(names) - 1, code=code,
        start_raw=first if at < 0 else at, labels=labels,
    )  # fmt: skip


def state(name: str, start: int, comment: str, good: str, bad: str) -> Field:
    """Two antivalent bits: 1 good, 2 bad, 0 and 3 unknown (the gateway never sends 3)."""
    return Field(
        name, start, 2, comment, high=2, start_raw=0,
        labels={0: "Unknown", 1: good, 2: bad, 3: "Invalid"},
    )  # fmt: skip


def quality(start: int = 12, length: int = 4) -> Field:
    """The sender's own rating of the values of this message."""
    return chosen(
        "Quality", start, length, "What the sender thinks of the values of this message.",
        "Initialising", "Valid", "Degraded",
    )  # fmt: skip


def reason() -> Field:
    """The reason why a flag is unknown."""
    return chosen(
        "Reason", 12, 4, "Highest-priority cause over the configured drives that are unknown.",
        "None", "Starting", "Stale", "Corrupted", "Sequence", "Range", "NotAvailable",
        "Diverged", "TooFewDrives", "Overrun", "Intruder", "Config", at=1,
    )  # fmt: skip


def temperature(name: str, start: int, comment: str) -> Field:
    """Tenths of a degree, -60 to 300."""
    return measured(name, start, 12, comment, "degC", "0.1", offset="-60", high=3600)


def volts(name: str, start: int, comment: str) -> Field:
    """A voltage of the stationary frame, averaged over the interval before the sample."""
    return measured(name, start, 16, comment, "V", "0.1", signed=True)


def speed(comment: str) -> Field:
    """Mechanical speed, +-16,000 rpm."""
    return measured(
        "Speed", 16, 16, comment, "rpm", "0.5", signed=True, low=-32000, high=32000
    )  # fmt: skip


def electrical() -> tuple[Entry, ...]:
    """Currents and voltages of a drive on classic CAN."""
    amps = [
        measured(
            f"I{p}", s, 16, f"Current of phase {p} at the end of the interval.", "A", "0.02",
            signed=True,
        )
        for p, s in (("a", 16), ("b", 32), ("c", 48))
    ]  # fmt: skip
    mean = "mean over the interval since the sample before, stationary frame."
    return (
        Entry(
            "Drive{n}_PhaseCurrents", 0x180, "Drive{n}", 2,
            "Phase currents of drive {n}, measured together; belongs to the StatorVoltages "
            "frame with the same Counter.",
            (quality(), *amps),
        ),
        Entry(
            "Drive{n}_StatorVoltages", 0x280, "Drive{n}", 2,
            "Stator voltages of drive {n}, means over the interval since its sample before.",
            (
                quality(),
                volts("Ualpha", 16, f"Stator voltage along alpha, {mean}"),
                volts("Ubeta", 32, f"Stator voltage along beta, {mean}"),
                measured("Udc", 48, 16, "DC link voltage.", "V", "0.1"),
            ),
        ),
    )  # fmt: skip


def samples() -> Entry:
    """Eight samples in one FD frame: replaces currents and voltages."""
    fields = [
        quality(24, 8),
        plain("SampleIndex", 32, 16, "Index of the first sample; a multiple of 8, wraps.", 65528),
        measured("Udc", 48, 16, "DC link voltage.", "V", "0.1"),
    ]
    for k in range(8):
        for slot, (name, unit, scale, what) in enumerate(
            (
                ("Ia", "A", "0.05", "current of phase a"),
                ("Ib", "A", "0.05", "current of phase b"),
                ("Ualpha", "V", "0.25", "mean stator voltage along alpha over 125 us"),
                ("Ubeta", "V", "0.25", "mean stator voltage along beta over 125 us"),
            )
        ):
            fields.append(
                measured(
                    f"{name}_{k}", 64 + 56 * k + 14 * slot, 14, f"Sample {k} of 8: {what}.",
                    unit, scale, signed=True,
                )
            )  # fmt: skip
    return Entry(
        "Drive{n}_Samples", 0x180, "Drive{n}", 1,
        "Eight samples of drive {n}, 125 us apart.", tuple(fields), fd=True,
    )  # fmt: skip


def drive_messages(fd: bool) -> tuple[Entry, ...]:
    """All messages that one drive sends, and those that the gateway sends about it."""
    to_drive = ("Drive{n}",)
    return (
        *((samples(),) if fd else electrical()),
        Entry(
            "Drive{n}_Motion", 0x380, "Drive{n}", 10, "Shaft of drive {n}.",
            (
                quality(),
                speed("Mechanical speed of the shaft."),
                measured(
                    "ElectricalAngle", 32, 16, "Electrical angle of the rotor.", "deg", "0.01",
                    high=35999,
                ),
                measured("Torque", 48, 16, "Air-gap torque.", "Nm", "0.1", signed=True),
            ),
        ),
        Entry(
            "Drive{n}_Status", 0x1C0, "Drive{n}", 100, "State of drive {n}.",
            (
                quality(),
                measured(
                    "Irms", 16, 16, "Root mean square of the phase current, last 100 ms.",
                    "A", "0.02",
                ),
                measured(
                    "TorqueCommand", 32, 16,
                    "Torque that the train asks for, before the drive's slip control and limits.",
                    "Nm", "0.1", signed=True,
                ),
                chosen("State", 48, 4, "State of the drive.",
                       "Off", "Ready", "Operation", "Fault"),
                measured("FaultCode", 52, 12, "The drive's own fault code.", "", "1"),
            ),
        ),
        Entry(
            "Drive{n}_Temperatures", 0x480, "Drive{n}", 100, "Temperatures of motor {n}.",
            (
                quality(),
                temperature("Tstator", 16, "Stator winding."),
                temperature("Tde", 28, "Bearing at the drive end."),
                temperature("Tnde", 40, "Bearing at the non-drive end."),
                temperature("Tambient", 52, "Ambient air of the motor."),
            ),
        ),
        Entry(
            "Drive{n}_Estimate", 0x500, GATEWAY, 20, "What the gateway estimates of drive {n}.",
            (
                chosen("Health", 12, 4, "State of the estimator.",
                       "Unknown", "Converging", "Tracking", "Predicting", "Diverged",
                       "InputInvalid"),
                speed("Estimated mechanical speed."),
                measured("LoadTorque", 32, 16, "Estimated load torque.", "Nm", "0.1", signed=True),
                measured("LossProbability", 48, 8, "Probability of adhesion loss.", "%", "0.5",
                         high=200),
                measured("Nis", 56, 8, "Normalised innovation squared; saturates at 25.4.",
                         "", "0.1"),
            ),
            to_drive,
        ),
        Entry(
            "Drive{n}_Adhesion", 0x300, GATEWAY, 20,
            "How wheel {n} runs on its rail; only with [adhesion] send_creep.",
            (
                quality(),
                measured("Creep", 16, 16,
                         "Speed of the wheel over that of the train, minus 1; above 0: faster.",
                         "%", "0.01", signed=True),
                measured("Utilisation", 32, 16, "Load torque over rated torque, without its sign.",
                         "%", "0.01"),
                measured("CreepSigma", 48, 8, "Standard deviation of Creep.", "%", "0.1"),
                measured("UtilisationSigma", 56, 8, "Standard deviation of Utilisation.",
                         "%", "0.5"),
            ),
            to_drive,
        ),
        Entry(
            "Drive{n}_Thermal", 0x400, GATEWAY, 500, "Thermal judgement of motor {n}.",
            (
                chosen("FaultClass", 12, 4, "What kind of thermal fault.",
                       "Unknown", "None", "Overheating", "CoolingLoss", "Bearing", "SensorBias",
                       "SensorStuck", "SensorLost", "WindingResistance"),
                temperature("Tmixed", 16, "Mixed temperature of the motor's points."),
                measured("Maisd", 28, 12, "Moving average of inter-signal differences.",
                         "K", "0.01"),
                chosen("FaultSensor", 40, 4, "Which sensor the fault is seen at.",
                       "None", "Stator", "DriveEnd", "NonDriveEnd", "Ambient", "Current"),
                counted("Jumps", 44, 4, "Jumps of the mixed temperature; saturates at 14."),
                measured("DegradationRate", 48, 16, "Slope of the degradation; saturates.",
                         "K/h", "0.0001", signed=True),
            ),
            to_drive,
        ),
    )  # fmt: skip


def gateway_messages() -> tuple[Entry, ...]:
    """Messages with the flags, configuration, timing, authentication and state of the gateway."""
    drives = tuple(f"Drive{n}" for n in DRIVES)
    unit_age = "Age of the oldest sample used; saturates at 254 steps."
    return (
        Entry(
            "Gateway_Adhesion", 0x1A0, GATEWAY, 10, "Adhesion flags of all drives.",
            (
                reason(),
                *(
                    state(f"Adhesion{n}", 14 + 2 * n, f"Adhesion of drive {n}.",
                          "Adhering", "AdhesionLost")
                    for n in DRIVES
                ),
                chosen("Detector", 48, 3, "Detector in use.", "VariationalBayes",
                       "VariationalMessagePassing", "KMeans", "Median", "Switching", first=1),
                state("CommonMode", 52, "Loss common to all drives.", "NotDetected", "AllDrives"),
                measured("Age", 56, 8, unit_age, "ms", "1"),
            ),
            drives,
        ),
        Entry(
            "Gateway_Faults", 0x2A0, GATEWAY, 100,
            "Thermal and system flags; also sent in the tick of a change.",
            (
                reason(),
                *(
                    state(f"Thermal{n}", 14 + 2 * n, f"Thermal state of motor {n}.",
                          "NoFault", "Fault")
                    for n in DRIVES
                ),
                state("SensorFault", 48, "A sensor of any configured drive.", "NoFault", "Fault"),
                state("CommFault", 50, "Communication with any configured drive.",
                      "NoFault", "Fault"),
                state("EstimatorFault", 52, "Estimator of any configured drive.",
                      "NoFault", "Fault"),
                state("Overrun", 54, "The gateway's own cycle.", "NoFault", "Fault"),
                measured("Age", 56, 8, unit_age, "ms", "10"),
            ),
            drives, "CyclicAndSpontaneous",
        ),
        Entry(
            "Gateway_Info", 0x3A0, GATEWAY, 1000, "Configuration and timing of the gateway.",
            (
                plain("ConfigHash", 16, 24, "Names the configuration in use."),
                measured("LatencyP99", 40, 12, "Frame in to flag out, 99th percentile; "
                         "saturates.", "us", "10"),
                measured("LatenessP99", 52, 12, "Tick late by, 99th percentile; saturates.",
                         "us", "10"),
            ),
            (),
        ),
        Entry(
            "Gateway_Auth", 0x320, GATEWAY, 0,
            "Authentication of the flag frame it follows; only when authentication is on.",
            (
                plain("Freshness", 16, 16, "Low bits of the freshness counter."),
                plain("Mac", 32, 32, "Truncated CMAC over the flag frame."),
            ),
            drives, "Spontaneous",
        ),
        Entry(
            "Gateway_Status", 0x4A0, GATEWAY, 100, "State and counts of the gateway.",
            (
                chosen("State", 12, 4, "State of the gateway.",
                       "Starting", "Running", "Degraded", "Silent", first=1),
                counted("DeadlineMisses", 16, 12, "Ticks missed since start; saturates."),
                counted("RejectedFrames", 28, 12, "Frames rejected since start; saturates."),
                counted("LostFrames", 40, 12, "Frames lost since start; saturates."),
                measured("BusLoad", 52, 7, "Share of the bus in use.", "%", "1", high=100),
            ),
            drives,
        ),
    )  # fmt: skip


def header(fd: bool) -> tuple[Field, Field]:
    """The protection header: E2E Profile 5 in FD frames, Profile 2 in the others."""
    crc, count = "E2E checksum over data id, counter and data.", "E2E counter."
    if fd:
        return plain("Crc", 0, 16, crc), plain("Counter", 16, 8, count)
    return plain("Crc", 0, 8, crc), plain("Counter", 8, 4, count)


@cache
def messages(fd: bool) -> tuple[tuple[int, Entry], ...]:
    """(CAN id, message) of the whole set, header included, sorted by id.

    Messages that differ only in the drive share one tuple of fields.
    """
    drives = [_protected(entry) for entry in drive_messages(fd)]
    found = [(entry.base_id + n, _numbered(entry, n)) for entry in drives for n in DRIVES]
    found += [(entry.base_id, _protected(entry)) for entry in gateway_messages()]
    return tuple(sorted(found, key=lambda pair: pair[0]))


def _protected(entry: Entry) -> Entry:
    return replace(entry, fields=(*header(entry.fd), *entry.fields))


def _numbered(entry: Entry, n: int) -> Entry:
    return replace(
        entry,
        name=entry.name.format(n=n),
        sender=entry.sender.format(n=n),
        comment=entry.comment.format(n=n),
        receivers=tuple(r.format(n=n) for r in entry.receivers),
    )
