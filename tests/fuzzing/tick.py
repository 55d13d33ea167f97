"""Fuzz target: the whole tick. Input: a small program of frames, jumps of time and damaged records.

A byte for the set-up, then instructions: ticks of running drives; other bits in a frame of theirs,
with a right checksum; any frame at all; a jump of time; other bytes in a field of a record, or in
up to 32 fields by a seed. Every field that is state is among them; addresses, sizes, indices into
tables and constants are not. What is missing at the end reads as zeros. The core may be wrong
afterwards. It may not fail, nor send what is none of its frames; in a core with sanitizers
(`python -m tests.core_variants`) they look on.
"""

import random
import struct
from functools import cache
from operator import attrgetter
from typing import Any, NamedTuple
from zlib import crc32

import numpy as np
from numpy.typing import NDArray

from dbc.codec import Codec
from dbc.e2e import protect
from dbc.frame import SECOND
from dbc.frames import Block, block_of
from dbc.spec import MessageSpec
from gateway.core.gateway import Gateway
from tests.extremes import Setup
from tests.fuzzing.frames import _any, _Bytes, _well_formed
from tests.value_cases import TICK, honest

WARM_TICKS = 60
"""Drives are tracked by then."""
LONGEST = 40
"""Ticks of one program."""
MOST = 30
"""Frames beside the drives' own in one tick; there is room for them in the receiver."""
READ = 16
"""One input of so many has what is sent read again, which takes longer than all the rest."""
JUMPS = (SECOND, 60 * SECOND, 3600 * SECOND, 100 * 86_400 * SECOND)
SETUPS = (
    Setup(2, "ekf", False, 200.0, thermal=True),
    Setup(2, "ukf", False, 200.0),
    Setup(2, "ekf", True, 200.0, thermal=True),
    Setup(2, "ukf", True, 290.0, detector="median"),
)
STATE: dict[str, str] = {
    "inbox.receiver.channels": (
        "e2e_state received_ns accepted_ns good_ns guard.counter_ns guard.error_ns"
        " guard.rejected_until_ns guard.errors guard.repeats last_frame reject_reason"
        " protection_reason reason was_valid"
    ),
    "inbox.receiver.drives": "",
    "inbox.receiver.record": "received counters unpaired late left_out",
    "supervision.heartbeats": "",
    "bank.filters": "x P nis r_scale v_q_bias steps active is_finite",
    "bank.chords": "",
    "bank.sensors": "",
    "bank.tracks": "",
    "bank.estimates": "",
    "inputs.status": "",
    "motion.motions": (
        "observer reading_ns readings unlocked_ns disagree_ticks started aliasing"
        " crawls implausible smooth_speed"
    ),
    "motion.checks": (
        "current samples repeats block_repeats repeated_s base deviation learnt angle_ns"
        " angle_fitted_ns angle_misfits torque_misfits load_misfits motion_misfits speed torque"
        " command changed_ns implausible_until_ns restart"
    ),
    "motion.others": "",
    "adhesion.rotors": (
        "speed load slow_speed quick_speed acceleration_torque brake_torque diameter learnt_s creep"
        " followed_s alone_s near_s slides_s uncommanded_s odd_s unreliable_until_ns far apart away"
        " uncertain odd above forward"
    ),
    "adhesion.loads": "",
    "adhesion.ratios": "",
    "adhesion.response_ratios": "",
    "adhesion.record": (
        "response_spread spread common_mode learn_ns flagged_ns common_missing_s common"
        " common_smoothed comparable"
    ),
    "thermal.sensors.drives": (
        "received_ns first_ns readings sensor.seen sensor.saturated sensor.step_count sensor.raw"
        " sensor.changed_ns sensor.valid_ns sensor.value_c sensor.level_c sensor.slope_k"
        " sensor.step_k sensor.bias_k sensor.valid_at sensor.step_index"
    ),
    "thermal.motors": (
        "ambient_c total number mean trend step_k jumps evidence valid_until_ns fresh left_out"
    ),
    "thermal.record": "next_ns cycles next_report_ns cycle second_complete dirty",
    "thermal.model.motors": "",
    "thermal.currents": "",
    "thermal._ring": "",
    "thermal.window.value": "",
    "thermal.window.mean": "",
    "flags.inputs": "",
    "flags.train_inputs": "",
    "flags.evidence": "",
    "flags.status.drives": "",
    "flags.status.train": "",
    "outbox.messages": "next_ns counter",
    "outbox.record": "counts summary_sent",
    "outbox._thermal_sent": "",
    "load.record": "since_ns busy_s percent",
    "integrity.record": (
        "missed_ticks lost_frames watching now_ns deadline_misses late_in_a_row overrun_ns lost_ns"
        " intruder_ns intruder silent mute"
    ),
    "peak": "",
    "record": "stage begun changed",
}
"""Where records lie below the gateway, and which of their fields are state; none named: all."""
FLOATS = (0.0, -0.0, 1.0, -1.0, np.nan, np.inf, -np.inf, 1e308, -1e308, 5e-324, 1e-160, 1e160)
WHOLE = (0, 1, -1, 2, 255, 1 << 20, 1 << 40, -(1 << 40), 1 << 59, -(1 << 59), (1 << 59) - 1)
SPARE = 4
"""Bits by which a signed number stays below its range: as a stamp in ns it is some 18 years, and
sums and differences of a few of them do not overflow."""


class Held(NamedTuple):
    """A gateway that runs, what it is put back to before each input, and what can be damaged."""

    gateway: Any
    arrays: list[tuple[NDArray[Any], NDArray[Any]]]
    fields: list[NDArray[Any]]
    blocks: list[Block]
    codec: Codec
    specs: dict[int, MessageSpec]


