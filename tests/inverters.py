"""Simulated drives that speak like other makers' inverters: frames of ours into theirs."""

from __future__ import annotations

import math
from collections.abc import Iterator
from pathlib import Path

from dbc.codec import VALID
from dbc.frame import FD, Frame
from gateway.config import Config
from gateway.foreign import Plan, plans
from tests.simrun import codec

SQRT3 = math.sqrt(3.0)


class Inverter:
    """One drive of a mapped configuration, fed with what its simulated twin sends."""

    def __init__(self, plan: Plan) -> None:
        self.plan = plan
        self.known: dict[str, float] = {}
        self.angle = (0.0, 0)
        self.due: dict[int, int] = {}
        self.sent = 0

    def hear(self, name: str, values: dict[str, float], t_ns: int) -> Iterator[Frame]:
        """Frames of theirs that are due with this frame of ours, `name` its kind."""
        k = self.known
        k.update(values)
        if name == "Motion":
            self.angle = (values["ElectricalAngle"], t_ns)
        if name == "PhaseCurrents":
            self._currents(t_ns)
        if name == "StatorVoltages":
            self._voltages()
        # Currents and voltages of one instant come in this order.
        if name != "StatorVoltages":
            return
        for spec in self.plan.codec.messages:
            if t_ns < self.due.get(spec.index, 0):
                continue
            wanted = {
                column: (k[quantity] - source.offset) / source.scale
                for quantity, column, source in self.plan.sources[spec.index]
                if quantity in k
            }
            if len(wanted) < len(self.plan.sources[spec.index]):
                continue
            self.due[spec.index] = t_ns + spec.cycle_ns - 1_000_000
            data = bytes(self.plan.codec.encode(spec, wanted))
            yield Frame(t_ns, spec.can_id, data, FD if spec.is_fd else 0)

    def _currents(self, t_ns: int) -> None:
        k = self.known
        alpha, beta = k["Ia"], (k["Ib"] - k["Ic"]) / SQRT3
        at, begin = self.angle
        theta = at + 6.0 * k.get("Speed", 0.0) * self.plan.motor.pole_pairs * (t_ns - begin) * 1e-9
        cos, sin = math.cos(math.radians(theta)), math.sin(math.radians(theta))
        self.turn = cos, sin
        k |= {
            "ElectricalAngle": theta % 360.0, "Ialpha": alpha, "Ibeta": beta,
            "Id": alpha * cos + beta * sin, "Iq": beta * cos - alpha * sin,
        }  # fmt: skip
        self.sent += 1
        k["Counter"] = float(self.sent % 16)

    def _voltages(self) -> None:
        k, (cos, sin) = self.known, self.turn
        a, b = k["Ualpha"], k["Ubeta"]
        k |= {"Ud": a * cos + b * sin, "Uq": b * cos - a * sin}


def spoken(config: Config, frames: list[Frame]) -> list[Frame]:
    """Frames of simulated drives 1.. (classic) as the configuration's inverters send them."""
    inverters = {plan.node: Inverter(plan) for plan in plans(config)}
    ours = codec(config.nodes)
    out: list[Frame] = []
    for frame in frames:
        spec = ours.by_id.get(frame.can_id)
        if spec is None or spec.node not in inverters:
            out.append(frame)
            continue
        read = ours.decode(spec, frame.data)
        good = {name: r.value for name, r in read.items() if r.validity == VALID}
        out += inverters[spec.node].hear(spec.kind, good, frame.t_ns)
    return out


DBC = """VERSION ""

NS_ :

BS_:

BU_: Inverter

{messages}
BA_DEF_ BO_ "GenMsgCycleTime" INT 0 3600000;
BA_DEF_DEF_ "GenMsgCycleTime" 0;
{cycles}
"""


def write_dbc(path: Path, messages: dict[str, tuple[int, int, list[str]]]) -> Path:
    """A DBC: by name (identifier, cycle in ms, signals as DBC has them after `SG_`)."""
    text = "\n".join(
        f"BO_ {can_id} {name}: 8 Inverter\n" + "".join(f" SG_ {s} Vector__XXX\n" for s in signals)
        for name, (can_id, _, signals) in messages.items()
    )
    cycles = "\n".join(
        f'BA_ "GenMsgCycleTime" BO_ {can_id} {cycle};' for can_id, cycle, _ in messages.values()
    )
    path.write_text(DBC.format(messages=text, cycles=cycles))
    return path
