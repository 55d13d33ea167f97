"""Options to a bus: our own raw socket for SocketCAN, python-can for everything else."""

from __future__ import annotations

from argparse import Namespace
from collections.abc import Mapping
from typing import Any

from gateway.config import ConfigError
from gateway.drivers.pythoncan import PythonCan, complete
from gateway.drivers.socketcan import SocketCan
from gateway.drivers.transport import Allow, Guarded, Transport

_BUS_KEYS = ("interface", "channel", "bitrate", "fd", "data_bitrate", "timing", "can_filters")


def bus_options(options: Namespace | Mapping[str, Any]) -> dict[str, Any]:
    """The bus part of parsed arguments (python-can's `add_bus_arguments`) or of a mapping."""
    given = dict(vars(options)) if isinstance(options, Namespace) else dict(options)
    chosen = {key: given[key] for key in _BUS_KEYS if given.get(key) is not None}
    return {**chosen, **(given.get("bus_kwargs") or {})}


def open_transport(options: Namespace | Mapping[str, Any], allow: Allow | None = None) -> Transport:
    """Make and open the transport that the options name.

    Where interface or channel are missing, python-can's own sources decide (`CAN_INTERFACE`,
    `can.conf` ..). Without `allow` anything may be sent (simulated drives).
    Raises ConfigError if no interface is named or an option cannot be meant.
    """
    chosen = bus_options(options)
    if "interface" not in chosen or "channel" not in chosen:
        chosen = complete(chosen)
    inner: Transport
    if chosen["interface"] == "socketcan":
        unknown = sorted(set(chosen) - set(_BUS_KEYS))
        if unknown:
            raise ConfigError("bus", [f"{key}: not an option of socketcan" for key in unknown])
        inner = SocketCan(str(chosen["channel"]), fd=bool(chosen.get("fd", False)))
    else:
        inner = PythonCan(chosen)
    transport = inner if allow is None else Guarded(inner, allow, str(chosen["channel"]))
    transport.open()
    return transport
