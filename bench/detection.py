"""`python -m bench.detection`: regenerate docs/evaluation/, how well losses and faults are found.

Each table is the output of one `traction-gateway evaluate`, whose command stands above it. On
reporting seeds; ten minutes on two cores.
"""

from __future__ import annotations

import argparse
import shutil
import subprocess
import sys
from pathlib import Path
from typing import Final

DOCS: Final = Path(__file__).parents[1] / "docs" / "evaluation"
FD: Final = "--dbc traction_fd.dbc"
BIG: Final = "--motor traction_350kw"
RUNS: Final = {
    "classic": "--seeds reporting --detector switching",
    "fd": f"--seeds 2000-2019 --detector switching {FD}",
    "motor_350kw": f"--seeds 2000-2019 --detector switching {BIG}",
    "motor_350kw_fd": f"--seeds 2000-2009 --detector switching {BIG} {FD}",
    "mismatch": "--seeds 2000-2019 --detector switching --family mismatch",
    "mismatch_fd": f"--seeds 2000-2019 --detector switching --family mismatch {FD}",
    "mismatch_350kw": f"--seeds 2000-2009 --detector switching --family mismatch {BIG}",
    "mismatch_350kw_fd": f"--seeds 2000-2009 --detector switching --family mismatch {BIG} {FD}",
    "hard_350kw": f"--seeds 3000-3179 --detector switching --family healthy_hard {BIG}",
    "hard": "--seeds 3000-3119 --detector switching --family healthy_hard",
    "thermal_days": "thermal --seeds reporting",
    "detectors": "--seeds 2000-2009 --family single majority n2 braking rough all_together",
}
"""Options of `evaluate` by the name of the table."""
PICTURES: Final = {"classic": ("roc.svg", "reliability.svg"), "detectors": ("roc.svg",)}


def run(name: str, raw: Path, jobs: int) -> None:
    """One evaluation into `raw`/`name`. Raises CalledProcessError."""
    command = [sys.executable, "-m", "gateway", "evaluate", *RUNS[name].split()]
    subprocess.run([*command, "-j", str(jobs), "-o", str(raw / name)], check=True)


def collect(name: str, raw: Path) -> Path:
    """The table with its command into docs/evaluation; its path."""
    title, _, rest = (raw / name / "evaluation.md").read_text(encoding="utf-8").partition("\n")
    pictures = PICTURES.get(name, ())
    shown = "".join(f"\n![{picture}]({name}-{picture})\n" for picture in pictures)
    target = DOCS / f"{name}.md"
    DOCS.mkdir(parents=True, exist_ok=True)
    text = f"{title}\n\n`traction-gateway evaluate {RUNS[name]}`\n{rest}{shown}"
    target.write_text(text, encoding="utf-8")
    for picture in pictures:
        shutil.copyfile(raw / name / picture, DOCS / f"{name}-{picture}")
    return target


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("name", nargs="*", metavar="TABLE", help=f"of {', '.join(RUNS)}; all")
    parser.add_argument("--raw", type=Path, default=Path("out/evaluation"), help="all files")
    parser.add_argument("--collect", action="store_true", help="only gather what is in --raw")
    parser.add_argument("-j", "--jobs", type=int, default=2)
    options = parser.parse_args()
    unknown = [name for name in options.name if name not in RUNS]
    if unknown:
        parser.error(f"no table {', '.join(unknown)}; there are {', '.join(RUNS)}")
    for name in options.name or RUNS:
        if not options.collect:
            run(name, options.raw, options.jobs)
        print(f"written: {collect(name, options.raw)}")


if __name__ == "__main__":
    main()
