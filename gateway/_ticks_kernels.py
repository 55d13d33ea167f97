"""Several ticks in one call, as long as none of them needs what only Python can do.

Every step is the loop that `Gateway.step` calls, in the same order, on the same arrays: the twin is
`step` itself. A tick that needs more is left where it does: the first stage that is not done.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from dbc._core_symbols import symbol
from dbc._lean import inlined, unlocked
from gateway._flags_kernels import fill_inputs, update_flags
from gateway._outbox_kernels import send
from gateway._receive_kernels import any_node_lost, bus_time, check_timeouts, receive_frames
from gateway._thermal_kernels import advance, hear, report

if TYPE_CHECKING:
    from dbc.records import Records
    from gateway.stretch import Filtering, Judging, Receiving, Saying, Warming, Went

Array = NDArray[np.float64]
Ints = NDArray[np.int64]
Bools = NDArray[np.bool_]

WHOLE, HEARD = range(2)
"""What is done of a tick: all, or everything up to here."""
_T_LOST = 9  # receiving.Tally
_C_REJECTED, _C_LOST = 1, 2  # sources.COUNTED
_assess_inputs, _run_filters = symbol("assess_inputs"), symbol("run_filters")
_observe_load, _detect_loss = symbol("observe_load"), symbol("detect_loss")


@inlined
def _count(tally: Ints, saying: Saying) -> None:
    """What is said of the frames so far; those before this call are in `saying`."""
    rejected = 0
    for k in range(tally.shape[0]):
        if saying.rejects[k]:
            rejected += tally[k]
    saying.counts[_C_REJECTED] = saying.rejected + rejected
    saying.counts[_C_LOST] = saying.lost + tally[_T_LOST]


@inlined
def _raise(peak: Array, drives: Records) -> None:
    """`numpy.fmax` of the loss probabilities in place: NaN is passed over."""
    for k in range(peak.shape[0]):
        lost = drives[k]["loss_probability"]
        # Not `>`: the first number meets a NaN.
        if not (lost <= peak[k] or math.isnan(lost)):
            peak[k] = lost


@unlocked
def several(
    t_ns: Ints, can_id: NDArray[np.uint32], flags: NDArray[np.uint8], length: NDArray[np.uint8],
    data: NDArray[np.uint8], ends: Ints, now: int, until: int, receiving: Receiving,
    filtering: Filtering, judging: Judging, warming: Warming,
    saying: Saying, went: Went,
) -> tuple[Any, ...]:  # fmt: skip
    """Ticks from `now` on, one for each of ends (K,), before `until`; stops behind a change.

    The first five are columns of a `Block`; tick k takes its rows from ends[k - 1] to ends[k].
    Fills `went`. Gives the fields of `Left`, not one of these: see `Direct`.
    """
    period, rows_of = receiving.period_ns, receiving.scratch.t_ns.shape[0]
    busy, out, first = receiving.busy_s, 0, 0
    done, stage = 0, WHOLE
    seen = 0
    changed = False
    for k in range(ends.shape[0]):
        last = ends[k]
        if now >= until or last - first > rows_of or out + went.most > went.message.shape[0]:
            break
        seen = 0
        odd = others = False
        if last > first:
            if not receive_frames(
                receiving.receiver, first, last, t_ns, can_id, flags, length, data, now
            ):
                break
            tick = receiving.tick[0]
            seen, odd = tick["temperatures"], tick["only_decoded"] == 0
            others = tick["emergencies"] + tick["unpaired"] + tick["late"] > 0
        else:
            check_timeouts(receiving.receiver, now)
        if others or any_node_lost(receiving.supervision, now):
            stage = HEARD
            break
        went.tally[0] += last - first
        if not odd:
            went.tally[1] += last - first
        busy = bus_time(
            receiving.receiver, first, last, can_id, flags, length, receiving.classic_s,
            receiving.fd_s, busy,
        )  # fmt: skip
        first = last
        inputs, told = filtering.inputs, filtering.told
        _assess_inputs(receiving.receiver, receiving.drive_channels, 0, now, receiving.input_status)
        _run_filters(
            filtering.estimator, receiving.receiver, receiving.input_status,
            told.estimates.ctypes.data, now,
        )  # fmt: skip
        _observe_load(filtering.motion, now)
        _detect_loss(
            judging.adhesion, told.estimates.ctypes.data, receiving.input_status, judging.drives,
            saying.status.drives.ctypes.data, now,
        )  # fmt: skip
        if seen:
            hear(seen, receiving.scratch, receiving.wiring, warming.warmth)
        advance(
            seen > 0, now, warming.summed, receiving.places, receiving.state, receiving.slow,
            warming.warmth,
        )  # fmt: skip
        report(now, warming.limit_ns, warming.warmth, saying.findings)
        fill_inputs(
            inputs, filtering.implausible, judging.uncertain, told, judging.lost, judging.known,
            judging.severe, saying.findings, receiving.pairs.sample_ns, saying.inputs,
        )  # fmt: skip
        saying.train_inputs[0]["common_mode"] = judging.common_mode[0]["state"]
        changed = update_flags(
            now, judging.rules, saying.train_inputs, saying.inputs, saying.evidence, saying.status
        )
        _raise(went.peak, saying.status.drives)
        _count(receiving.counters, saying)
        frames = send(
            now, saying.status, saying.counts, saying.sheet, saying.e2e_config,
            saying.memory, saying.room,
        )  # fmt: skip
        for i in range(frames):
            message = saying.room.message[i]
            went.message[out], went.tick[out] = message, k
            for j in range(went.payload.shape[1]):
                went.payload[out, j] = saying.room.payload[i, j]
            busy += saying.cost_s[message]
            out += 1
        done = k + 1
        now += period
        if changed:
            break
    return done, stage, first, seen, changed, out, busy
