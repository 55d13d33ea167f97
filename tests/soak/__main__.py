"""Soaks: what adds up over hours and days, written to a file that is kept.

    python -m tests.soak full          # an hour of full traffic in virtual time: two minutes
    python -m tests.soak slow          # thirty days of slow messages: half an hour
    python -m tests.soak real          # an hour at twice the nominal load in real time

`--hours` for another length. Exit code 1, and what is wrong, where frames are lost or counters do
not add up, memory or descriptors grow, a tick sent no flags, or the loop falls behind the bus.
"""

import argparse
import json
import platform
import sys
import tempfile
import time
from pathlib import Path
from typing import Final

from tests.provenance import commit_of
from tests.soak import real, virtual
from tests.soak.books import wrong

RESULTS: Final = Path(__file__).parent / "results.json"
HOURS: Final = {"full": 1.0, "slow": 720.0, "real": 1.0}


def main():
    """Run one and keep what it came to beside the others."""
    parser = argparse.ArgumentParser(prog="python -m tests.soak", description=__doc__)
    parser.add_argument("kind", choices=HOURS)
    parser.add_argument("--hours", type=float, help="720 for slow, else 1")
    parser.add_argument("-o", type=Path, default=RESULTS)
    options = parser.parse_args()
    hours = options.hours or HOURS[options.kind]
    began, commit = time.perf_counter(), commit_of(RESULTS.parent)
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        if options.kind == "full":
            result = virtual.full_traffic(round(hours * 3600)).summary()
        elif options.kind == "slow":
            result = virtual.slow_messages(round(hours), virtual.slow_dbc(folder)).summary()
        else:
            result = real.run(hours * 3600, folder)
    result["machine"] = f"{platform.machine()}, Python {platform.python_version()}"
    result["commit"] = commit
    result["seconds"] = round(time.perf_counter() - began)
    kept = json.loads(options.o.read_text()) if options.o.exists() else {}
    options.o.write_text(json.dumps({**kept, options.kind: result}, indent=1) + "\n")
    print(json.dumps(result, indent=1))
    for what in (faults := wrong(result)):
        print(what, file=sys.stderr)
    return int(bool(faults))


if __name__ == "__main__":
    sys.exit(main())
