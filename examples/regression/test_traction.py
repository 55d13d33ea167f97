"""What a user's own regression suite looks like. Run it as it is.

On the virtual clock, seconds, and on a real bus, in real time:

    pytest examples/regression
    pytest examples/regression --can-interface socketcan --can-channel vcan0

Every test gets a bench of its own: simulated inverters and a gateway that has come so far that all
flags are good. Time passes only when a test says so.
"""

import pytest


def test_a_lost_wheel_is_flagged_and_no_other(inverter, gateway_flags):
    inverter.lose_adhesion(drive=2, depth=1.0, for_s=1.0)
    gateway_flags.expect_lost(drive=2, within_ms=60)
    gateway_flags.expect_never_lost(drive=1, for_ms=300)
    gateway_flags.expect_adhering(drive=2, within_ms=2000)


def test_a_silent_drive_is_unknown_not_good(inverter, gateway_flags):
    inverter.silence(drive=1, for_s=0.5)
    gateway_flags.expect_unknown(drive=1, within_ms=60)
    gateway_flags.expect("comm", "bad", within_ms=400)
    gateway_flags.expect_adhering(drive=1, within_ms=3000)


@pytest.mark.hil(drives=4, motion={"profile": [[0.0, 60.0]]})
def test_four_drives_of_which_two_are_lost(hil_bench, inverter, gateway_flags):
    inverter.lose_adhesion(drive=1, depth=0.8)
    inverter.lose_adhesion(drive=4, depth=0.8)
    hil_bench.run(0.3)
    assert gateway_flags.now("adhesion", 1).name == "BAD"
    assert gateway_flags.now("adhesion", 4).name == "BAD"
    assert gateway_flags.now("adhesion", 2).name == "GOOD"


def test_lost_frames_do_not_accuse(inverter, gateway_flags):
    inverter.lose_frames(drive=3, share=0.05)
    for drive in (1, 2, 3):
        gateway_flags.expect_never_lost(drive=drive, for_ms=700)
