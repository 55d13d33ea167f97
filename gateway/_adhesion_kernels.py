"""The adhesion side around the detector, in one call before it and one after.

Loops over drives, whose twin is the same function uncompiled; what they call is in C, or in
`_loads_kernels`.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np
from _traction_core import lib
from numpy.typing import NDArray

from dbc._lean import inlined, lean
from gateway._detect_kernels import (
    fuse_loss,
    is_asked,
    is_coasting,
    is_severe_loss,
    learn_responses,
    normalise,
    respond,
    update_reference,
)
from gateway._flags_kernels import debounce_common_mode, loss_evidence
from gateway._loads_kernels import prepare
from gateway.loads import FOLLOWING_NS, LEAST_LOAD, LOAD_TAU_S, MORE_LOAD

if TYPE_CHECKING:
    from dbc.records import Records
    from gateway.loads import Instant, LoadReference, Room, Rotors, Trust
    from gateway.slow import SlowState
    from gateway.tracks import Told
    from gateway.train import Train

Array = NDArray[np.float64]
Ints = NDArray[np.int64]
Bools = NDArray[np.bool_]

UNDECIDED = lib.UNDECIDED
"""Probability at which no flag changes."""
_UNKNOWN, _GOOD, _BAD = 0, 1, 2  # Flag
_NEVER = -(1 << 63)


@lean
def compare(
    told: Told, slow: SlowState, fresh: Bools, flag: Ints, since_ns: Ints, now: int, tick_s: float,
    rotors: Rotors, reference: LoadReference, passing: float, at: Instant, responses: Records,
    room: Room,
) -> None:  # fmt: skip
    """Everything the detector is given: see `prepare` and `normalise`."""
    prepare(told, slow, fresh, flag, since_ns, now, tick_s, rotors, at, responses)
    normalise(reference, at, passing, room)


@inlined
def _common_mode(at: Instant, responses: Records, alone: Array, rules: Records) -> int:
    """Evidence of a loss of all drives at once. One that holds says no; yes needs all known.

    Drives that coast say nothing.
    """
    judged, every, some = True, True, False
    lost = 1.0
    for k in range(alone.shape[0]):
        if not at.known[k]:
            every = False
            continue
        some = some or not is_coasting(k, responses)
        judged = judged and responses[k]["usable"] != 0
        lost = min(lost, alone[k])
    if not (some and judged) or not (every or lost <= rules[0]["clear_probability"]):
        return _UNKNOWN
    return loss_evidence(lost, rules)  # type: ignore[no-any-return,unused-ignore]


@inlined
def _enough_load(lost: Array, known: Bools, common: float, tick_s: float, trust: Trust) -> None:
    """A comparison of drives that carry next to nothing is none, and with little accuses nobody."""
    some = False
    for k in range(known.shape[0]):
        some = some or known[k]
    if not some:
        trust.common[0] = math.nan
        return
    if math.isnan(trust.common[0]):
        trust.common[0] = common
    trust.common[0] += min(tick_s / LOAD_TAU_S, 1.0) * (common - trust.common[0])
    least = LEAST_LOAD if trust.loaded[0] else MORE_LOAD
    trust.loaded[0] = abs(trust.common[0]) >= least
    little = min(abs(trust.common[0]), abs(common)) < MORE_LOAD
    for k in range(known.shape[0]):
        accused = little and lost[k] > UNDECIDED
        known[k] = known[k] and trust.loaded[0] and not accused


@lean
def conclude(
    lost: Array, known: Bools, common: float, now: int, tick_s: float, own: LoadReference,
    at: Instant, responses: Records, train: Train, part: float, spreads: float, rules: Records,
    common_mode: Records, trust: Trust, room: Room,
) -> bool:  # fmt: skip
    """The detector's opinion with every drive's own response; who is severely lost; common mode.

    lost, known (N,), common: its opinion, changed where it rests on too little load; train: who
    runs away, and whose command is odd, which accuses nobody; own: what is learnt of responses;
    part, spreads: as for `is_severe_loss`;
    common_mode: the flag of all drives' loss. Fills lost, known, severe and since when loads
    are known. True where a drive's load answers a new command.
    """
    for k in range(lost.shape[0]):
        room.alone[k] = respond(k, responses, own, tick_s, room.meant)
        if train.rotors[k]["odd_s"] > 0.0:
            room.alone[k] = min(room.alone[k], UNDECIDED)
    _enough_load(lost, known, common, tick_s, trust)
    for k in range(lost.shape[0]):
        away = train.rotors[k]["away"] != 0
        room.lost[k] = fuse_loss(k, responses, lost[k], known[k], away, room)
        room.known[k] = known[k] or is_asked(k, responses)
        # Nor is one lost that carries more than it is asked to.
        doubted = now < train.doubt_ns[k] or train.rotors[k]["uncommanded_s"] > 0.0
        if doubted and room.lost[k] > UNDECIDED:
            room.lost[k] = UNDECIDED
            train.uncertain[k] = 1
    answered = False
    for k in range(lost.shape[0]):
        severe = is_severe_loss(k, responses, common, room, part, spreads)
        room.severe[k] = at.known[k] and severe
        if not at.known[k]:
            trust.known_ns[k] = _NEVER
        elif trust.known_ns[k] == _NEVER:
            trust.known_ns[k] = now
        answered = answered or responses[k]["command_age_s"] < tick_s
    debounce_common_mode(common_mode, _common_mode(at, responses, room.alone, rules), now, rules)
    return answered


@inlined
def _healthy(
    now: int, flag: Ints, operating: Bools, settled_ns: int, probably: float, trust: Trust,
    room: Room,
) -> None:  # fmt: skip
    """Drives that may be learnt from: none while any is lost, or finds its grip again."""
    for k in range(flag.shape[0]):
        # A drive that is cut out keeps its flag, and stops nobody from learning.
        if flag[k] == _BAD and operating[k]:
            trust.bad_ns[0] = now
    shaken = trust.bad_ns[0] != _NEVER and now < trust.bad_ns[0] + FOLLOWING_NS
    for k in range(flag.shape[0]):
        since = trust.known_ns[k]
        settled = since != _NEVER and now - since >= settled_ns and flag[k] == _GOOD
        sure = room.known[k] and room.lost[k] < probably
        room.healthy[k] = settled and sure and not shaken


@lean
def teach(
    answered: bool, due: bool, now: int, tick_s: float, common: float, flag: Ints, operating: Bools,
    reference: LoadReference, own: LoadReference, at: Instant, responses: Records, settled_ns: int,
    probably: float, trust: Trust, room: Room,
) -> None:  # fmt: skip
    """Responses from new commands (`answered`), differences between drives when they are `due`.

    settled_ns: a load must have been known for so long; probably: a loss more probable than this is
    not learnt from.
    """
    _healthy(now, flag, operating, settled_ns, probably, trust, room)
    if answered:
        learn_responses(responses, own, room.healthy, tick_s, room.observed)
    if due:
        for k in range(flag.shape[0]):
            one = room.observed[k]
            one["load"], one["common"] = at.load[k] / at.share[k], common
            one["known"], one["healthy"] = at.known[k], room.healthy[k]
        update_reference(reference, room.observed)
