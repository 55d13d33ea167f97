"""Other formats through python-can: what was sent, error frames never data."""

from __future__ import annotations

from pathlib import Path

import can
import pytest

from dbc.frame import ERROR, EXTENDED, FD, MS, REMOTE, SECOND, TX, Frame
from dbc.frames import block_of
from dbc.logs.opening import open_reader
from dbc.logs.python_can import from_message, to_message
from gateway.logfiles.convert import frame_sink

T0 = 1_700_000_000.0
MESSAGES = [
    can.Message(T0, 0x181, is_extended_id=False, data=bytes(8), channel=0),
    can.Message(T0 + 0.002, 0x18FEF100, is_extended_id=True, data=b"\1\2", channel=0),
    can.Message(T0 + 0.004, 0x182, is_extended_id=False, is_remote_frame=True, dlc=4, channel=0),
    can.Message(
        T0 + 0.006, 0x183, is_extended_id=False, is_fd=True, bitrate_switch=True,
        data=bytes(range(64)), channel=0,
    ),
]  # fmt: skip


SENT = [
    Frame(round(T0) * SECOND, 0x181, b"\1", TX, "0"),
    Frame(round(T0) * SECOND + MS, 0x182, b"\2", 0, "0"),
    Frame(round(T0) * SECOND + 2 * MS, 0x18FEF100, b"\3", EXTENDED | TX, "0"),
    Frame(round(T0) * SECOND + 3 * MS, 0x183, bytes(12), FD | TX, "0"),
    Frame(round(T0) * SECOND + 4 * MS, 0x184, b"", REMOTE | TX, "0", 2),
]


@pytest.mark.parametrize("suffix", [".asc", ".blf", ".mf4"])
def test_python_can_and_we_mean_the_same_by_sent(tmp_path: Path, suffix: str) -> None:
    ours, theirs = tmp_path / f"ours{suffix}", tmp_path / f"theirs{suffix}"
    sink = frame_sink(ours, suffix)
    sink.add(block_of(SENT))
    sink.close()
    with can.LogReader(ours) as reader:
        seen = sorted((m.arbitration_id, m.is_rx) for m in reader)
    assert seen == sorted((f.can_id, not f.flags & TX) for f in SENT)
    with can.Logger(theirs) as logger:
        for frame in SENT[:4]:
            logger(to_message(frame))
    assert sorted((f.can_id, f.flags) for f in open_reader(theirs, strict=False)) == sorted(
        (f.can_id, f.flags) for f in SENT[:4]
    )


@pytest.mark.parametrize("suffix", [".asc", ".blf"])
def test_error_frames_of_a_file(tmp_path: Path, suffix: str) -> None:
    path = tmp_path / f"log{suffix}"
    error = can.Message(T0, 0x40, is_error_frame=True, is_extended_id=False, channel=0)
    with can.Logger(path) as logger:
        logger(error)
        logger(MESSAGES[0])
    assert [f.flags for f in open_reader(path, strict=False)] == [ERROR, 0]


def test_remote_length_and_channel() -> None:
    assert from_message(MESSAGES[2])._replace(t_ns=0) == Frame(0, 0x182, b"", REMOTE, "0", 4)
