"""Stations of a tick, each called by itself: what `gateway/core/tick.c` does with them in order.

The product has no such calls. Here they are methods of the product's own objects.
"""

import math
from typing import NamedTuple

import numpy as np
from _traction_core import ffi, lib

import gateway.core.estimate
import gateway.core.flags
import gateway.core.inbox
import gateway.core.inputs
import gateway.core.integrity
import gateway.core.motion
import gateway.core.thermal
from dbc.frame import Nanos
from dbc.frames import Block, block_of
from dbc.records import FLAG, FLAG_INPUTS, pointer
from dbc.spec import VALID
from gateway.core.codes import FaultClass, FaultSensor, Flag, Reason
from gateway.core.inbox import USABLE
from gateway.core.thermal import AMBIENT
from gateway.core.view import Wear
from gateway.settings.calibration import POINTS
from gateway.study.calibrating import Sample
from tests import columns
from tests.sample_rows import samples_of


class Temperatures(NamedTuple):
    """One reading of a drive's points (stator, drive end, non-drive end, ambient), degC.

    celsius is NaN where not `valid`. raw: tenths of a degree, -1 if none.
    """

    drive: int
    t_ns: Nanos
    celsius: tuple[float, ...]
    valid: tuple[bool, ...]
    raw: tuple[int, ...]


def temperatures_of(inbox):
    """Readings of the last tick."""
    space = inbox.receiver.space
    rows = space["temperature_rows"][: inbox.receiver.pointer.tick.temperatures].tolist()
    return [_temperature(inbox.channels[space["channel"].item(k)], space, k) for k in rows]


def _temperature(channel, space, row):
    value, valid = space["value"][row].tolist(), space["validity"][row].tolist()
    usable = channel.quality < 0 or value[channel.quality] in USABLE
    good = tuple(usable and valid[k] == VALID for k in channel.picked)
    kept = tuple(zip(channel.picked, good, strict=True))
    return Temperatures(
        channel.drive,
        space["t_ns"].item(row),
        tuple(value[k] if ok else math.nan for k, ok in kept),
        good,
        tuple(round(value[k] * 10.0) if ok else -1 for k, ok in kept),
    )


class Report(NamedTuple):
    """What is known of one motor: evidence for its two flags and what goes on the bus."""

    thermal: Flag = Flag.UNKNOWN
    sensor: Flag = Flag.UNKNOWN
    reason: Reason = Reason.STARTING
    fault_class: FaultClass = FaultClass.UNKNOWN
    fault_sensor: FaultSensor = FaultSensor.NONE
    mixed_c: float | None = None
    maisd_k: float | None = None
    wear: Wear = Wear()


class Inbox(gateway.core.inbox.Inbox):
    """Takes the frames of a tick."""

    def take(self, frames, now):
        """In the order of their time stamps, then ids; gives them as a block, in that order."""
        return receive(self, frames, now)

    @property
    def restart(self):
        """Drives whose filter starts anew in this tick."""
        return set(np.flatnonzero(self.receiver.drives["restart"]).tolist())

    @property
    def samples(self):
        """Of the last tick."""
        return last_samples(self)


def last_samples(inbox):
    """Samples of the last tick."""
    receiver = inbox.receiver
    return samples_of(receiver).first(receiver.pointer.tick.samples)


def receive(inbox, frames, now):
    """`receive_frames`, `check_timeouts`, and emergencies."""
    block = frames if isinstance(frames, Block) else block_of(frames)
    receiver = inbox.receiver
    if block.size > receiver.rows:
        receiver.reserve(2 * block.size)
    for ordered in (False, True):
        block = block.ordered() if ordered else block
        if lib.receive_frames(receiver.pointer, block.columns(), 0, block.size, now):
            break
    lib.check_timeouts(receiver.pointer, now)
    inbox.read_emergencies(block, 0)
    return block


