"""What a calibration by comparison has learnt of a train of equal motors, for tests."""

from gateway.settings.calibration import Calibration, MotorCalibration


def motor(node, gain=1.0, offset_k=0.0, hold_s=0.5, step_k=0.5):
    """All sensors alike."""
    return MotorCalibration(
        node=node, gain=(gain,) * 3, offset_k=(offset_k,) * 3, longest_hold_s=(hold_s,) * 3,
        largest_step_k=(step_k,) * 3,
    )  # fmt: skip


def calibration(motors, maisd_k=0.5, deviation_k=1.0, window_s=2.0):
    return Calibration(
        window_s=window_s, maisd_limit_k=(maisd_k,) * 3, deviation_limit_k=(deviation_k,) * 3,
        motor=tuple(motors),
    )  # fmt: skip
