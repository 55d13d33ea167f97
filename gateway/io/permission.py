"""The transmit allow-list of each command. No other frame is ever sent."""

from __future__ import annotations

from collections.abc import Iterable
from enum import StrEnum

from dbc.codec import Codec
from gateway.core.supervision import EMCY_BASE, HEARTBEAT_BASE
from gateway.io.transport import Allow
from gateway.settings.config import Config


class Mode(StrEnum):
    """How a command runs the gateway on a bus."""

    RUN = "run"
    """The gateway in service: its own messages; NMT start only as configured master."""
    LISTEN = "listen"
    """The gateway in service, only listening."""
    HIL = "hil"
    """The gateway on a test bench: it starts the simulated drives."""


def allowed(mode: Mode, config: Config, codec: Codec) -> Allow:
    """The allow-list of a mode, for the channels of `[bus] send_on`."""
    if mode is Mode.LISTEN:
        return Allow({})
    return Allow.from_codec(
        codec,
        config.nodes,
        nmt_master=mode is Mode.HIL or config.canopen.nmt_master,
        authenticated=config.authentication is not None,
        creep=config.adhesion.send_creep,
        channels=config.bus.send_on,
    )


def drives_only(codec: Codec, nodes: Iterable[int]) -> Allow:
    """The allow-list of simulated drives: messages, heartbeat, EMCY and answers of SDO servers."""
    nodes = frozenset(nodes)
    lengths = {
        spec.key: (spec.length, spec.is_fd)
        for spec in codec.messages
        if not spec.is_gateway and spec.node in nodes
    }
    for node in nodes:
        lengths |= {HEARTBEAT_BASE + node: (1, False)}
        lengths |= {base + node: (8, False) for base in (EMCY_BASE, 0x580)}
    return Allow(lengths)
