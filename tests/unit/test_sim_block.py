import numpy as np
import pytest

from sim.ecu import FAST
from tests.reference import codec as reference
from tests.simrun import FD_FILE, codec


@pytest.mark.parametrize("kind", FAST)
def test_blocks_of_fast_messages_equal_the_reference_on_every_byte(kind):
    c = codec(path=FD_FILE) if kind == "Samples" else codec()
    spec, names = c.by_name[f"Drive2_{kind}"], FAST[kind]
    rng = np.random.default_rng(1)
    rows = rng.normal(0.0, 1.0, (400, len(names))) * rng.choice([1, 50, 1e3, 1e5, 1e9], (400, 1))
    rows[rng.random(rows.shape) < 0.05] = np.nan
    rows[rng.random(rows.shape) < 0.02] = np.inf
    # Halfway between two codes, where rounding could differ.
    scale = np.array([spec.signals[spec.column(n)].scale for n in names])
    rows[:50] = (rng.integers(-300, 300, (50, len(names))) + 0.5) * scale
    for row, payload in zip(rows, c.encode_rows(spec, names, rows), strict=True):
        assert payload == reference.encode(spec, dict(zip(names, row.tolist(), strict=True)))


def test_signals_left_out_keep_their_start_value():
    spec = codec().by_name["Drive1_StatorVoltages"]
    payloads = codec().encode_rows(spec, ["Ubeta"], np.array([[12.3]]))
    assert payloads == [codec().encode(spec, {"Ubeta": 12.3})]
