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
from gateway._inputs_kernels import look
from gateway._motion_kernels import merge_motion, observe_motion
from gateway._plausibility_kernels import check_values
from gateway._receive_kernels import (
    bus_load_receive,
    find_lost_nodes,
    receive_frames,
)
from gateway._sweep_kernels import run_filters
from gateway._train_kernels import assess_train
from gateway.pairing import Samples

if TYPE_CHECKING:
    from dbc.records import Records
    from gateway.stretch import Filtering, Judging, Receiving, Saying, Went

Array = NDArray[np.float64]
Ints = NDArray[np.int64]
Bools = NDArray[np.bool_]

WHOLE, HEARD, FILTERED = range(3)
"""What is done of a tick: all, or everything up to here."""
_vb_detect = symbol("vb_detect")
_update_counts, _transmit = symbol("update_counts"), symbol("transmit")
_check_integrity, _fill_train_inputs = symbol("check_integrity"), symbol("fill_train_inputs")
_monitor_temperatures = symbol("monitor_temperatures")
_bus_load_transmit = symbol("bus_load_transmit")


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
def _send(now: int, receiving: Receiving, saying: Saying, frames: Records, first: int) -> int:
    """`transmit` in gateway/core/transmit.c: fills frames from `first` on, gives their number."""
    tx, out = saying.transmitter, frames.ctypes.data + int(first) * frames.strides[0]
    integrity = receiving.integrity.ctypes.data
    _update_counts(tx, receiving.receiver, integrity, receiving.load, now)
    count = _transmit(
        tx, saying.status.drives.ctypes.data, saying.status.train.ctypes.data, now, out
    )
    _bus_load_transmit(receiving.load, tx, count, out)
    return count  # type: ignore[no-any-return]


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
    data: NDArray[np.uint8], ends: Ints, now: int, receiving: Receiving,
    filtering: Filtering, judging: Judging, saying: Saying, went: Went,
) -> tuple[Any, ...]:  # fmt: skip
    """Ticks from `now` on, one for each of ends (K,); stops behind a change.

    The first five are columns of a `Block`; tick k takes its rows from ends[k - 1] to ends[k].
    Fills `went`. Gives the fields of `Left`, not one of these: see `Direct`.
    """
    period, rows_of = receiving.period_ns, receiving.scratch.t_ns.shape[0]
    common, out, first = 0.0, 0, 0
    done, stage = 0, WHOLE
    samples = seen = motions = 0
    changed = False
    learn_ns = judging.learn_ns
    for k in range(ends.shape[0]):
        last = ends[k]
        if last - first > rows_of or out + went.most > went.frames.shape[0]:
            break
        if not receive_frames(
            receiving.receiver, first, last, t_ns, can_id, flags, length, data, now
        ):
            break
        tick = receiving.tick[0]
        samples, seen, motions = tick["samples"], tick["temperatures"], tick["motions"]
        odd = tick["only_decoded"] == 0
        others = tick["emergencies"] + tick["unpaired"] + tick["late"] + tick["restarts"] > 0
        if others or samples > filtering.room.samples.shape[0]:
            stage = HEARD
            break
        went.tally[0] += last - first
        if not odd:
            went.tally[1] += last - first
        bus_load_receive(
            receiving.load, receiving.receiver, first, last, can_id, flags, length, now
        )
        first = last
        _check_integrity(receiving.integrity.ctypes.data, tick["own"], now)
        find_lost_nodes(receiving.supervision, now, receiving.lost)
        inputs, told = filtering.inputs, filtering.believed.told
        intruder = receiving.integrity[0]["intruder"] != 0
        look(
            now, receiving.lost, intruder, receiving.places, receiving.state, receiving.pairs,
            receiving.slow, inputs,
        )  # fmt: skip
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
        _monitor_temperatures(
            saying.temperatures, receiving.receiver, now, saying.inputs.ctypes.data
        )
        lost, known = judging.room.lost, judging.room.known
        fill_inputs(
            inputs, filtering.motion.wrong, judging.train.uncertain, told, lost, known,
            judging.room.severe, receiving.pairs.sample_ns, saying.inputs,
        )  # fmt: skip
        _fill_train_inputs(
            receiving.integrity.ctypes.data, judging.common_mode[0]["state"],
            saying.train_inputs.ctypes.data,
        )  # fmt: skip
        changed = update_flags(
            now, judging.rules, saying.train_inputs, saying.inputs, saying.evidence, saying.status
        )
        _raise(went.peak, saying.status.drives)
        if receiving.integrity[0]["mute"] == 0:
            out += _send(now, receiving, saying, went.frames, out)
        done = k + 1
        now += period
        if changed:
            break
    return (
        done, stage, first, samples, seen, motions, changed, out, common, learn_ns,
    )  # fmt: skip
