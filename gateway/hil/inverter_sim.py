"""Simulated drives with other makers' messages: our frames are translated into theirs.

The reverse of `gateway.mapping.translate`, for `check` and for tests. May know: mappings, frames.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from typing import TYPE_CHECKING, Final

from dbc.codec import Codec
from dbc.frame import EXTENDED, FD, MS, Frame, Nanos
from dbc.spec import VALID

if TYPE_CHECKING:
    from gateway.mapping.plan import Plan

_SQRT3: Final = math.sqrt(3.0)


class Inverter:
    """One mapped drive, which translates the frames of a simulated drive."""

    def __init__(self, plan: Plan) -> None:
        self.plan = plan
        self._known: dict[str, float] = {}
        self._angle: tuple[float, Nanos] = (0.0, 0)
        self._turn = 1.0, 0.0
        self._due: dict[int, Nanos] = {}
        self._sent = 0
        self._turns = 1 << next(
            (
                signal.length
                for spec in plan.codec.messages
                for name, column, _ in plan.sources[spec.index]
                for signal in spec.signals
                if name == "Counter" and signal.name == column
            ),
            4,
        )

    def convert(self, kind: str, values: Mapping[str, float], t_ns: Nanos) -> Iterator[Frame]:
        """Frames of the other maker that are due when our frame of this kind comes at t_ns."""
        k = self._known
        k.update(values)
        if kind == "Motion":
            self._angle = (values["ElectricalAngle"], t_ns)
        if kind == "PhaseCurrents":
            self._currents(t_ns)
        # Currents and voltages of one instant arrive in this order.
        if kind != "StatorVoltages":
            return
        self._voltages()
        for spec in self.plan.codec.messages:
            if t_ns < self._due.get(spec.index, 0):
                continue
            wanted = {
                column: (k[quantity] - source.offset) / source.scale
                for quantity, column, source in self.plan.sources[spec.index]
                if quantity in k
            }
            if len(wanted) < len(self.plan.sources[spec.index]):
                continue
            self._due[spec.index] = t_ns + spec.cycle_ns - min(MS, spec.cycle_ns // 2)
            data = bytes(self.plan.codec.encode(spec, wanted))
            flags = (FD if spec.is_fd else 0) | (EXTENDED if spec.is_extended else 0)
            yield Frame(t_ns, spec.can_id, data, flags)

    def _currents(self, t_ns: Nanos) -> None:
        k = self._known
        alpha, beta = k["Ia"], (k["Ib"] - k["Ic"]) / _SQRT3
        at, begin = self._angle
        theta = at + 6.0 * k.get("Speed", 0.0) * self.plan.motor.pole_pairs * (t_ns - begin) * 1e-9
        cos, sin = math.cos(math.radians(theta)), math.sin(math.radians(theta))
        self._turn = cos, sin
        k |= {
            "ElectricalAngle": theta % 360.0, "Ialpha": alpha, "Ibeta": beta,
            "Id": alpha * cos + beta * sin, "Iq": beta * cos - alpha * sin,
        }  # fmt: skip
        self._sent += 1
        k["Counter"] = float(self._sent % self._turns)

    def _voltages(self) -> None:
        k, (cos, sin) = self._known, self._turn
        a, b = k["Ualpha"], k["Ubeta"]
        k |= {"Ud": a * cos + b * sin, "Uq": b * cos - a * sin}


class Inverters:
    """The mapped drives among simulated ones."""

    def __init__(self, planned: Sequence[Plan], ours: Codec) -> None:
        """ours: codec of the simulated drives' messages."""
        self._inverters = {plan.node: Inverter(plan) for plan in planned}
        self._ours = ours

    def convert(self, frames: Iterable[Frame]) -> list[Frame]:
        """Translate frames of mapped drives, and pass on those of others unchanged."""
        out: list[Frame] = []
        for frame in frames:
            spec = self._ours.by_id.get(frame.can_id)
            if spec is None or spec.node not in self._inverters:
                out.append(frame)
                continue
            read = self._ours.decode(spec, frame.data)
            good = {name: float(r.value) for name, r in read.items() if r.validity == VALID}
            out += self._inverters[spec.node].convert(spec.kind, good, frame.t_ns)
        return out