class Bank(gateway.core.estimate.Bank):
    """Filters what the receiver holds."""

    def link(self):
        super().link()
        self.told = columns.told_of(self.estimates)

    def run(self, receiver, inputs, now):
        """`run_filters`; receiver: `struct receiver *`; inputs: `input_status` (N,).

        There has to be room for its samples.
        """
        valid = pointer("struct input_status", inputs)
        told = pointer("struct drive_estimate", self.estimates)
        lib.run_filters(self._pointer, receiver, valid, told, now)


class InputMonitor(gateway.core.inputs.InputMonitor):
    """Judges what the receiver holds."""

    def assess(self, intruder, now):
        """`assess_inputs`; `heartbeat_lost` is the caller's."""
        channels = pointer("struct drive_channels", self.channels)
        status = pointer("struct input_status", self.status)
        lib.assess_inputs(self.receiver.pointer, channels, intruder, now, status)


class MotionMonitor(gateway.core.motion.MotionMonitor):
    """Compares speeds and torques with the estimates."""

    def observe(self, now):
        """`observe_load`: changes the estimates to what is to be used."""
        lib.observe_load(self.pointer, now)


class TemperatureMonitor(gateway.core.thermal.TemperatureMonitor):
    """Judges the temperatures that the receiver holds."""

    def hear(self, inbox, now, out):
        """`monitor_temperatures`, into out (N,) of `flag_inputs`."""
        inputs = ffi.from_buffer("struct flag_inputs[]", out)
        lib.monitor_temperatures(self.pointer, inbox.receiver.pointer, now, inputs)

    def tell(self, now, out):
        """`report_temperatures`: evidence where it can have changed, into out (N,)."""
        lib.report_temperatures(self.pointer, now, ffi.from_buffer("struct flag_inputs[]", out))

    def add_readings(self, readings, now, beside=None):
        """One tick of readings that came in no frame: a recording's; nothing is reported.

        beside: what else the drives have sent, for the thermal model.
        """
        for reading in readings:
            add_reading(self.sensors, reading)
            celsius, valid = reading.celsius[AMBIENT], reading.valid[AMBIENT]
            self.motors["ambient_c"][reading.drive] = celsius if valid else math.nan
        receiver = ffi.NULL if beside is None else beside.pointer
        lib.advance_temperatures(self.pointer, receiver, bool(readings), now)

    @property
    def last(self):
        """The newest second, in the temperature cycle that completed it."""
        if not self.record["second_complete"][0]:
            return None
        mean = self.motors["mean"].copy()
        square, speed, ambient = (
            mean[:, k] for k in (lib.THERMAL_CURRENT_SQUARE, lib.THERMAL_SPEED, lib.THERMAL_AMBIENT)
        )
        return Sample(mean[:, :AMBIENT], square, speed, ambient)

    def report(self, drive, now, limit_ns):
        """Evidence for one motor at `now`; `limit_ns` is the age limit of its temperatures."""
        self.motors["age_limit_ns"][drive] = limit_ns
        out = np.zeros(1, FLAG_INPUTS)
        lib.report_motor(self.pointer, drive, now, pointer("struct flag_inputs", out))
        return self.to_report(drive, out[0])

    def to_report(self, drive, found):
        """One motor's `flag_inputs` in words."""
        mixed, largest = (float(found[name]) for name in ("mixed_c", "maisd_k"))
        return Report(
            Flag(found["thermal"]), Flag(found["sensor"]), Reason(found["thermal_reason"]),
            FaultClass(found["fault_class"]), FaultSensor(found["fault_sensor"]),
            None if math.isnan(mixed) else mixed, None if math.isnan(largest) else largest,
            self.wear[drive],
        )  # fmt: skip


class IntegrityMonitor(gateway.core.integrity.IntegrityMonitor):
    """What speaks against all drives."""

    def tick(self, now, own):
        """own: frames with our own identifiers received in this tick."""
        lib.check_integrity(self.pointer, own, now)

    @property
    def mute(self):
        """Whether nothing is sent in this tick: not in the one that finds an intruder."""
        return bool(self.pointer.mute)

    @property
    def reason(self):
        """Why no adhesion flag is valid in this tick; NONE if there is no such reason."""
        return Reason(lib.integrity_reason(self.pointer))


