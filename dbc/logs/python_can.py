"""python-can's messages as our frames and back; logs that only python-can reads (`.db`)."""

from __future__ import annotations

import importlib
from collections.abc import Iterator
from importlib.util import find_spec
from types import ModuleType
from typing import TYPE_CHECKING

from dbc.candump.reader import LogError
from dbc.frame import BRS, ERROR, ESI, EXTENDED, FD, REMOTE, SECOND, TX, Frame
from dbc.logs.format import CLASSIC_BYTES
from dbc.logs.objects import ObjectReader

if TYPE_CHECKING:
    import can


class PythonCan(ObjectReader):
    """A log read by the reader that python-can has for its ending.

    python-can's time is a float in seconds. It is rounded to the nearest nanosecond, and exact to
    about 0.2 us at today's dates. Its readers stop at the first fault.
    """

    def frames(self) -> Iterator[Frame]:
        """Yield all frames. Raises LogError for a file that python-can cannot read."""
        import can

        count = 0
        try:
            with can.LogReader(self.path) as reader:
                for message in reader:
                    count += 1
                    yield from_message(message)
        except Exception as error:  # its readers raise anything from IndexError to struct.error
            text = " ".join(str(error).split()) or type(error).__name__
            where = f" after {count} frames" if count else ""
            raise LogError(self.name, 0, f"cannot be read{where}: {text}") from error


def mf4_module() -> ModuleType:
    """`can.io.mf4` with asammdf, without which a program that starts on a bus loads python-can.

    The module is reloaded into its own namespace, in which its existing classes look up names.
    """
    from can.io import mf4

    if getattr(mf4, "asammdf", None) is None and find_spec("asammdf") is not None:
        importlib.reload(mf4)
    return mf4


def from_message(message: can.Message) -> Frame:
    """A python-can message as a frame."""
    flags = 0
    if message.is_error_frame:
        flags = ERROR
    else:
        flags |= EXTENDED if message.is_extended_id else 0
        flags |= REMOTE if message.is_remote_frame else 0
        # A `.db` log does not keep whether a frame is a CAN FD frame.
        if message.is_fd or (message.data and len(message.data) > CLASSIC_BYTES):
            flags |= FD
            flags |= BRS if message.bitrate_switch else 0
            flags |= ESI if message.error_state_indicator else 0
    flags |= 0 if message.is_rx else TX
    data = b"" if message.is_remote_frame else bytes(message.data)
    dlc = message.dlc if message.is_remote_frame and message.dlc else -1
    channel = "" if message.channel is None else str(message.channel)
    t_ns = round(message.timestamp * SECOND)
    return Frame(t_ns, message.arbitration_id & 0x1FFF_FFFF, data, flags, channel, dlc)


def to_message(frame: Frame) -> can.Message:
    """A frame as a python-can message; a raw DLC of 9..15 becomes the data length."""
    import can

    flags = frame.flags
    remote = bool(flags & REMOTE)
    return can.Message(
        timestamp=frame.t_ns / SECOND,
        arbitration_id=frame.can_id,
        is_extended_id=bool(flags & EXTENDED),
        is_remote_frame=remote,
        is_error_frame=bool(flags & ERROR),
        is_rx=not flags & TX,
        is_fd=bool(flags & FD),
        bitrate_switch=bool(flags & BRS),
        error_state_indicator=bool(flags & ESI),
        channel=frame.channel or None,
        dlc=max(frame.dlc, 0) if remote else len(frame.data),
        data=None if remote else frame.data,
    )
