"""All mutants of a file that cosmic-ray knows, as JSON lines on stdout.

    python tests/mutation/mutants.py dbc/spec.py > mutants.jsonl

Runs in cosmic-ray's own environment, so it imports nothing of this project.
"""

from __future__ import annotations

import json
import sys
from pathlib import Path

from cosmic_ray.commands.init import _all_work_items
from cosmic_ray.mutating import mutate_code
from cosmic_ray.plugins import get_operator


def main() -> int:
    """A line per mutant: where, what, and the whole file as it makes it."""
    source = Path(sys.argv[1]).read_text()
    for item in _all_work_items([sys.argv[1]], {}):
        (spec,) = item.mutations
        operator = get_operator(spec.operator_name)(**spec.operator_args)
        mutant = {
            "line": spec.start_pos[0],
            "operator": spec.operator_name.rsplit("/", 1)[-1],
            "code": mutate_code(source, operator, spec.occurrence),
        }
        print(json.dumps(mutant))
    return 0


if __name__ == "__main__":
    sys.exit(main())
