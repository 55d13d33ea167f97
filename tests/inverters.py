"""Simulated drives that speak like other makers' inverters, and the DBCs of such."""

from gateway.hil.inverter_sim import Inverters
from gateway.mapping.plan import plans
from tests.simrun import codec


def spoken(config, frames):
    """Frames of simulated drives 1.. (classic) as the configuration's inverters send them."""
    return Inverters(plans(config), codec(config.nodes)).convert(frames)


DBC = """VERSION ""

NS_ :

BS_:

BU_: Inverter

{messages}
BA_DEF_ BO_ "GenMsgCycleTime" INT 0 3600000;
BA_DEF_DEF_ "GenMsgCycleTime" 0;
{cycles}
"""


def write_dbc(path, messages):
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
