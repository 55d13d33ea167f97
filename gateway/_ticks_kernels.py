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
from dbc._lean import inlined, lean, unlocked
from gateway._adhesion_kernels import compare, conclude, teach
from gateway._flags_kernels import fill_inputs, update_flags
from gateway._outbox_kernels import send
from gateway._receive_kernels import any_node_lost, bus_time, check_timeouts, receive_frames
from gateway._sweep_kernels import run_filters
from gateway._thermal_kernels import advance, hear, report
from gateway._train_kernels import assess_train
from gateway.pairing import Samples

if TYPE_CHECKING:
    from dbc.records import Records
    from gateway.stretch import Filtering, Judging, Receiving, Saying, Warming, Went

Array = NDArray[np.float64]
Ints = NDArray[np.int64]
Bools = NDArray[np.bool_]

WHOLE, HEARD, FILTERED = range(3)
"""What is done of a tick: all, or everything up to here."""
_T_LOST = 9  # receiving.Tally
_C_REJECTED, _C_LOST = 1, 2  # sources.COUNTED
_assess_inputs, _observe_load = symbol("assess_inputs"), symbol("observe_load")
_vb_detect = symbol("vb_detect")


@inlined
def _enough(usable: Bools) -> bool:
    """Two drives are known, the least that can be compared."""
    known = 0
    for k in range(usable.shape[0]):
        known += usable[k]
    return known >= 2


@lean
def _opinion(judging: Judging) -> float:
    """`VariationalDetector`: fills lost and known of `judging`, gives the common load."""
    known, room = judging.at.known, judging.room
    enough = _enough(known)
    for k in range(known.shape[0]):
        judging.lost[k] = 0.0
        judging.known[k] = enough and known[k]
    if not enough:
        return 0.0
    return _vb_detect(  # type: ignore[no-any-return]
        judging.priors.ctypes.data, judging.sweeps, room.referred.ctypes.data,
        room.spread.ctypes.data, known.ctypes.data, known.shape[0], judging.rough.ctypes.data,
        judging.lost.ctypes.data,
    )  # fmt: skip


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
    busy, common, out, first = receiving.busy_s, 0.0, 0, 0
    done, stage = 0, WHOLE
    samples = seen = motions = 0
    changed = False
    learn_ns = judging.learn_ns
    for k in range(ends.shape[0]):
        last = ends[k]
        if now >= until or last - first > rows_of or out + went.most > went.message.shape[0]:
            break
        samples = seen = motions = 0
        odd = others = False
        if last > first:
            if not receive_frames(
                receiving.receiver, first, last, t_ns, can_id, flags, length, data, now
            ):
                break
            tick = receiving.tick[0]
            samples, seen, motions = tick["samples"], tick["temperatures"], tick["motions"]
            odd = tick["only_decoded"] == 0
            others = tick["emergencies"] + tick["unpaired"] + tick["late"] + tick["restarts"] > 0
        else:
            check_timeouts(receiving.receiver, now)
        if (
            others or samples > filtering.room.samples.shape[0]
            or any_node_lost(receiving.supervision, now)
        ):  # fmt: skip
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
        inputs, told = filtering.inputs, filtering.believed.told
        _assess_inputs(receiving.receiver, receiving.drive_channels, 0, now, receiving.input_status)
        taken = Samples(
            receiving.out.drive[:samples], receiving.out.u[:samples], receiving.out.y[:samples],
            receiving.out.steps[:samples], receiving.out.gap[:samples],
        )  # fmt: skip
        if run_filters(
            taken, now, inputs.cause, inputs.fresh, filtering.believed, filtering.constants,
            filtering.room,
        ):  # fmt: skip
            stage = FILTERED
            break
        _observe_load(filtering.motion, now)
        assess_train(
            inputs.speed, inputs.commanded, receiving.slow, judging.flag, now, judging.tick_s,
            told, judging.train,
        )  # fmt: skip
        compare(
            told, receiving.slow, inputs.commanded, judging.flag, judging.since_ns, now,
            judging.tick_s, judging.rotors, judging.reference, judging.passing, judging.at,
            judging.responses, judging.room,
        )  # fmt: skip
        common = _opinion(judging)
        answered = conclude(
            judging.lost, judging.known, common, now, judging.tick_s, judging.own, judging.at,
            judging.responses, judging.train, judging.part, judging.spreads, judging.rules,
            judging.common_mode, judging.trust, judging.room,
        )  # fmt: skip
        due = now >= learn_ns
        if answered or due:
            if due:
                learn_ns = now + judging.every_ns
            teach(
                answered, due, now, judging.tick_s, common, judging.flag, receiving.slow.operating,
                judging.reference, judging.own, judging.at, judging.responses, judging.settled_ns,
                judging.probably, judging.trust, judging.room,
            )  # fmt: skip
        if seen:
            hear(seen, receiving.scratch, receiving.wiring, warming.warmth)
        advance(
            seen > 0, now, warming.summed, receiving.places, receiving.state, receiving.slow,
            warming.warmth,
        )  # fmt: skip
        report(now, warming.limit_ns, warming.warmth, saying.findings)
        lost, known = judging.room.lost, judging.room.known
        fill_inputs(
            inputs, filtering.implausible, judging.train.uncertain, told, lost, known,
            judging.room.severe, saying.findings, receiving.pairs.sample_ns, saying.inputs,
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
    return (
        done, stage, first, samples, seen, motions, changed, out, busy, common, learn_ns,
    )  # fmt: skip
