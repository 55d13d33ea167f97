"""Write the two DBC files from the message table: `python -m dbc.generate`.

Everybody reads the files (`bind`, other people's tools). For a file with exactly this content the
specs come from the table, because cantools needs 0.4 s. Tests assert that the committed files are
those that this module generates, and that the specs are those that cantools reads from them.
"""

from __future__ import annotations

import sys
from collections.abc import Iterator, Sequence
from pathlib import Path

from dbc.e2e import p02_data_ids
from dbc.frame import MS
from dbc.messages import DRIVES, GATEWAY, NOT_AVAILABLE, Entry, Field, messages
from dbc.spec import MessageSpec, Profile, SignalSpec

HERE = Path(__file__).parent
FILES = {"traction.dbc": False, "traction_fd.dbc": True}
"""Name of each file, and whether it holds the CAN FD set."""

_SECTIONS = (
    "NS_DESC_", "CM_", "BA_DEF_", "BA_", "VAL_", "CAT_DEF_",
    "CAT_", "FILTER", "BA_DEF_DEF_", "EV_DATA_", "ENVVAR_DATA_", "SGTYPE_",
    "SGTYPE_VAL_", "BA_DEF_SGTYPE_", "BA_SGTYPE_", "SIG_TYPE_REF_", "VAL_TABLE_", "SIG_GROUP_",
    "SIG_VALTYPE_", "SIGTYPE_VALTYPE_", "BO_TX_BU_", "BA_DEF_REL_", "BA_REL_", "BA_DEF_DEF_REL_",
    "BU_SG_REL_", "BU_EV_REL_", "BU_BO_REL_", "SG_MUL_VAL_",
)  # fmt: skip
_SEND_TYPES = ("Cyclic", "Spontaneous", "CyclicAndSpontaneous", "NoMsgSendType")
_PROFILES = ("None", "P02", "P05")
_FRAME_FORMATS = (
    "StandardCAN", "ExtendedCAN", "reserved", "J1939PG", *["reserved"] * 10,
    "StandardCAN_FD", "ExtendedCAN_FD",
)  # fmt: skip


def _enum(names: Sequence[str]) -> str:
    return "ENUM " + ",".join(f'"{name}"' for name in names)


def _attributes(fd: bool) -> Iterator[str]:
    definitions = (
        ("", "BusType", "STRING", '"CAN"'),
        ("", "DBName", "STRING", '""'),
        ("BO_", "GenMsgCycleTime", "INT 0 3600000", "0"),
        ("BO_", "GenMsgSendType", _enum(_SEND_TYPES), '"NoMsgSendType"'),
        ("BO_", "VFrameFormat", _enum(_FRAME_FORMATS), '"StandardCAN"'),
        ("BO_", "CANFD_BRS", _enum(("0", "1")), '"0"'),
        ("BO_", "E2EProfile", _enum(_PROFILES), '"None"'),
        ("BO_", "E2EDataId", "INT 0 65535", "0"),
        ("BO_", "E2EDataIdList", "STRING", '""'),
        ("SG_", "GenSigStartValue", "INT -2147483648 2147483647", "0"),
    )
    for scope, name, kind, _ in definitions:
        yield " ".join(part for part in ("BA_DEF_", scope, f'"{name}"', f"{kind};") if part)
    for _, name, _, default in definitions:
        yield f'BA_DEF_DEF_ "{name}" {default};'
    yield f'BA_ "BusType" "{"CAN FD" if fd else "CAN"}";'
    yield f'BA_ "DBName" "{"traction_fd" if fd else "traction"}";'


def _message(can_id: int, entry: Entry) -> Iterator[str]:
    yield f"BO_ {can_id} {entry.name}: {64 if entry.fd else 8} {entry.sender}"
    to = ",".join(entry.receivers) or "Vector__XXX"
    for f in entry.fields:
        low, high = (_number(raw, f) for raw in (f.low, f.high))
        yield (
            f" SG_ {f.name} : {f.start}|{f.length}@1{'-' if f.signed else '+'}"
            f' ({f.scale},{f.offset}) [{low}|{high}] "{f.unit}" {to}'
        )
    yield ""


def _number(raw: int, f: Field) -> str:
    """Physical value of a raw one, with as many decimals as the scale."""
    decimals = len(f.scale.partition(".")[2])
    return f"{raw * float(f.scale) + float(f.offset):.{decimals}f}"


