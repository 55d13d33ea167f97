"""Simulated inverters against the gateway that labgrid has started, in real time.

    pip install labgrid msgpack    # msgpack: for python-can's udp_multicast
    pytest examples/labgrid --lg-env examples/labgrid/env.yaml --hil-gateway external \
        --can-interface udp_multicast --can-channel 239.74.163.2
"""

import pytest


@pytest.fixture(autouse=True)
def gateway(target):
    driver = target.get_driver("TractionGatewayDriver")
    yield
    target.deactivate(driver)


@pytest.mark.hil(settle=False)  # the gateway has just started
def test_a_lost_wheel_is_reported(inverter, gateway_flags):
    gateway_flags.expect_adhering(drive=2, within_ms=20_000)
    inverter.lose_adhesion(drive=2, depth=1.0, for_s=2.0)
    gateway_flags.expect_lost(drive=2, within_ms=2000)
