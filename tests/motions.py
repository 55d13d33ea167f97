"""A `MotionMonitor` in tests: of drives whose filters, samples and readings are given."""

from types import SimpleNamespace

from dbc.records import FILTER_NOISE, ROTOR, zeros
from estimators import filters
from gateway.core import inputs
from gateway.core.channel import RPM
from gateway.core.codes import NEVER
from gateway.core.estimate import estimates as fresh_estimates
from gateway.core.motion import Timebase
from gateway.settings.config import BENCH_MOTOR
from gateway.settings.sections import Estimator
from tests.core_calls import acquisition, current_calibration
from tests.receivers import Received
from tests.sender import MS
from tests.stations import MotionMonitor

TIMES = Timebase(2e-3, 10 * MS, 0.5 * RPM)


class Drives(MotionMonitor):
    """The monitor of N drives, and all that it works on."""

    def __init__(self, n, times=TIMES, motor=BENCH_MOTOR, step_a=0.1):
        self.came = Received(n)
        self.status = inputs.statuses(n)
        estimates = fresh_estimates(n)
        noise = zeros(n, FILTER_NOISE)
        noise["R"] = 0.01
        bank = SimpleNamespace(
            noise=noise, estimates=estimates, filters=filters.unstarted(n),
            chords=acquisition.start(n), sensors=current_calibration.start(n),
        )  # fmt: skip
        rotors = zeros(n, ROTOR)
        rotors["unreliable_until_ns"] = NEVER
        super().__init__(
            [motor] * n, Estimator(), times, 10 * MS, step_a, self.came,
            SimpleNamespace(status=self.status), bank, rotors,
        )  # fmt: skip
        self.estimates = estimates
