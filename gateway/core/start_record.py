"""The state of a gateway between two ticks as bytes: a start record, from which a replay goes on.

It holds every array behind `struct gateway`, those with constants included, in the order in which
the constructors make them. A gateway of the same configuration and the same layout of records can
be restored from it; its next ticks then send the same bytes as the first gateway's would have.
Arrays that a tick fills in before it reads them are left out.
"""

from __future__ import annotations

import json
import zlib
from collections.abc import Iterator
from hashlib import sha256
from typing import Any, Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from dbc.codec import Codec
from dbc.frame import Nanos
from dbc.records import Addressed
from estimators.detect import WITH_MEMORY
from gateway.core.gateway import Gateway
from gateway.settings.config import Config, ConfigError

MAGIC: Final = b"traction-gateway start record"
TRANSIENT: Final = {"scratch", "workspace", "readings", "before", "samples", "sent", "frames"}
"""Attributes whose arrays a tick fills in before it reads them."""
ANEW: Final = "make it again with `traction-gateway shrink`"

Array = NDArray[Any]


class State(NamedTuple):
    """State of a gateway after a tick at `now_ns`: its arrays' bytes, and its Python state.

    added: frames that Python has counted; mapped: `Translator.memory`, empty without one.
    """

    now_ns: Nanos
    added: dict[str, int]
    mapped: str
    arrays: list[bytes]


def state_of(gateway: Gateway) -> State:
    """Copy the state. Raises ConfigError for a detector with memory outside of the core."""
    name = gateway.config.adhesion.detector
    if name in WITH_MEMORY and not gateway.adhesion.in_core:
        text = f"a start record cannot hold the state of {name}; take another detector"
        raise ConfigError("[adhesion] detector", [text])
    arrays = [array.tobytes() for array in _arrays(gateway)]
    mapped = "" if gateway.translator is None else gateway.translator.memory()
    return State(gateway.now_ns, dict(gateway.inbox.added), mapped, arrays)


def set_state(gateway: Gateway, state: State) -> None:
    """Put a gateway into `state`, taken from one of the same configuration."""
    for array, saved in zip(_arrays(gateway), state.arrays, strict=True):
        array[...] = np.frombuffer(saved, array.dtype).reshape(array.shape)
    gateway.inbox.added.clear()
    gateway.inbox.added.update(state.added)
    if gateway.translator is not None:
        gateway.translator.recall(state.mapped)
    for held in _holders(gateway):
        if isinstance(held, Addressed):
            held.link()  # the addresses were those of the other gateway
    gateway.resume(state.now_ns)


def start_bytes(gateway: Gateway, state: State) -> bytes:
    """The start record of a state of this gateway."""
    header = {
        "layout": _layout(gateway), "config": _config(gateway), "start_ns": gateway.start_ns,
        **state._replace(arrays=[])._asdict(),
    }  # fmt: skip
    packed = zlib.compress(b"".join(state.arrays), 9)
    rest = json.dumps(header).encode() + b"\n" + packed
    return b"\n".join((MAGIC, sha256(rest).hexdigest().encode(), rest))


def resumed(data: bytes, name: str, config: Config, codec: Codec) -> Gateway:
    """The gateway that goes on from a start record; name: of its file, for errors.

    Raises ConfigError for data that are no start record, are damaged, or belong to another
    configuration or to another version's records.
    """
    magic, checksum, rest = (*data.split(b"\n", 2), b"", b"")[:3]
    if magic != MAGIC:
        raise ConfigError(name, [f"is not a start record; {ANEW}"])
    if checksum != sha256(rest).hexdigest().encode():
        raise ConfigError(name, [f"is damaged: its checksum is wrong; {ANEW}"])
    header, _, packed = rest.partition(b"\n")
    found = json.loads(header)
    gateway = Gateway(config, codec, found["start_ns"])
    own = _config(gateway)
    if found["config"] != own:
        text = f"was made with configuration {found['config']}, this one is {own}"
        raise ConfigError(name, [f"{text}; give the same configuration, or {ANEW}"])
    if found["layout"] != _layout(gateway):
        raise ConfigError(name, [f"was made by another version of traction-gateway; {ANEW}"])
    sizes = [array.nbytes for array in _arrays(gateway)]
    saved, ends = zlib.decompress(packed), np.cumsum(sizes).tolist()
    arrays = [saved[end - size : end] for size, end in zip(sizes, ends, strict=True)]
    set_state(gateway, State(found["now_ns"], found["added"], found["mapped"], arrays))
    return gateway


def _config(gateway: Gateway) -> str:
    return f"{gateway.outbox.config_hash:06x}"


def _layout(gateway: Gateway) -> str:
    """Hash of types and shapes of all arrays; a type's text has the offsets of its fields."""
    text = "\n".join(f"{array.dtype} {array.shape}" for array in _arrays(gateway))
    return sha256(text.encode()).hexdigest()[:16]


def _arrays(gateway: Gateway) -> Iterator[Array]:
    """Arrays that own their numbers, each once."""
    seen: set[int] = set()
    for held in _holders(gateway):
        for value in _values(held):
            array = value
            while isinstance(getattr(array, "base", None), np.ndarray):
                array = array.base
            if isinstance(array, np.ndarray) and id(array) not in seen:
                seen.add(id(array))
                yield array


def _holders(root: object) -> list[Any]:
    """Everything below `root` that may hold arrays of the core's, in the order of attributes."""
    found: dict[int, Any] = {}
    todo = [root]
    while todo:
        one = todo.pop()
        if id(one) not in found:
            found[id(one)] = one
            todo += [value for value in _values(one) if _may_hold(value)]
    return list(found.values())


def _values(held: Any) -> list[Any]:
    if isinstance(held, tuple | list):
        return list(held)
    return [value for name, value in vars(held).items() if name not in TRANSIENT]


def _may_hold(value: object) -> bool:
    own = type(value).__module__.startswith("gateway.core") and hasattr(value, "__dict__")
    return own or isinstance(value, Addressed | tuple | list)