def _values(can_id: int, entry: Entry) -> Iterator[str]:
    yield f'BA_ "GenMsgCycleTime" BO_ {can_id} {entry.cycle_ms};'
    yield f'BA_ "GenMsgSendType" BO_ {can_id} {_SEND_TYPES.index(entry.send_type)};'
    yield f'BA_ "VFrameFormat" BO_ {can_id} {14 if entry.fd else 0};'
    yield f'BA_ "CANFD_BRS" BO_ {can_id} {int(entry.fd)};'
    yield f'BA_ "E2EProfile" BO_ {can_id} {_PROFILES.index("P05" if entry.fd else "P02")};'
    yield f'BA_ "E2EDataId" BO_ {can_id} {can_id};'
    if not entry.fd:
        yield f'BA_ "E2EDataIdList" BO_ {can_id} "{p02_data_ids(can_id).hex().upper()}";'
    for f in entry.fields:
        yield f'BA_ "GenSigStartValue" SG_ {can_id} {f.name} {f.start_raw};'


def render(fd: bool) -> str:
    """The whole text of one DBC file."""
    table = messages(fd)
    nodes = [GATEWAY, *(f"Drive{n}" for n in DRIVES)]
    lines = ['VERSION "1.0"', "", "NS_ :", *(f"\t{s}" for s in _SECTIONS), "", "BS_:", ""]
    lines += [f"BU_: {' '.join(nodes)}", ""]
    for can_id, entry in table:
        lines += _message(can_id, entry)
    lines.append(f'CM_ BU_ {GATEWAY} "Estimates speed and load torque, raises the flags.";')
    lines += [f'CM_ BU_ Drive{n} "Inverter of drive {n}, CANopen node {n}.";' for n in DRIVES]
    for can_id, entry in table:
        lines.append(f'CM_ BO_ {can_id} "{entry.comment}";')
        lines += [f'CM_ SG_ {can_id} {f.name} "{f.comment}";' for f in entry.fields]
    lines += _attributes(fd)
    for can_id, entry in table:
        lines += _values(can_id, entry)
    for can_id, entry in table:
        for f in entry.fields:
            if labels := _labels(f):
                text = " ".join(f'{raw} "{label}"' for raw, label in labels.items())
                lines.append(f"VAL_ {can_id} {f.name} {text};")
    return "\n".join(lines) + "\n"


def _labels(f: Field) -> dict[int, str]:
    """Labels of raw values, ascending, that of the not-available code included."""
    labels = dict(f.labels)
    if f.code is not None:
        # `Reason` already has a cause of that name. Labels must be unique for encoding by name.
        labels[f.code] = "SNA" if NOT_AVAILABLE in labels.values() else NOT_AVAILABLE
    return dict(sorted(labels.items()))


def recall(content: bytes) -> tuple[MessageSpec, ...] | None:
    """Specs of a DBC file with this content; None if it is neither of the two generated files."""
    fd = b"_Samples" in content
    if content != render(fd).encode("ascii"):
        return None
    table = messages(fd)
    fields = {id(entry.fields): entry.fields for _, entry in table}
    signals = {
        key: tuple(map(_signal, sorted(each, key=lambda f: f.start)))
        for key, each in fields.items()
    }
    return tuple(
        _spec(k, can_id, entry, signals[id(entry.fields)])
        for k, (can_id, entry) in enumerate(table)
    )


def _spec(index: int, can_id: int, entry: Entry, signals: tuple[SignalSpec, ...]) -> MessageSpec:
    sender, _, kind = entry.name.partition("_")
    return MessageSpec(
        name=entry.name,
        can_id=can_id,
        length=64 if entry.fd else 8,
        is_fd=entry.fd,
        brs=entry.fd,
        cycle_ns=entry.cycle_ms * MS,
        profile=Profile.P05 if entry.fd else Profile.P02,
        data_ids=can_id.to_bytes(2, "big") if entry.fd else p02_data_ids(can_id),
        signals=signals,
        index=index,
        node=0 if sender == GATEWAY else int(sender.removeprefix("Drive")),
        kind=kind,
        is_gateway=entry.sender == GATEWAY,
    )


def _signal(f: Field) -> SignalSpec:
    scale, offset = (float(text) if "." in text else int(text) for text in (f.scale, f.offset))
    return SignalSpec(
        f.name, f.start, f.length, f.signed, False, scale, offset, f.unit, f.low, f.high, f.code,
        f.start_raw or 0, _labels(f),
    )  # fmt: skip


def main(words: Sequence[str] = ()) -> int:
    """Rewrite the files beside this module; `--check` only lists those not as generated."""
    wrong = 0
    for name, fd in FILES.items():
        path, text = HERE / name, render(fd)
        if path.exists() and path.read_bytes() == text.encode("ascii"):
            continue
        if "--check" in words:
            sys.stderr.write(f"{name} is not what dbc.generate writes\n")
            wrong = 1
        else:
            path.write_text(text, encoding="ascii", newline="\n")
            sys.stdout.write(f"{name} written\n")
    return wrong


if __name__ == "__main__":
    raise SystemExit(main(sys.argv[1:]))
