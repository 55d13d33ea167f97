"""What a worker of a fleet does in tests: as it should, but for logs that kill it."""

import os

from gateway.fleet.task import one_log


def kill_or_work(one, settings):
    """`poison.log` kills every worker, `once.log` the first that meets it, half-way."""
    met = settings.folder / f"{one.path.name}.met"
    if one.path.name == "poison.log" or (one.path.name == "once.log" and not met.exists()):
        met.touch()
        (settings.folder / "estimates" / f".{one.name}.0badf00d.part").touch()
        os._exit(9)
    return one_log(one, settings)
