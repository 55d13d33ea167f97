"""Load references and responses of the compiled core for loops that numba still compiles."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from dbc._core_symbols import symbol
from dbc._lean import inlined
from dbc.records import COMMAND_RESPONSE, LOAD_RATIO

if TYPE_CHECKING:
    from dbc.records import Records
    from gateway.loads import Instant, LoadReference, Room

Array = NDArray[np.float64]
Bools = NDArray[np.bool_]

_RATIO, _RESPONSE = LOAD_RATIO.itemsize, COMMAND_RESPONSE.itemsize
_normalise, _sigma = symbol("normalise_load"), symbol("normalised_sigma")
_update_spread, _update_ratios = symbol("update_spread"), symbol("update_ratios")
_respond, _learn = symbol("respond"), symbol("learn_responses")
_coasts, _asked = symbol("is_coasting"), symbol("is_asked")
_fuse, _severe = symbol("fuse_loss"), symbol("is_severe_loss")


@inlined
def normalise(reference: LoadReference, at: Instant, transient: float, room: Room) -> None:
    """Fills referred and spread of `room`: loads as if the drives were equal, and their sigma."""
    for k in range(at.load.shape[0]):
        drive = reference.drives.ctypes.data + k * _RATIO
        load, share = at.load[k], at.share[k]
        room.referred[k] = _normalise(drive, load, share)
        room.spread[k] = _sigma(reference.all.ctypes.data, drive, load, share, transient)


@inlined
def update_reference(reference: LoadReference, observed: Records) -> None:
    """`update_spread` and `update_ratios` of drives that are compared with one another."""
    n, all_, drives = observed.shape[0], reference.all.ctypes.data, reference.drives.ctypes.data
    _update_spread(all_, drives, observed.ctypes.data, n, 1)
    _update_ratios(all_, drives, observed.ctypes.data, n, 1)


@inlined
def learn_responses(
    responses: Records, own: LoadReference, healthy: Bools, tick_s: float, observed: Records
) -> None:
    """`learn_responses`; observed (N,): its workspace."""
    _learn(
        responses.ctypes.data, own.all.ctypes.data, own.drives.ctypes.data, healthy.ctypes.data,
        responses.shape[0], tick_s, observed.ctypes.data,
    )  # fmt: skip


@inlined
def respond(k: int, responses: Records, own: LoadReference, tick_s: float, valid: Bools) -> float:
    """`respond` of drive k; valid (N,): filled for it."""
    return _respond(  # type: ignore[no-any-return]
        responses.ctypes.data + k * _RESPONSE, own.all.ctypes.data,
        own.drives.ctypes.data + k * _RATIO, tick_s, valid.ctypes.data + k,
    )  # fmt: skip


@inlined
def is_coasting(k: int, responses: Records) -> bool:
    """`is_coasting` of drive k."""
    return _coasts(responses.ctypes.data + k * _RESPONSE) != 0  # type: ignore[no-any-return]


@inlined
def is_asked(k: int, responses: Records) -> bool:
    """`is_asked` of drive k."""
    return _asked(responses.ctypes.data + k * _RESPONSE) != 0  # type: ignore[no-any-return]


@inlined
def fuse_loss(
    k: int, responses: Records, lost: float, known: bool, runs_away: bool, room: Room
) -> float:
    """`fuse_loss` of drive k; lost, known: of the comparison."""
    return _fuse(  # type: ignore[no-any-return]
        responses.ctypes.data + k * _RESPONSE, lost, known, room.alone[k], room.meant[k], runs_away
    )


@inlined
def is_severe_loss(
    k: int, responses: Records, common: float, room: Room, part: float, spreads: float
) -> bool:
    """`is_severe_loss` of drive k."""
    drive = responses.ctypes.data + k * _RESPONSE
    return _severe(drive, common, room.referred[k], room.spread[k], part, spreads) != 0  # type: ignore[no-any-return]
