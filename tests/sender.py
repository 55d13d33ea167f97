"""Frames as a drive would send them, for tests of the inbox and the core."""

import math
from pathlib import Path

import numpy as np

import dbc
from dbc.codec import bind
from dbc.e2e import protect
from dbc.frame import BRS, FD, Frame

CLASSIC = Path(dbc.__path__[0]) / "traction.dbc"
FD_FILE = Path(dbc.__path__[0]) / "traction_fd.dbc"
MS = 1_000_000
R_S, L_S, PSI, POLES = 0.28, 3.465e-3, 0.1989, 4


def codec_for(nodes=(1, 2, 3), path=CLASSIC):
    return bind(path, nodes)


class Sender:
    """One message of one drive: counters and protection like the real thing."""

    def __init__(self, codec, name):
        self.codec = codec
        self.spec = codec.by_name[name]
        self.counter = 0

    def frame(self, t_ns, **values):
        drives = any(s.name == "Quality" for s in self.spec.signals)
        given = {"Quality": 1, **values} if drives else values
        payload = self.codec.encode(self.spec, given)
        protect(self.spec, payload, self.counter)
        self.counter += 1
        flags = (FD | BRS) if self.spec.is_fd else 0
        return Frame(t_ns, self.spec.can_id, bytes(payload), flags, "vcan0")


class SteadyDrive:
    """A motor at constant speed and torque, exact in the stationary frame: no integrator needed.

    i = i_q e^(j(theta + pi/2)), u = R i + L di/dt + e, all of them rotating: the mean voltage
    over a sample interval is exact.
    """

    def __init__(self, codec, node, w, load, theta=0.3):
        self.node, self.w, self.theta = node, w, theta
        self.load = load
        self.currents = Sender(codec, f"Drive{node}_PhaseCurrents")
        self.voltages = Sender(codec, f"Drive{node}_StatorVoltages")
        self.status = Sender(codec, f"Drive{node}_Status")
        self.temperatures = Sender(codec, f"Drive{node}_Temperatures")
        self.celsius = (60.0, 50.0, 48.0, 20.0)
        self.command = 20.0

    def current(self, t):
        i_q = self.load / (1.5 * POLES * PSI)
        return 1j * i_q * np.exp(1j * (self.theta + self.w * t))

    def mean_voltage(self, a, b):
        i_q = self.load / (1.5 * POLES * PSI)
        flux = L_S * 1j * i_q + PSI
        turn = (np.exp(1j * self.w * b) - np.exp(1j * self.w * a)) * np.exp(1j * self.theta)
        return (flux * turn + R_S * 1j * i_q * turn / (1j * self.w)) / (b - a)

    def frames(self, k, period=2e-3):
        """Sample k: currents and voltages at (k + 1) periods, slow messages when due."""
        t = (k + 1) * period
        t_ns = round(t * 1e9)
        i = self.current(t)
        u = self.mean_voltage(t - period, t)
        b = -0.5 * i.real + math.sqrt(0.75) * i.imag
        out = [
            self.currents.frame(t_ns, Ia=i.real, Ib=b, Ic=-i.real - b),
            self.voltages.frame(t_ns, Ualpha=u.real, Ubeta=u.imag, Udc=540.0),
        ]
        if k % 50 == 0:
            names = ("Tstator", "Tde", "Tnde", "Tambient")
            out.append(
                self.status.frame(t_ns, TorqueCommand=self.command, Irms=10.0, State=2, FaultCode=0)
            )
            out.append(self.temperatures.frame(t_ns, **dict(zip(names, self.celsius, strict=True))))
        return out
