"""The live table of `demo` and `run`: one row per drive, the state of the gateway below."""

from __future__ import annotations

from rich.console import Group
from rich.table import Table
from rich.text import Text

from gateway.core.codes import FaultClass, Flag, GatewayState, Health, Reason
from gateway.core.view import GatewayView
from gateway.reports.record import ADHESION, FAULT, camel

_STYLE = {Flag.UNKNOWN: "yellow", Flag.GOOD: "green", Flag.BAD: "bold red"}


def _number(value: float | None, digits: int, unit: str) -> str:
    return "-" if value is None else f"{value:.{digits}f} {unit}"


def render(view: GatewayView, title: str) -> Group:
    """Table with the main values of all drives. Flags are shown as words, not as colour alone."""
    table = Table(title=title, title_justify="left", expand=False)
    for head in ("drive", "adhesion", "P(lost)", "load", "speed", "health", "thermal", "mixed"):
        table.add_column(head, justify="left" if head in ("adhesion", "health") else "right")
    for d in view.drives:
        thermal = FAULT[d.thermal]
        if d.fault_class not in (FaultClass.UNKNOWN, FaultClass.NONE):
            thermal += f" {camel(d.fault_class.name)}"
        table.add_row(
            str(d.node),
            Text(ADHESION[d.adhesion], style=_STYLE[d.adhesion]),
            _number(None if d.loss_probability is None else 100 * d.loss_probability, 0, "%"),
            _number(d.load_nm, 1, "Nm"),
            _number(d.speed_rad_s, 1, "rad/s"),
            camel(Health(d.health).name),
            Text(thermal, style=_STYLE[d.thermal]),
            _number(d.mixed_c, 1, "degC"),
        )
    reason = camel(Reason(view.adhesion_reason).name)
    line = (
        f"{camel(GatewayState(view.state).name)}  reason {reason}  comm {FAULT[view.comm]}  "
        f"sensors {FAULT[view.sensor]}  estimators {FAULT[view.estimator]}  "
        f"bus {_number(view.bus_load_percent, 0, '%')}  missed ticks {view.deadline_misses}  "
        f"rejected {view.rejected}  lost {view.lost}"
    )
    return Group(table, Text(line))