def _leaves(array):
    """Every number of a record as a column of its own."""
    if array.dtype.names is None:
        yield array.reshape(-1)
        return
    for name in array.dtype.names:
        yield from _leaves(array[name])


def _fields(gateway):
    for place, wanted in STATE.items():
        if place.startswith("thermal.model") and gateway.thermal.model is None:
            continue
        array = np.asarray(attrgetter(place)(gateway))
        for path in wanted.split() or [""]:
            part = array
            for name in path.split(".") if path else ():
                part = part[name]
            yield from _leaves(part)


def _arrays(owner, seen):
    """All memory of NumPy's below an object of ours, each once."""
    if id(owner) in seen:
        return
    seen[id(owner)] = owner
    if isinstance(owner, np.ndarray):
        base = owner
        while isinstance(base.base, np.ndarray):
            base = base.base
        if id(base) not in seen or base is owner:
            seen[id(base)] = base
            yield np.asarray(base)
    elif isinstance(owner, list | tuple):
        for one in owner:
            yield from _arrays(one, seen)
    elif isinstance(owner, dict):
        for one in owner.values():
            yield from _arrays(one, seen)
    elif type(owner).__module__.partition(".")[0] in ("gateway", "estimators"):
        yield from _arrays(getattr(owner, "__dict__", {}), seen)


@cache
def _held(which, made):
    setup = SETUPS[which]
    ticks = WARM_TICKS + LONGEST
    blocks = honest(setup.speed, setup.motor, setup.fd, ticks, 0.6, setup.nodes)
    gateway = made(setup.config(), setup.codec, 0)
    for k, block in enumerate(blocks[:WARM_TICKS], 1):
        gateway.step(block, k * TICK)
    arrays = [(a, a.copy()) for a in _arrays(gateway, {}) if a.flags.writeable]
    specs = {m.can_id: m for m in setup.codec.messages if m.node and not m.is_gateway}
    return Held(gateway, arrays, list(_fields(gateway)), blocks[WARM_TICKS:], setup.codec,
                specs)  # fmt: skip


def _damage(held, source):
    """Other bytes in one number of a record."""
    choice, at, how = struct.unpack("<HHB", source.take(5))
    column = held.fields[choice % len(held.fields)]
    at %= len(column)
    if how & 1:
        number = np.frombuffer(source.take(column.itemsize), dtype=column.dtype)[0]
        column[at] = number >> SPARE if column.dtype.kind == "i" else number
    elif column.dtype.kind in "fc":
        column[at] = FLOATS[(how >> 1) % len(FLOATS)]
    else:
        word = WHOLE[(how >> 1) % len(WHOLE)] & ((1 << 8 * column.itemsize) - 1)
        number = np.frombuffer(word.to_bytes(column.itemsize, "little"), column.dtype)[0]
        column[at] = number >> SPARE if column.itemsize < 8 and column.dtype.kind == "i" else number


def _other_bits(held, block, source):
    """In one of the drives' frames, and its checksum made anew."""
    row, at, bits = source.take(3)
    row %= block.size
    spec = held.specs.get(block.can_id.item(row))
    if spec is None:
        return
    data = bytearray(block.data[row, : spec.length].tobytes())
    data[at % len(data)] ^= bits
    counter = data[2] if spec.is_fd else data[1] & 15
    protect(spec, data, counter)
    block.data[row, : spec.length] = np.frombuffer(data, dtype=np.uint8)


@np.errstate(all="ignore")
def tick(data, gateway=Gateway, every=READ):
    """Nothing fails; of one input in `every`, what is sent is well formed; returns ticks."""
    source = _Bytes(data)
    read = crc32(data) % every == 0
    held = _held(source.byte() % len(SETUPS), gateway)
    for array, kept in held.arrays:
        array[...] = kept
    skipped, done = 0, 0
    extra = []
    block = _next(held, done, skipped)
    while source.at < len(data) and done < LONGEST - 1:
        what = source.byte()
        if what < 0x40:
            _step(held, read, block, extra, (WARM_TICKS + done + 1) * TICK + skipped)
            done += 1
            block, extra = _next(held, done, skipped), []
        elif what < 0x70 and block.size:
            _other_bits(held, block, source)
        elif what < 0x80 and len(extra) < MOST:
            extra.append(_any(source, (WARM_TICKS + done + 1) * TICK + skipped))
        elif what < 0x88:
            skipped += JUMPS[what % len(JUMPS)]
            block = block._replace(t_ns=block.t_ns + JUMPS[what % len(JUMPS)])
        elif what < 0xE0:
            _damage(held, source)
        else:
            # Many at once, of which an input says but the seed.
            many = _Bytes(random.Random(source.take(2)).randbytes(13 * (what & 31) + 13))
            for _ in range(1 + (what & 31)):
                _damage(held, many)
    # What was damaged last is used, too, and more than once.
    for _ in range(3):
        if done < LONGEST:
            _step(held, read, block, extra, (WARM_TICKS + done + 1) * TICK + skipped)
            done += 1
            block, extra = _next(held, done, skipped), []
    return done


def _next(held, done, skipped):
    if done >= len(held.blocks):
        return block_of(())
    block = held.blocks[done]
    return block._replace(t_ns=block.t_ns + skipped, data=block.data.copy())


def _step(held, read, block, extra, now):
    sent = held.gateway.step(block_of([*block.frames(), *extra]) if extra else block, now)
    if read:
        for frame in sent:
            # Each by itself: after a damaged counter they are out of sequence.
            _well_formed(held.codec, [frame], now, {})
