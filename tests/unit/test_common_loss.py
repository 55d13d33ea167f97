"""All wheels lost at once, of many drives and with noisy currents: by mean load and command."""

import pytest

from dbc.e2e import counter_of, protect
from dbc.frame import Frame
from gateway.core.codes import Flag
from tests.simrun import codec, flags_and_speeds, scenario

NOISY_A2 = 0.02
"""Of each current: a hundred times the usual."""


def flags_of(drives, through=lambda frames, now: frames, **more):
    """(ticks, N) of a train at 60 % of rated torque."""
    run = scenario(
        duration_s=3.0, drives=drives, load={"torque_nm": 18.0}, slip_limiter="slow",
        motion={"profile": [(0.0, 200.0)]}, **more,
    )  # fmt: skip
    flags, _ = flags_and_speeds(run, codec(tuple(range(1, drives + 1))), through)
    return flags


@pytest.mark.parametrize("seed", [1, pytest.param(2, marks=pytest.mark.thorough)])
@pytest.mark.parametrize(("drives", "noise"), [(3, 2e-4), (3, NOISY_A2), (8, NOISY_A2)])
def test_a_quarter_of_all_loads_is_missed_whatever_one_noisy_load_says(drives, noise, seed):
    lost = [
        {"at_s": 2.0, "for_s": 1.0, "drive": node, "kind": "adhesion_loss", "depth": 0.25}
        for node in range(1, drives + 1)
    ]
    flags = flags_of(drives, seed=seed, event=lost, sensors={"current_noise_var": noise})
    assert not (flags[:200] == Flag.BAD).any()
    assert (flags[215:] == Flag.BAD).mean() > 0.5


@pytest.mark.parametrize("factor", [0.5, 1.4, 1.7, 2.5])
@pytest.mark.parametrize("drives", [3, pytest.param(8, marks=pytest.mark.thorough)])
def test_one_wrong_command_is_no_loss_of_all(drives, factor):
    """Its load, and all that the others say, is right."""
    coded = codec(tuple(range(1, drives + 1)))
    spec = coded.by_name["Drive1_Status"]
    signal = spec.signals[spec.column("TorqueCommand")]

    def through(frames, now):
        return [wrong(f) if f.can_id == spec.can_id and now > 2_000_000_000 else f for f in frames]

    def wrong(frame):
        values = {name: reading.value for name, reading in coded.decode(spec, frame.data).items()}
        values[signal.name] *= factor
        payload = coded.encode(spec, values)
        protect(spec, payload, counter_of(spec, frame.data))
        return Frame(frame.t_ns, frame.can_id, bytes(payload))

    flags = flags_of(drives, through)
    assert (flags[50:200] == Flag.GOOD).all()
    assert not (flags[200:, 1:] == Flag.BAD).any()