class Flags(gateway.core.flags.Flags):
    """From what is found to flags, in three steps."""

    def link(self):
        super().link()
        self._rules = pointer("struct flag_rules", self.rules)
        self._inputs = pointer("struct flag_inputs", self.inputs)
        self._train_inputs = pointer("struct train_inputs", self.train_inputs)
        self._evidence = pointer("struct drive_evidence", self.evidence)
        self._drives = pointer("struct drive_status", self.status.drives)
        self._train = pointer("struct train_status", self.status.train)

    def collect_evidence(self):
        """Fill `evidence` from the inputs of this tick."""
        n = len(self.inputs)
        lib.collect_evidence(self._rules, self._train_inputs, self._inputs, n, self._evidence)

    def debounce(self, now_ns):
        """Feed `evidence` to every flag; whether one has changed."""
        n = len(self.inputs)
        return bool(lib.debounce_flags(self._rules, self._evidence, n, now_ns, self._drives))

    def publish(self, now_ns):
        """Fill everything else in `status`."""
        lib.publish(
            self._train_inputs, self._inputs, self._evidence, len(self.inputs), now_ns,
            self._drives, self._train,
        )  # fmt: skip


def flag(start_ns):
    """One `flag`, unknown since `start_ns`."""
    made = np.zeros(1, FLAG)
    made["since_ns"] = start_ns
    return made


def debounce(flag, evidence, timing, tick_ns, now_ns):
    """Feed one tick of evidence (`Flag`, or `UNCHANGED`) to one flag; whether it has changed."""
    by = ffi.new("struct flag_timing *", timing)
    return bool(lib.debounce(pointer("struct flag", flag), evidence, by, tick_ns, now_ns))


def loss_evidence(rules, probability):
    """Evidence of a probability of lost adhesion; `UNCHANGED` between the two thresholds."""
    return int(lib.loss_evidence(pointer("struct flag_rules", rules), probability))


def is_fresh(inbox, row, now):
    """Whether the last good value of channel `row` is within its age limit and it is known."""
    return bool(lib.is_channel_fresh(inbox.receiver.pointer.channels + row, now))


def any_lost(watch, now):
    """Whether any supervised node is silent for too long."""
    return any(lib.is_node_lost(watch.pointer, row, now) for row in range(len(watch.nodes)))


def _drive(sensors, drive):
    return pointer("struct temperature_drive", sensors.drives) + drive


def sensor_fault(sensors, drive, k, now):
    """Of one sensor; UNKNOWN while it has never been heard, NONE for one that is not configured."""
    return FaultClass(lib.temperature_sensor_fault(_drive(sensors, drive), k, now))


def sensors_valid(sensors, now):
    """(N, P): configured, heard and without fault."""
    values, valid = np.empty(sensors.configured.shape), np.empty_like(sensors.configured)
    lib.temperature_values(
        _drive(sensors, 0), len(sensors.drives), now, pointer("double", values),
        pointer("uint8_t", valid),
    )  # fmt: skip
    return valid


def not_yet_valid(sensors, drive):
    """Whether a configured sensor has never given a valid value."""
    return bool(lib.temperature_not_yet_valid(_drive(sensors, drive)))


def sensor_verdict(sensors, drive, now):
    """The drive's first sensor fault and whose it is."""
    own = _drive(sensors, drive)
    kind, whose = lib.temperature_fault(own, now), lib.temperature_fault_sensor(own, now)
    return FaultClass(kind), FaultSensor(whose)


def add_reading(sensors, reading):
    """Accept one reading of one drive."""
    drive, configured = _drive(sensors, reading.drive), sensors.configured[reading.drive]
    lib.temperature_add_reading(drive, reading.t_ns)
    for k in np.flatnonzero(configured & reading.valid[: len(POINTS)]).tolist():
        celsius = float(reading.celsius[k])
        lib.temperature_add_value(drive, k, reading.t_ns, celsius, reading.raw[k])
