"""Several ticks in one call, as long as none of them needs what only Python can do.

Every step is the loop that `Gateway.step` calls, in the same order, on the same arrays: the twin is
`step` itself. A tick that needs more is left where it does: the first stage that is not done.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from dbc._lean import inlined, lean, unlocked
from estimators.detect._kernels import judge_few
from estimators.detect.reference import Reference
from estimators.detect.response import Memory
from gateway import supervision
from gateway._adhesion_kernels import compare, conclude, teach
from gateway._inputs_kernels import look
from gateway._kernels import settle, take_block
from gateway._motion_kernels import merge_motion, observe_motion
from gateway._outbox_kernels import send
from gateway._plausibility_kernels import check_values
from gateway._route_kernels import busy_s
from gateway._said_kernels import decide, tell, weigh
from gateway._sweep_kernels import advance_ekf, advance_ukf
from gateway._thermal_kernels import advance, hear, report
from gateway._train_kernels import assess_train
from gateway.pairing import Samples

if TYPE_CHECKING:
    from gateway.stretch import Filtering, Judging, Receiving, Saying, Warming, Went

Array = NDArray[np.float64]
Ints = NDArray[np.int64]
Bools = NDArray[np.bool_]

WHOLE, HEARD, FILTERED = range(3)
"""What is done of a tick: all, or everything up to here."""
_ANY = 2  # pairing.Trouble
_T_LOST = 9  # receiving.Tally
_C_REJECTED, _C_LOST = 1, 2  # sources.COUNTED
_READINGS, _CHANGED = 0, 1  # slow.Count
_NONE = 0  # Reason
_any_lost = lean(supervision.any_lost)


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
    return judge_few(  # type: ignore[no-any-return,unused-ignore]
        room.referred, room.spread, known, judging.priors, judging.sweeps, judging.rough,
        judging.lost,
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
def _raise(peak: Array, lost: Array) -> None:
    """`numpy.fmax` in place: NaN is passed over."""
    for k in range(peak.shape[0]):
        # Not `>`: the first number meets a NaN.
        if not (lost[k] <= peak[k] or math.isnan(lost[k])):
            peak[k] = lost[k]


@unlocked
def several(
    t_ns: Ints, can_id: NDArray[np.uint32], flags: NDArray[np.uint8], length: NDArray[np.uint8],
    data: NDArray[np.uint8], ends: Ints, now: int, until: int, receiving: Receiving,
    filtering: Filtering, unscented: bool | None, judging: Judging, warming: Warming,
    saying: Saying, went: Went,
) -> tuple[Any, ...]:  # fmt: skip
    """Ticks from `now` on, one for each of ends (K,), before `until`; stops behind a change.

    The first five are columns of a `Block`; tick k takes its rows from ends[k - 1] to ends[k].
    unscented: None for the EKF. Fills `went`. Gives the fields of `Left`, not one of these: see
    `Direct`.
    """
    period, rows_of = receiving.period_ns, receiving.scratch.t_ns.shape[0]
    busy, common, out, first = receiving.busy_s, 0.0, 0, 0
    done, stage = 0, WHOLE
    samples = seen = foreign = motions = 0
    odd = changed = False
    learn_ns, reference, response = judging.learn_ns, judging.reference, judging.response
    for k in range(ends.shape[0]):
        last = ends[k]
        if now >= until or last - first > rows_of or out + went.most > went.message.shape[0]:
            break
        samples = seen = foreign = motions = 0
        odd = False
        if last > first:
            samples, seen, foreign, odd = take_block(
                t_ns[first:last], can_id[first:last], flags[first:last], length[first:last],
                data[first:last], now, receiving.routes, receiving.e2e_config, receiving.e2e_state,
                receiving.state, receiving.tables, receiving.wiring, receiving.hole_ns,
                receiving.pairs, receiving.slow, receiving.scratch, receiving.readings,
                receiving.out, receiving.beats,
            )  # fmt: skip
            if samples < 0:
                break
        else:
            settle(now, receiving.e2e_config, receiving.e2e_state, receiving.state)
        if (
            foreign or receiving.pairs.trouble[_ANY] or samples > filtering.room.nis.shape[0]
            or _any_lost(now, receiving.beats)
        ):  # fmt: skip
            stage = HEARD
            break
        went.tally[0] += last - first
        if not odd:
            went.tally[1] += last - first
        if receiving.slow.came[_CHANGED]:
            motions = receiving.slow.came[_READINGS]
            receiving.slow.came[:] = 0
        busy = busy_s(
            busy, can_id[first:last], flags[first:last], length[first:last], receiving.routes,
            receiving.classic_s, receiving.fd_s,
        )  # fmt: skip
        first = last
        inputs, told = filtering.inputs, filtering.believed.told
        look(
            now, receiving.lost, False, receiving.places, receiving.state, receiving.pairs,
            receiving.slow, inputs,
        )  # fmt: skip
        taken = Samples(
            receiving.out.drive[:samples], receiving.out.u[:samples], receiving.out.y[:samples],
            receiving.out.steps[:samples], receiving.out.gap[:samples],
        )  # fmt: skip
        if unscented is None:
            begins = advance_ekf(
                taken, now, inputs.cause, inputs.fresh, filtering.believed, filtering.constants,
                filtering.room,
            )  # fmt: skip
        else:
            begins = advance_ukf(
                taken, now, inputs.cause, inputs.fresh, filtering.believed, filtering.constants,
                filtering.room,
            )  # fmt: skip
        if begins:
            stage = FILTERED
            break
        observe_motion(
            receiving.readings, motions, filtering.believed.tracks.flux, filtering.motion,
            filtering.limits,
        )  # fmt: skip
        check_values(
            taken, receiving.pairs.sample_ns, receiving.readings, motions, inputs.speed,
            receiving.slow, now, filtering.believed.chords, filtering.believed.filters,
            filtering.believed.tracks, told, filtering.motion, filtering.check,
            filtering.check_limits,
        )  # fmt: skip
        merge_motion(
            inputs, filtering.believed.sensors, filtering.check.until_ns, now, told,
            filtering.motion, filtering.limits,
        )  # fmt: skip
        assess_train(
            inputs.speed, inputs.commanded, receiving.slow, judging.flag, now, judging.tick_s,
            told, judging.train,
        )  # fmt: skip
        compare(
            told, receiving.slow, inputs.commanded, judging.flag, judging.since_ns, now,
            judging.tick_s, judging.rotors, reference, judging.passing, judging.at,
            judging.heard, judging.room,
        )  # fmt: skip
        common = _opinion(judging)
        answered = conclude(
            judging.lost, judging.known, common, now, judging.tick_s, response, judging.at,
            judging.heard, judging.train, judging.part, judging.spreads, judging.rules,
            judging.mode, judging.trust, judging.room,
        )  # fmt: skip
        due = now >= learn_ns
        if answered or due:
            if due:
                learn_ns = now + judging.every_ns
            spread, own = teach(
                answered, due, now, judging.tick_s, common, judging.flag, receiving.slow.operating,
                reference, response, judging.at, judging.heard, judging.settled_ns,
                judging.probably, judging.trust, judging.room,
            )  # fmt: skip
            # Here and not in a function: one that gives arrays back has to count them.
            reference = Reference(
                reference.ratio, reference.variance, spread, reference.configured,
                reference.residual, reference.seen,
            )  # fmt: skip
            alone = response.reference
            alone = Reference(
                alone.ratio, alone.variance, own, alone.configured, alone.residual, alone.seen
            )
            response = Memory(alone, response.since_s)
        if seen:
            hear(seen, receiving.scratch, receiving.wiring, warming.warmth)
        advance(
            seen > 0, now, warming.summed, receiving.places, receiving.state, receiving.slow,
            warming.warmth,
        )  # fmt: skip
        report(now, warming.limit_ns, warming.warmth, saying.findings)
        lost, known = judging.room.lost, judging.room.known
        weigh(
            inputs, filtering.motion.wrong, judging.train.uncertain, told, lost, known,
            saying.findings, _NONE,
            judging.rules, saying.seen, saying.why,
        )  # fmt: skip
        changed = decide(saying.seen, judging.room.severe, now, judging.rules, saying.flags)
        tell(
            saying.seen, saying.why, now, saying.flags, inputs, told, lost, known, saying.findings,
            receiving.pairs.sample_ns, _NONE, judging.mode.flag, False, False, saying.said,
        )  # fmt: skip
        _raise(went.peak, saying.said.lost)
        _count(receiving.scratch.tally, saying)
        frames = send(
            now, saying.said, saying.counts, saying.sheet, saying.form, saying.e2e_config,
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
        done, stage, first, samples, seen, foreign, odd, motions, changed, out, busy, common,
        reference.spread, response.reference.spread, learn_ns,
    )  # fmt: skip
