"""A bus and the gateway on it, for labgrid: a resource and a driver."""

import signal
import subprocess
import sys

import attr
from labgrid.driver import Driver
from labgrid.factory import target_factory
from labgrid.resource import Resource


@target_factory.reg_resource
@attr.s(eq=False)
class CanBus(Resource):
    """A bus by python-can's names."""

    interface = attr.ib(validator=attr.validators.instance_of(str))
    channel = attr.ib(validator=attr.validators.instance_of(str))


@target_factory.reg_driver
@attr.s(eq=False)
class TractionGatewayDriver(Driver):
    """The gateway runs while the driver is active."""

    bindings = {"bus": CanBus}  # noqa: RUF012 - labgrid's form
    config = attr.ib(default="", validator=attr.validators.instance_of(str))

    def on_activate(self):
        words = ["-i", self.bus.interface, "-c", self.bus.channel, "--quiet"]
        words += ["--config", self.config] if self.config else []
        self.process = subprocess.Popen([sys.executable, "-m", "gateway", "run", *words])

    def on_deactivate(self):
        self.process.send_signal(signal.SIGTERM)
        if self.process.wait(timeout=10) != 0:
            raise RuntimeError(f"the gateway ended with exit code {self.process.returncode}")
