"""All mutants of a part in `parts.toml` that cosmic-ray knows, as JSON lines on stdout.

    python tests/mutation/mutants.py doubt > doubt.mutants

Runs in cosmic-ray's own environment, so it imports nothing of this project.
"""

from __future__ import annotations

import json
import sys
import tomllib
from pathlib import Path

from cosmic_ray.commands.init import _all_work_items
from cosmic_ray.mutating import mutate_code
from cosmic_ray.plugins import get_operator


def main() -> int:
    """A line per mutant: where, what, and the whole file as it makes it."""
    parts = tomllib.loads(Path(__file__).with_name("parts.toml").read_text())
    for item in _all_work_items(parts[sys.argv[1]]["modules"], {}):
        (spec,) = item.mutations
        path = Path(spec.module_path)
        operator = get_operator(spec.operator_name)(**spec.operator_args)
        code = mutate_code(path.read_text(), operator, spec.occurrence)
        mutant = {
            "module": str(path),
            "line": spec.start_pos[0],
            "operator": spec.operator_name.rsplit("/", 1)[-1],
            "code": code,
        }
        print(json.dumps(mutant))
    return 0


if __name__ == "__main__":
    sys.exit(main())
