"""Compiled loops of the inbox: which frames are ours and good, and the samples they make.

Scalar by nature, so their twins are the same functions uncompiled (`.py_func`); protection is
in C (`dbc/e2e.c`) already.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from dbc._codec_kernels import decode_frames
from dbc._e2e_kernels import e2e_check, e2e_sm_check
from dbc._lean import inlined, lean
from dbc.e2e import Check, SmState
from gateway import supervision
from gateway._guard_kernels import note_foul
from gateway._route_kernels import route
from gateway._slow_kernels import keep

if TYPE_CHECKING:
    from dbc.records import Records
    from gateway.channel import ChannelState
    from gateway.pairing import PairState, Samples, Wiring
    from gateway.receiving import Routes, Scratch
    from gateway.slow import Readings, SlowState
    from gateway.supervision import Beats

Array = NDArray[np.float64]
Ints = NDArray[np.int64]
Bytes = NDArray[np.uint8]

_NOT_AVAILABLE, _ABSENT = 1, 4  # dbc.spec
_CURRENTS, _VOLTAGES, _BLOCK, _MOTION, _TEMPERATURES, _STATUS = range(6)  # pairing.Kind
_GOOD, _MISSING, _OUTSIDE = 0, 1, 2  # pairing.Row
_UNPAIRED, _LATE, _ANY = 0, 1, 2  # pairing.Trouble
_SQRT3 = math.sqrt(3.0)
_SUM_SMOOTHING = 0.05
_EXTENDED, _REMOTE, _ERROR_FRAME, _FD = 1, 2, 4, 8  # dbc.frame
_SOME_LOST, _ERROR, _NO_NEW_DATA = map(int, (Check.OK_SOME_LOST, Check.ERROR, Check.NO_NEW_DATA))
_REPEATED = int(Check.REPEATED)
_SM_VALID, _SM_INVALID = int(SmState.VALID), int(SmState.INVALID)
_FINE, _STARTING, _STALE, _CORRUPTED, _SEQUENCE, _RANGE, _MISSING_VALUE = range(7)  # Reason
(
    _T_DECODED, _T_ERROR_FRAME, _T_REMOTE, _T_OWN, _T_TIME_BACK, _T_WRONG_LENGTH, _T_CRC,
    _T_REPEATED, _T_WRONG_SEQUENCE, _T_LOST, _T_NOT_YET_VALID, _T_NOT_AVAILABLE, _T_RANGE,
    _T_UNKNOWN_ID, _T_CANOPEN,
) = range(15)  # receiving.Tally  # fmt: skip
_OWN, _SUPERVISED = -2, -3  # receiving
_HEARTBEAT = supervision.HEARTBEAT_BASE
_note_beat = inlined(supervision.note_beat)
_note_guarding = inlined(supervision.note_guarding)


@inlined
def _verdict(row: int, c: int, wiring: Wiring, value: Array, validity: Bytes) -> int:
    """Whether every signal of a row may be used, and if not why."""
    quality = wiring.quality[c]
    missing = quality >= 0 and value[row, quality] != 1.0 and value[row, quality] != 2.0
    outside = False
    for k in range(wiring.width[c]):
        v = validity[row, k]
        if v == _NOT_AVAILABLE:
            missing = True
        elif v not in (0, _ABSENT):
            outside = True
    if missing:
        return _MISSING
    return _OUTSIDE if outside else _GOOD


@inlined
def _gap(
    state: PairState, d: int, counter: int, modulus: int, t: int, period: int, hole: int
) -> int:
    """Cycles missing before this sample; -1 if it is not newer than the last, -2 to start anew.

    The counter says how many cycles have passed, the stamps only which turn of it.
    """
    last = state.sample_ns[d]
    if last < 0 or t - last > hole:
        return -2
    delta = (counter - state.sequence[d]) % modulus
    turns = round(((t - last) / period - delta) / modulus)
    cycles = int(delta + modulus * turns)
    return cycles - 1 if cycles > 0 else -1


@inlined
def take_rows(
    channel: Ints,
    t_ns: Ints,
    payload: Bytes,
    value: Array,
    validity: Bytes,
    wiring: Wiring,
    hole_ns: int,
    state: PairState,
    verdict: Bytes,
    out: Samples,
) -> int:
    """Judge R decoded rows and turn the electrical ones into samples; returns their number.

    channel (R,), t_ns (R,), payload (R, 64), value and validity (R, S) as `Codec.decode_rows`;
    `wiring` has a row per channel, `state` a row per drive. Fills verdict (R,) and the rows of
    `out` (at least 8 R long). A drive that starts anew is marked in `state.restart`.
    """
    m = 0
    for r in range(channel.shape[0]):
        c = channel[r]
        verdict[r] = _verdict(r, c, wiring, value, validity)
        kind = wiring.kind[c]
        if kind > _BLOCK or verdict[r] != _GOOD:
            continue
        d = wiring.drive[c]
        cols = wiring.columns[c]
        if kind == _BLOCK and int(value[r, cols[0]]) % 8:
            verdict[r] = _OUTSIDE
            continue
        period = wiring.period_ns[c]
        t = t_ns[r]
        counter = payload[r, 1] & 0x0F
        modulus = 16
        if kind == _BLOCK:
            counter = int(value[r, cols[0]]) // 8
            modulus = 8192
        else:
            mine = state.half[d, kind, counter]
            if kind == _CURRENTS:
                a, b, e = value[r, cols[0]], value[r, cols[1]], value[r, cols[2]]
                # A real motor's phases sum to nothing; a slow average forgives noise.
                state.sum_error[d] += _SUM_SMOOTHING * (abs(a + b + e) - state.sum_error[d])
                mine[0] = (2.0 * a - b - e) / 3.0
                mine[1] = (b - e) / _SQRT3
            else:
                mine[0] = value[r, cols[0]]
                mine[1] = value[r, cols[1]]
            state.half_ns[d, kind, counter] = t
            other = state.half_ns[d, 1 - kind, counter]
            if other < 0:
                continue
            if abs(other - t) > 8 * period:
                # The older half belongs to an earlier turn of the counter.
                older = 1 - kind if other < t else kind
                state.half_ns[d, older, counter] = -1
                state.trouble[_UNPAIRED] += 1
                state.trouble[_ANY] = 1
                continue
            state.half_ns[d, 0, counter] = -1
            state.half_ns[d, 1, counter] = -1
            t = max(t, other)
        missing = _gap(state, d, counter, modulus, t, period, hole_ns)
        if missing == -1:
            state.trouble[_LATE] += 1
            state.trouble[_ANY] = 1
            continue
        if missing == -2:
            state.restart[d] = True
            state.trouble[_ANY] = 1
            missing = 0
        state.sequence[d] = counter
        state.sample_ns[d] = t
        steps = wiring.steps[c]
        if kind != _BLOCK:
            out.drive[m] = d
            for k in range(2):
                out.u[m, k] = state.half[d, _VOLTAGES, counter, k]
                out.y[m, k] = state.half[d, _CURRENTS, counter, k]
            out.steps[m] = steps
            out.gap[m] = missing * steps
            m += 1
            continue
        for k in range(8):
            a, b = value[r, cols[1 + 4 * k]], value[r, cols[2 + 4 * k]]
            out.drive[m] = d
            out.u[m, 0] = value[r, cols[3 + 4 * k]]
            out.u[m, 1] = value[r, cols[4 + 4 * k]]
            out.y[m, 0] = a
            out.y[m, 1] = (a + 2.0 * b) / _SQRT3
            out.steps[m] = 1
            out.gap[m] = 8 * missing if k == 0 else 0
            m += 1
    return m


@inlined
def _is_latest(data: Bytes, row: int, c: int, length: int, state: ChannelState) -> bool:
    """Whether a frame is the last one of channel c byte for byte; the next is compared with it."""
    same = True
    for k in range(length):
        same = same and data[row, k] == state.latest[c, k]
        state.latest[c, k] = data[row, k]
    return same


@inlined
def _admit(
    data: Bytes, row: int, c: int, t: int, config: Records, e2e: Records, state: ChannelState,
    tally: Ints,
) -> bool:  # fmt: skip
    """Whether a frame of channel c may be used: checksum, counter, and a valid receiver.

    A rejected frame updates nothing but counters and reasons.
    """
    check = e2e_check(data, row, c, config, e2e)
    if config[c]["profile"] == 0:
        state.last_ns[c] = t
        state.seen_valid[c] = True
        return True
    for _ in range(e2e[c]["missed"]):
        e2e_sm_check(c, _NO_NEW_DATA, e2e)
    valid = e2e_sm_check(c, check, e2e) == _SM_VALID
    if check != _ERROR:
        copy = _is_latest(data, row, c, config[c]["length"], state) and check == _REPEATED
        note_foul(c, t, int(e2e[c]["step"]), copy, state)
    if check <= _SOME_LOST:
        state.last_ns[c] = t
        tally[_T_LOST] += e2e[c]["missed"]
        # While it is invalid nothing gets in; at the start good frames do, and are not believed.
        invalid = e2e[c]["state"] == _SM_INVALID or t < state.guarded_ns[c]
        tally[_T_NOT_YET_VALID] += invalid
        state.seen_valid[c] |= valid
        return not invalid
    blame = _CORRUPTED if check == _ERROR else _SEQUENCE
    state.cause[c] = blame
    state.blame[c] = blame
    tally[_T_CRC + check - _ERROR] += 1
    return False


@inlined
def _unbelieved(c: int, now: int, config: Records, e2e: Records, state: ChannelState) -> int:
    """Why channel c is not believed at `now`; 0 if it is."""
    heard, last, cause = state.heard_ns[c], state.last_ns[c], state.cause[c]
    if heard < 0:
        return _STARTING
    if now - heard > state.limit_ns[c]:
        return _STALE
    if now < state.guarded_ns[c]:
        return _SEQUENCE
    if config[c]["profile"] != 0 and e2e[c]["state"] != _SM_VALID:
        # Single good frames do not end it; the last thing that went wrong is why.
        if state.blame[c] != _FINE:
            return int(state.blame[c])
        return _STALE if e2e[c]["state"] == _SM_INVALID else _STARTING
    if last < 0 or now - last > state.limit_ns[c]:
        return int(cause) if cause != _FINE else _STALE
    return int(cause) if cause in (_RANGE, _MISSING_VALUE) else _FINE


@inlined
def settle(now: int, config: Records, e2e: Records, state: ChannelState) -> None:
    """End of a tick: notice silence, and say why each channel is not believed (`reason`)."""
    for c in range(state.reason.shape[0]):
        if state.last_ns[c] >= 0 and now - state.last_ns[c] > state.limit_ns[c]:
            e2e_sm_check(c, _NO_NEW_DATA, e2e)
        state.reason[c] = _unbelieved(c, now, config, e2e, state)


@inlined
def _note(
    row: int, c: int, wiring: Wiring, state: ChannelState, scratch: Scratch, slow: SlowState,
    readings: Readings,
) -> bool:  # fmt: skip
    """Keep what a decoded row says, and whether it could be used; true if Python must see it."""
    verdict = scratch.verdict[row]
    t = scratch.t_ns[row]
    kind = wiring.kind[c]
    if kind == _TEMPERATURES:
        # Each point by itself: one dead sensor must not silence the other three.
        quality = wiring.quality[c]
        usable = quality < 0 or scratch.value[row, quality] in (1.0, 2.0)
        state.cause[c] = _FINE if usable else _MISSING_VALUE
        for k in range(wiring.points[c]):
            if usable and scratch.validity[row, wiring.columns[c, k]] == 0:
                state.good_ns[c] = t
    elif verdict == _GOOD:
        state.cause[c] = _FINE
        state.good_ns[c] = t
        if kind > _BLOCK:
            keep(row, c, wiring, scratch, slow, readings)
    else:
        state.cause[c] = _MISSING_VALUE if verdict == _MISSING else _RANGE
    tally = (_T_DECODED, _T_NOT_AVAILABLE, _T_RANGE)[verdict]
    scratch.tally[tally] += 1
    return bool(kind == _TEMPERATURES)


@inlined
def _in_order(t_ns: Ints, can_id: NDArray[np.uint32]) -> bool:
    """Whether `dbc.block.Block.ordered` has nothing to do."""
    for k in range(1, t_ns.shape[0]):
        if t_ns[k] < t_ns[k - 1] or (t_ns[k] == t_ns[k - 1] and can_id[k] < can_id[k - 1]):
            return False
    return True


@lean
def take_block(
    t_ns: Ints,
    can_id: NDArray[np.uint32],
    flags: Bytes,
    length: Bytes,
    data: Bytes,
    now: int,
    routes: Routes,
    config: Records,
    e2e: Records,
    state: ChannelState,
    codec: int,
    wiring: Wiring,
    hole_ns: int,
    pairs: PairState,
    slow: SlowState,
    scratch: Scratch,
    readings: Readings,
    out: Samples,
    beats: Beats,
) -> tuple[int, int, int, bool]:
    """A tick's frames, in order: route, verify, decode, pair. Every frame ends in one tally.

    The first five are columns of a `dbc.block.Block`; codec: `CodecTables.address`. Returns the
    numbers of samples in `out`, of rows that Python must see (`scratch.seen`) and of emergencies
    (`scratch.foreign`); then whether anything but `decoded` was counted, else the tally is
    empty again. -1 first, and nothing done, for frames in another order.
    """
    if not _in_order(t_ns, can_id):
        return -1, 0, 0, False
    m = foreign = 0
    for r in range(t_ns.shape[0]):
        if flags[r] & (_ERROR_FRAME | _REMOTE):
            scratch.tally[_T_ERROR_FRAME if flags[r] & _ERROR_FRAME else _T_REMOTE] += 1
            if not flags[r] & (_ERROR_FRAME | _EXTENDED):
                _note_guarding(np.int64(can_id[r]), beats)
            continue
        c = route(can_id[r], flags[r], routes)
        if c == _OWN:
            scratch.tally[_T_OWN] += 1
            continue
        t = t_ns[r]
        if c < 0:
            if t < 0 or t > now:
                # A heartbeat from the future would keep its node alive until then.
                scratch.tally[_T_TIME_BACK] += 1
            elif c != _SUPERVISED:
                scratch.tally[_T_UNKNOWN_ID] += 1
            elif can_id[r] >= _HEARTBEAT:
                node = beats.row[can_id[r] - _HEARTBEAT]
                _note_beat(node, t, length[r], flags[r] & _FD == 0, data[r, 0], beats)
                scratch.tally[_T_CANOPEN] += 1
            else:
                scratch.foreign[foreign] = r
                foreign += 1
            continue
        # Below 0 there is no time: -1 stands for none.
        if t < 0 or t > now or t < state.last_ns[c]:
            scratch.tally[_T_TIME_BACK] += 1
            continue
        state.heard_ns[c] = t
        if length[r] != config[c]["length"] or flags[r] & _FD != config[c]["fd"]:
            # One with our id that cannot be our message is as bad as a wrong checksum.
            scratch.tally[_T_WRONG_LENGTH] += 1
            e2e_sm_check(c, _ERROR, e2e)
            state.cause[c] = _CORRUPTED
            state.blame[c] = _CORRUPTED
        elif _admit(data, r, c, t, config, e2e, state, scratch.tally):
            scratch.channel[m] = c
            scratch.message[m] = wiring.message[c]
            scratch.t_ns[m] = t
            for k in range(data.shape[1]):
                scratch.payload[m, k] = data[r, k]
            m += 1
    samples = seen = 0
    if m:
        channel, stamps, payload = scratch.channel[:m], scratch.t_ns[:m], scratch.payload[:m]
        value, validity = scratch.value[:m], scratch.validity[:m]
        decode_frames(codec, m, scratch.message, scratch.payload, scratch.value, scratch.validity)
        samples = take_rows(
            channel, stamps, payload, value, validity, wiring, hole_ns, pairs,
            scratch.verdict[:m], out,
        )  # fmt: skip
        for row in range(m):
            if _note(row, channel[row], wiring, state, scratch, slow, readings):
                scratch.seen[seen] = row
                seen += 1
    settle(now, config, e2e, state)
    odd = scratch.tally[_T_DECODED] != t_ns.shape[0]
    for k in range(_T_DECODED + 1, scratch.tally.shape[0]):
        odd = odd or scratch.tally[k] != 0
    if not odd:
        scratch.tally[_T_DECODED] = 0
    return samples, seen, foreign, odd
