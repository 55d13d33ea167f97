"""Open a bus from options: the gateway's own raw socket for SocketCAN, else python-can."""

from __future__ import annotations

from argparse import Namespace
from collections.abc import Mapping
from typing import Any

from gateway.io.links import Links
from gateway.io.pythoncan import PythonCan, complete
from gateway.io.socketcan import SocketCan
from gateway.io.transport import Allow, Guarded, LinkState, Transport
from gateway.settings.config import ConfigError

_BUS_KEYS = ("interface", "channel", "bitrate", "fd", "data_bitrate", "timing", "can_filters")


def bus_options(options: Namespace | Mapping[str, Any]) -> dict[str, Any]:
    """The bus options of parsed arguments (python-can's `add_bus_arguments`) or of a mapping."""
    given = dict(vars(options)) if isinstance(options, Namespace) else dict(options)
    chosen = {key: given[key] for key in _BUS_KEYS if given.get(key) is not None}
    return {**chosen, **(given.get("bus_kwargs") or {})}


def open_transport(options: Namespace | Mapping[str, Any], allow: Allow | None = None) -> Transport:
    """Make and open the transport that the options name.

    If interface or channel is missing, python-can's own sources supply it (`CAN_INTERFACE`,
    `can.conf` ..). Without `allow` any frame may be sent, even late (for simulated drives).
    Raises ConfigError if no interface is named or an option cannot be used.
    """
    chosen = bus_options(options)
    if "interface" not in chosen or "channel" not in chosen:
        chosen = complete(chosen)
    inner: Transport
    if chosen["interface"] == "socketcan":
        if "channel" not in chosen:
            raise ConfigError("bus", ["socketcan needs a channel: name one, such as -c can0"])
        unknown = sorted(set(chosen) - set(_BUS_KEYS))
        if unknown:
            raise ConfigError("bus", [f"{key}: not an option of socketcan" for key in unknown])
        channel, fd = str(chosen["channel"]), bool(chosen.get("fd", False))
        if allow is None:
            inner = SocketCan(channel, fd=fd)
        else:
            bitrate, data_bitrate = (int(chosen.get(k) or 0) for k in ("bitrate", "data_bitrate"))
            links = Links(channel, bitrate, data_bitrate)
            inner = SocketCan(channel, fd=fd, newest=True, links=links)
    else:
        inner = PythonCan(chosen)
    transport = inner if allow is None else Guarded(inner, allow, str(chosen.get("channel", "")))
    transport.open()
    return transport


def open_present(options: Namespace | Mapping[str, Any], allow: Allow | None = None) -> Transport:
    """`open_transport` for a run that proves nothing without its bus: an absent one is an error.

    Raises ConfigError as `open_transport` does, or if the interface is absent.
    """
    transport = open_transport(options, allow)
    if transport.status.state is LinkState.ABSENT:
        note = transport.status.note.rstrip(".")
        transport.close()
        raise ConfigError("bus", [f"{note}; connect it, or name another one with -i and -c"])
    return transport
