"""`python -m bench.real_temperatures -o docs/pictures`: recordings made by others, judged by us."""

from __future__ import annotations

import argparse
from pathlib import Path

from bench.real_findings import findings
from bench.real_pictures import draw


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("-o", "--output", type=Path, help="directory of the pictures")
    options = parser.parse_args()
    for line in findings():
        print(line, flush=True)
    if options.output:
        options.output.mkdir(parents=True, exist_ok=True)
        for path in draw(options.output):
            print(f"written: {path}")


if __name__ == "__main__":
    main()
