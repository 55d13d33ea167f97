"""A gateway whose tick is put together in Python, station by station: for what `tick.c` must equal.

And for gateways that break a rule: what a hook changes between two stations, the later ones see.
"""

from collections.abc import Callable

from _traction_core import lib

from dbc.frame import Nanos
from gateway.core.gateway import Gateway

Hook = Callable[[Gateway], None]
OF_STATUS = {
    "input_reason": "reason", "comm": "comm", "current_sum_fault": "current_sum_fault",
}  # fmt: skip
OF_ESTIMATE = ("health", "health_reason", "speed_rad_s", "nis", "load_nm", "load_sigma_nm")


class Stepped(Gateway):
    """hooks: by name of the station after which they are called, in their order.

    inputs, estimates, adhesion, evidence, debounced, published, sent.
    """

    hooks: dict[str, list[Hook]]
    now: Nanos
    """Of the tick."""

    def __init__(self, *given):
        self.hooks, self.now = {}, 0
        super().__init__(*given)

    def after(self, station, hook):
        """One more."""
        self.hooks.setdefault(station, []).append(hook)

    def _done(self, station):
        for hook in self.hooks.get(station, ()):
            hook(self)

    def _run(self, block, ends, now):
        """The first tick of `run`."""
        self._run_one(block.part(0, int(ends[0])), now)
        self._now, self._view = now, None
        return 1

    def _run_one(self, block, now):
        self.now = now
        part = block.ordered()
        if part.size > self._capacity:
            self._reserve(part.size)
        self._receive(part, now)
        self._judge(now)
        self._say(now)
        self.inbox.read_emergencies(part, 0)

    def _receive(self, part, now):
        p, at = self.pointer, part.columns()
        assert lib.receive_frames(p.receiver, at, 0, part.size, now)
        lib.check_integrity(p.integrity, p.receiver.tick.own, now)
        if not p.is_translated:
            lib.bus_load_tick(p.load, now)
            lib.bus_load_receive(p.load, p.receiver, at, 0, part.size)
        lib.check_timeouts(p.receiver, now)
        for k in range(p.drive_count):
            p.inputs[k].heartbeat_lost = lib.is_node_lost(p.receiver.supervision, k, now)
        lib.assess_inputs(p.receiver, p.channels, p.integrity.intruder, now, p.inputs)
        self._done("inputs")

    def _judge(self, now):
        p = self.pointer
        lib.run_filters(p.estimator, p.receiver, p.inputs, p.estimates, now)
        lib.observe_load(p.motion, now)
        self._done("estimates")
        given = (p.adhesion, p.estimates, p.inputs, p.receiver.drives, p.status, now)
        if p.detects:
            lib.detect_loss(*given)
        else:
            lib.adhesion_prepare(*given)
            self.adhesion.ask_detector(self.bank.estimates)
            lib.adhesion_fuse(p.adhesion, p.receiver.drives, p.status, now)
        self._done("adhesion")
        lib.monitor_temperatures(p.temperatures, p.receiver, now, p.flag_inputs)

    def _say(self, now):
        p, n = self.pointer, self.pointer.drive_count
        lib.fill_train_inputs(p.integrity, p.adhesion.common_mode.state, p.train_inputs)
        self._gather()
        lib.collect_evidence(p.rules, p.train_inputs, p.flag_inputs, n, p.evidence)
        self._done("evidence")
        changed = lib.debounce_flags(p.rules, p.evidence, n, now, p.status)
        p.changed = bool(changed) or not p.begun
        self._done("debounced")
        lib.publish(p.train_inputs, p.flag_inputs, p.evidence, n, now, p.status, p.train)
        lib.estimate_creep(p.adhesion, p.status)
        self.peak[:] = self.status.drives["loss_probability"]
        self._done("published")
        if not p.begun:
            lib.transmit_restart(p.transmitter, now)
        p.begun, p.sent_count = 1, 0
        lib.update_counts(p.transmitter, p.receiver, p.integrity, p.load, now)
        if not p.integrity.mute:
            p.sent_count = lib.transmit(p.transmitter, p.status, p.train, now, p.sent)
            lib.bus_load_transmit(p.load, p.transmitter, p.sent_count, p.sent)
        self._done("sent")

    def _gather(self):
        """`flag_inputs` but for the temperatures."""
        out, status, estimates = self.flags.inputs, self.inputs.status, self.bank.estimates
        for name, theirs in OF_STATUS.items():
            out[name] = status[theirs]
        for name in OF_ESTIMATE:
            out[name] = estimates[name]
        out["input_implausible"] = self.motion.motions["implausible"]
        out["sample_ns"] = self.inbox.receiver.drives["sample_ns"]
        out["loss_probability"] = self.adhesion.loss_probability
        out["loss_known"] = self.adhesion.loss_known
        out["severe_loss"] = self.adhesion.loads["severe_loss"]
        out["may_spin_up"] = self.adhesion.rotors["uncertain"]
