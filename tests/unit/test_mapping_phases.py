"""A phase current that is not available: what becomes of the other two."""

from collections import Counter

import pytest

from dbc.frame import Frame
from gateway.mapping.plan import fitted, plans
from gateway.mapping.translate import Translator
from gateway.settings.config import parse
from tests.inverters import write_dbc
from tests.simrun import codec

NONE = 0x7FFF
PHASES = ("Ia", "Ib", "Ic")


def translated(folder, names, raw, kind):
    """Values of our message of this kind, by its signals; samples with a phase that is derived."""
    voltages = ("Ualpha", "Ubeta")
    rows = {"Cur": (0x600, 10, [f'{n} : {16 * k}|16@1- (0.1,0) [0|0] "A"'
                                for k, n in enumerate(names)]),
            "Vol": (0x601, 10, [f'{n} : {16 * k}|16@1- (0.1,0) [0|0] "V"'
                                for k, n in enumerate(voltages)])}  # fmt: skip
    write_dbc(folder / "a.dbc", rows)
    use = {n: {"signal": f"Cur.{n}", "not_available": [NONE]} for n in names}
    use |= {n: {"signal": f"Vol.{n}", "not_available": [NONE]} for n in voltages}
    config = parse({"drive": [{"node": 1, "signals": {"dbc": "a.dbc", "use": use}}]}, base=folder)
    planned = plans(config)
    ours = fitted(codec(), planned)
    derived = []
    translator = Translator(planned, ours, lambda node, t_ns: derived.append((node, t_ns)))
    frames = [
        Frame(10**9, 0x600, b"".join(n.to_bytes(2, "little", signed=True) for n in raw).ljust(8)),
        Frame(10**9, 0x601, (NONE).to_bytes(2, "little") + bytes([20, 0, 0, 0, 0, 0])),
    ]
    for frame in translator.translate(frames, 10**9, Counter()).frames():
        spec = ours.by_id[frame.can_id]
        if spec.kind == kind:
            found = ours.decode(spec, frame.data).items()
            values = {k: r.value if r.validity == 0 else None for k, r in found}
            return [values[n] for n in values if n not in ("Crc", "Counter")], derived
    return None, derived


@pytest.mark.parametrize(
    ("raw", "wanted", "count"),
    [
        ((600, 400, -1000), [60, 40, -100], 0), ((600, 400, -900), [60, 40, -90], 0),
        ((600, 400, NONE), [60, 40, -100], 1), ((600, NONE, -1000), [60, 40, -100], 1),
        ((NONE, 400, -1000), [60, 40, -100], 1), ((600, NONE, NONE), [60, None, None], 0),
        ((NONE, 400, NONE), [None, 40, None], 0), ((NONE, NONE, 5), [None, None, 0.5], 0),
        ((NONE, NONE, NONE), [None, None, None], 0),
    ],
)  # fmt: skip
def test_a_phase_takes_no_other_with_it(tmp_path, raw, wanted, count):
    values, derived = translated(tmp_path, PHASES, raw, "PhaseCurrents")
    assert values == [None if w is None else pytest.approx(w) for w in wanted]
    assert derived == [(1, 10**9)] * count


@pytest.mark.parametrize(
    ("raw", "wanted"),
    [((600, 400), [60, 40, -100]), ((600, NONE), [60, None, None]), ((NONE, 5), [None, 0.5, None])],
)
def test_of_two_phases_each_stays(tmp_path, raw, wanted):
    values, _ = translated(tmp_path, PHASES[:2], raw, "PhaseCurrents")
    assert values == [None if w is None else pytest.approx(w) for w in wanted]


def test_alpha_is_known_without_beta(tmp_path):
    values, derived = translated(tmp_path, ("Ialpha", "Ibeta"), (600, NONE), "PhaseCurrents")
    assert values == [pytest.approx(60), None, None]
    assert derived == []


def test_a_voltage_takes_no_other_with_it(tmp_path):
    values, _ = translated(tmp_path, PHASES, (600, 400, -1000), "StatorVoltages")
    assert values == [None, pytest.approx(2.0)]
