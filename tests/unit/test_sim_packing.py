import numpy as np
import pytest

from sim.ecu import FAST
from sim.packing import Packer
from tests.simrun import FD_FILE, codec


@pytest.mark.parametrize("kind", FAST)
def test_block_equals_the_codec_on_every_byte(kind):
    c = codec(path=FD_FILE) if kind == "Samples" else codec()
    spec, names = c.by_name[f"Drive2_{kind}"], FAST[kind]
    rng = np.random.default_rng(1)
    rows = rng.normal(0.0, 1.0, (400, len(names))) * rng.choice([1, 50, 1e3, 1e5, 1e9], (400, 1))
    rows[rng.random(rows.shape) < 0.05] = np.nan
    rows[rng.random(rows.shape) < 0.02] = np.inf
    # Halfway between two codes, where rounding could differ.
    scale = np.array([spec.signals[spec.column(n)].scale for n in names])
    rows[:50] = (rng.integers(-300, 300, (50, len(names))) + 0.5) * scale
    for row, payload in zip(rows, Packer(c, spec, names).pack(rows), strict=True):
        assert payload == c.encode(spec, dict(zip(names, row.tolist(), strict=True)))


def test_signals_left_out_keep_their_start_value():
    spec = codec().by_name["Drive1_StatorVoltages"]
    packer = Packer(codec(), spec, ["Ubeta"])
    assert packer.pack(np.array([[12.3]])) == [codec().encode(spec, {"Ubeta": 12.3})]


def test_big_endian_signals_go_through_the_codec(tmp_path):
    text = codec().path.read_text()
    line = "SG_ Ubeta : 32|16@1- "
    assert line in text
    other = tmp_path / "motorola.dbc"
    other.write_text(text.replace(line, "SG_ Ubeta : 39|16@0- "))
    c = codec(path=other)
    spec = c.by_name["Drive1_StatorVoltages"]
    rows = np.array([[1.0, -12.3, 45.6, 299.0]])
    want = c.encode(spec, dict(zip(FAST["StatorVoltages"], rows[0].tolist(), strict=True)))
    assert Packer(c, spec, FAST["StatorVoltages"]).pack(rows) == [want]
    with pytest.raises(KeyError):
        Packer(c, spec, ["Nothing"])
