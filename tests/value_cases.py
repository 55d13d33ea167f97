"""One drive's values are wrong, counters and checksums right: what the gateway makes of it.

`run_case(Case(..))` gives it tick by tick.
"""

import math
import traceback
from functools import cache
from typing import NamedTuple

from dbc.frame import MS, SECOND
from dbc.frames import block_of
from gateway.core.codes import Flag, Health, Reason
from gateway.core.gateway import Gateway
from gateway.settings.config import parse
from sim.physics.plant import MOTORS
from sim.scenario import parse as scenario
from sim.simulation import Simulation
from tests.simrun import CLASSIC, FD_FILE, codec
from tests.storm.value_faults import ValueFaults

TICK = 10 * MS
BEGIN_TICK = 300
"""All flags say Adhering long before: the fault begins with the tick after this one."""
FAULT_TICKS = 150
TAIL_TICKS = 350
SPEEDS = (100.0, 200.0, 290.0)
"""Electrical, rad/s."""
MOTOR_NAMES = ("bench", "traction_350kw")
FILTERS = ("ekf", "ukf")
LOAD = 0.6
"""Of rated torque."""
NODES = (1, 2, 3)


class Case(NamedTuple):
    """One case. speed: electrical, rad/s; drive: from 0; begin: tick, 0: the log begins so."""

    kind: str
    speed: float = 200.0
    motor: str = "bench"
    filter: str = "ekf"
    fd: bool = False
    begin: int = BEGIN_TICK
    ticks: int = FAULT_TICKS
    tail: int = TAIL_TICKS
    drive: int = 1
    load: float = LOAD
    nodes: tuple[int, ...] = NODES
    gains: float = 0.0
    """Electrical rad/s2, from the fault's begin on."""


class Row(NamedTuple):
    """One drive at one tick; numbers are NaN where they are not known."""

    tick: int
    flag: Flag
    reason: Reason
    health: Health
    sensor: Flag
    speed: float
    load: float
    lost: float
    nis: float


class Outcome(NamedTuple):
    """rows[drive][tick - 1]; raised: where `step` raised, else empty.

    off, off_rpm: by tick of the fault, how far currents (per unit of rated) and measured speed of
    the drive are off the honest ones, root mean square.
    """

    case: Case
    rows: list[list[Row]]
    raised: str
    off: list[float]
    off_rpm: list[float]

    @property
    def mine(self):
        """The drive's whose values are wrong, during the fault."""
        return self.rows[self.case.drive][self.case.begin : self.case.begin + self.case.ticks]

    @property
    def after(self):
        """The same drive's, after the fault."""
        return self.rows[self.case.drive][self.case.begin + self.case.ticks :]

    @property
    def others(self):
        """The other drives', from the begin of the fault on."""
        return [rows[self.case.begin :] for d, rows in enumerate(self.rows) if d != self.case.drive]


@cache
def honest(speed, motor, fd, ticks, load=LOAD, nodes=NODES, gains=0.0, begin=0):
    """Frames of the ticks of drives that turn steadily; nobody obeys a flag.

    gains: electrical rad/s2 from tick `begin` on.
    """
    first, last = begin * TICK / SECOND, ticks * TICK / SECOND
    profile = ((0.0, speed), (first + 0.01, speed), (last + 0.02, speed + gains * (last - first)))
    return driven(profile, motor, fd, ticks, load, nodes)


@cache
def driven(profile, motor, fd, ticks, load=LOAD, nodes=NODES):
    """The same along a profile: pairs of time, s, and electrical speed, rad/s."""
    world = scenario({
        "title": "steady", "seed": 11, "duration_s": ticks * TICK / SECOND, "nodes": list(nodes),
        "motor": {"name": motor},
        "motion": {"start": "rolling", "profile": list(profile)},
        "load": {"torque_nm": load * MOTORS[motor].T_rated},
        "bus": {"bitrate": 0 if len(nodes) > len(NODES) else 1_000_000},
    })  # fmt: skip
    simulation = Simulation(world, codec(nodes, FD_FILE if fd else CLASSIC))
    return [block_of(simulation.step((), k * TICK)) for k in range(1, ticks + 1)]


def config_of(case):
    """Three drives, no thermal calibration."""
    return parse({
        "dbc": {"file": "traction_fd.dbc" if case.fd else "traction.dbc"},
        "drive": [{"node": node, "motor": case.motor} for node in case.nodes],
        "estimator": {"kind": case.filter},
    })  # fmt: skip


def run_case(case):
    """Play the honest frames through the fault into a gateway; never raises what `step` raises."""
    ticks = case.begin + case.ticks + case.tail
    begin = case.begin if case.gains else 0
    frames = honest(
        case.speed, case.motor, case.fd, ticks, case.load, case.nodes, case.gains, begin
    )
    bound = codec(case.nodes, FD_FILE if case.fd else CLASSIC)
    core, faults = Gateway(config_of(case), bound, 0), ValueFaults(bound, case.nodes)
    rows = [[] for _ in case.nodes]
    off = []
    off_rpm = []
    rated = MOTORS[case.motor].I_rated / math.sqrt(2.0)
    for tick, sent in enumerate(frames, start=1):
        now = case.begin < tick <= case.begin + case.ticks
        block = faults.apply([(case.kind, case.drive)] if now else [], sent)
        if now:
            off.append(faults.error.current_a.item(case.drive) / rated)
            off_rpm.append(faults.error.speed_rpm.item(case.drive))
        try:
            core.step(block, tick * TICK)
        except Exception as error:
            # The table says what raised and where.
            place = traceback.extract_tb(error.__traceback__)[-1]
            where = f"{place.filename.rsplit('/', 1)[-1]}:{place.lineno}"
            raised = f"{type(error).__name__} {where} tick {tick}"
            return Outcome(case, rows, raised, off, off_rpm)
        for row, drive in zip(rows, core.view.drives, strict=True):
            row.append(_row(tick, drive))
    return Outcome(case, rows, "", off, off_rpm)


def _row(tick, drive):
    numbers = (drive.speed_rad_s, drive.load_nm, drive.loss_probability, drive.nis)
    known = [math.nan if x is None else x for x in numbers]
    words = drive.adhesion, drive.adhesion_reason, drive.health, drive.sensor
    return Row(tick, *words, *known)
