"""Mutants of the compiled core: each compiled by itself, and judged by the core's own tests.

    python -m tests.mutation.core            # all, into core.json; a few minutes
    python -m tests.mutation.core --sample 12 --seed 3   # exit 1 if one is found no more

A mutant changes one operator, one number or one condition, or leaves out one statement. One whose
machine code is that of the original is none. Outcomes: killed, survived, none.
"""

from __future__ import annotations

import argparse
import hashlib
import json
import os
import random
import re
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any, NamedTuple

from core_build import DEPENDS, FLAGS, SOURCES, builder, compiler

ROOT = Path(__file__).parents[2]
KEPT = Path(__file__).with_name("core.json")
E2E = ("tests/unit/test_e2e_reference.py", "tests/unit/test_e2e.py")
CANDUMP = ("tests/unit/test_dbc_candump.py", "tests/property/test_dbc_candump_property.py")
CODEC = ("tests/unit/test_codec_reference.py",)
RESPONSE = ("tests/unit/test_response_reference.py", "tests/unit/test_detect_learning.py")
MONITOR = (
    "tests/unit/test_thermal_reference.py", "tests/unit/test_thermal_monitor_odd.py",
    "tests/unit/test_thermal_monitor_order.py", "tests/unit/test_thermal_monitor.py",
)  # fmt: skip
IMM = ("tests/unit/test_thermal_reference.py", "tests/unit/test_thermal_imm.py")
ACQUISITION = tuple(f"tests/unit/test_est_acquisition.py::{name}" for name in (
    "test_it_equals_the_reference", "test_the_check_equals_the_reference",
    "test_chords_of_known_motion", "test_chords_of_another_length_start_anew",
    "test_no_chord_has_no_direction_and_is_never_ready",
    "test_constants_beyond_any_motor_overflow_a_mean_and_it_starts_anew",
))  # fmt: skip
MOTION = ("tests/unit/test_motion_reference.py", *(
    f"tests/unit/test_motion.py::{name}" for name in (
        "test_a_rotor_that_turns_and_is_not_found_is_implausible",
        "test_without_a_reading_a_fast_drive_is_unknown",
        "test_motion_that_stands_still_beside_a_moving_rotor_is_not_known",
        "test_motion_stands_still_while_all_others_move",
        "test_a_current_of_which_one_half_stays_is_no_repeat",
        "test_an_angle_that_is_off_for_a_minute_is_the_new_one",
    )
))  # fmt: skip
TESTS = {
    "dbc/crc.c": E2E, "dbc/e2e.c": E2E,
    "dbc/decode.c": CODEC, "dbc/encode.c": CODEC,
    "gateway/core/flags.c": ("tests/unit/test_flags.py", "tests/unit/test_flags_reference.py"),
    "estimators/detect/variational.c": ("tests/unit/test_variational_reference.py",),
    **dict.fromkeys((
        "estimators/detect/switching.c", "estimators/detect/switching_drive.c",
    ), ("tests/unit/test_switching_reference.py", "tests/unit/test_switching.py")),
    "gateway/core/switching_loss.c": ("tests/unit/test_adhesion_reference.py",),
    "estimators/detect/load_reference.c": RESPONSE,
    "estimators/detect/command_response.c": RESPONSE,
    "estimators/elementary.c": ("tests/unit/test_elementary.py",),
    "estimators/order_statistics.c": (
        "tests/unit/test_maisd.py", "tests/unit/test_thermal_reference.py",
    ),
    "estimators/maisd.c": ("tests/unit/test_maisd.py",),
    "estimators/thermal/gaussian_mixture.c": ("tests/unit/test_sigma_mixed.py",),
    "estimators/thermal/sigma_mixed.c": ("tests/unit/test_sigma_mixed.py",),
    "estimators/thermal/model.c": ("tests/unit/test_thermal_reference.py",),
    "estimators/thermal/step_detector.c": ("tests/unit/test_thermal_reference.py",),
    "estimators/thermal/peers.c": ("tests/unit/test_thermal_reference.py",),
    "estimators/thermal/hypotheses.c": ("tests/unit/test_thermal_reference.py",),
    "estimators/thermal/imm.c": IMM,
    "estimators/thermal/imm_predict.c": IMM,
    "estimators/thermal/imm_update.c": IMM,
    "estimators/thermal/residuals.c": MONITOR,
    "estimators/thermal/monitor.c": MONITOR,
    "gateway/core/temperature.c": ("tests/unit/test_temperature.py", "tests/unit/test_sensors.py"),
    "estimators/trigonometry.c": ("tests/unit/test_trigonometry.py",),
    "estimators/acquisition.c": ACQUISITION,
    "estimators/adaptation.c": ("tests/unit/test_est_adaptation.py",),
    "estimators/current_calibration.c": ("tests/unit/test_est_current_calibration.py",),
    "estimators/filter.c": ("tests/unit/test_est_filter.py",),
    "estimators/filter_simd.c": ("tests/unit/test_est_filter.py",),
    **dict.fromkeys((
        "gateway/core/receive.c", "gateway/core/pairing.c", "gateway/core/sequence.c",
        "gateway/core/supervision.c",
    ), ("tests/unit/test_receive_reference.py",)),
    "gateway/core/rotors.c": ("tests/unit/test_train_reference.py",),
    "gateway/core/integrity.c": ("tests/unit/test_integrity.py",),
    "estimators/thermal/trend.c": ("tests/unit/test_thermal_trend.py",),
    **dict.fromkeys(("gateway/core/thermal.c", "gateway/core/thermal_evidence.c"), (
        "tests/unit/test_temperature_monitor.py", "tests/unit/test_thermal.py",
    )),
    "gateway/core/busload.c": ("tests/unit/test_outbox.py",),
    "gateway/core/transmit.c": ("tests/unit/test_outbox.py",),
    "gateway/core/train.c": ("tests/unit/test_train_reference.py",),
    "sim/physics/plant.c": ("tests/unit/test_sim_plant.py", "tests/unit/test_sim_adhesion.py"),
    "sim/physics/thermal.c": ("tests/unit/test_sim_thermal.py",),
    **dict.fromkeys(("dbc/candump_read.c", "dbc/candump_write.c"), CANDUMP),
    "gateway/core/loads.c": ("tests/unit/test_adhesion_reference.py",),
    "dbc/socketcan.c": ("tests/unit/test_drivers_batch.py",),
    "gateway/core/estimate.c": ("tests/unit/test_estimate_reference.py",),
    "gateway/core/adhesion.c": ("tests/unit/test_adhesion_reference.py",),
    "gateway/core/inputs.c": ("tests/unit/test_inputs.py",),
    "estimators/load_observer.c": ("tests/unit/test_est_load_observer.py",),
    "gateway/core/motion.c": MOTION,
    "gateway/core/tick.c": ("tests/unit/test_ticks.py", "tests/golden/test_golden.py"),
    "gateway/core/plausibility.c": MOTION,
    "gateway/core/current_plausibility.c": MOTION,
    **dict.fromkeys((
        "estimators/detect/paper.c", "estimators/detect/paper_vb.c",
        "estimators/detect/message_passing.c",
    ), ("tests/unit/test_detect_paper.py",)),
    "estimators/thermal/rivals/ekf.c": ("tests/unit/test_thermal_rivals.py",),
}  # fmt: skip
"""Those that answer for a source."""
NOT_YET = tuple(source for source in TESTS if source not in ("dbc/crc.c", "dbc/e2e.c"))
"""Sources whose mutants have not been judged since they became C."""
LIMIT_S = 120
SWAPS = {
    "==": "!=", "!=": "==", "<": "<=", "<=": "<", ">": ">=", ">=": ">", "+": "-", "-": "+",
    "&": "|", "|": "&", "^": "&", "<<": ">>", ">>": "<<", "&&": "||", "||": "&&", "%": "*",
    "+=": "-=",
}  # fmt: skip
TOKEN = re.compile(
    r"->|\+\+|--|<<|>>|&&|\|\||[-+*/%&|^!=<>]=|[-+%&|^<>]|(?<![\w.])(?<!e-)(?:0x[0-9A-F]+|\d+)(?![\w.])"
)
"""Operators, and whole numbers: parts of fractions are none."""
STATEMENT = re.compile(r"\s+(?:[\w\->.\[\]]+ [-+|&]?= .*|\w+\(.*\)|break);")
CONDITION = re.compile(r"\b(?:if|while) \((.*)\)")


class Mutant(NamedTuple):
    """One line of a source, changed."""

    source: str
    line: int
    before: str
    after: str


def code_lines(text: str) -> Iterator[tuple[int, str]]:
    """Lines of code, from 1: without comments, tables, includes and names of constants."""
    blank = re.sub(r"/\*.*?\*/", lambda m: re.sub(r"[^\n]", " ", m.group()), text, flags=re.DOTALL)
    inside = False
    for number, line in enumerate(blank.splitlines(), 1):
        inside = inside or line.startswith("{")
        table = line.startswith("    [")
        if (inside or table) and line.strip() not in ("", "{", "}"):
            yield number, line.rstrip()
        inside = inside and not line.startswith("}")


def changes(line: str) -> Iterator[str]:
    """Every change of a line of code."""
    for found in TOKEN.finditer(line):
        token = found.group()
        if token[0].isdigit():
            number = int(token, 0)
            new = [str(number + 1), *([str(number - 1)] if number > 0 else [])]
        else:
            # A pointer's star, an address and a minus before a number have no blank behind.
            binary = line[found.end() : found.end() + 1] == " "
            new = [SWAPS[token]] if binary and token in SWAPS else []
        for one in new:
            yield line[: found.start()] + one + line[found.end() :]
    for found in CONDITION.finditer(line):
        yield f"{line[: found.start(1)]}!({found.group(1)}){line[found.end(1) :]}"
    if STATEMENT.fullmatch(line):
        yield ";"


def mutants() -> list[Mutant]:
    """Of all sources of the core."""
    return [
        Mutant(source, number, line.strip(), after.strip())
        for source in SOURCES
        for number, line in code_lines((ROOT / source).read_text())
        for after in changes(line)
    ]


class Bench:
    """A folder in which all objects lie; each mutant replaces one."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.cc = compiler()
        for header in DEPENDS:
            (folder / header).parent.mkdir(parents=True, exist_ok=True)
            shutil.copy(ROOT / header, folder / header)
        glue = folder / "_traction_core.c"
        builder().emit_c_code(str(glue))
        import sysconfig

        include = sysconfig.get_path("include")
        self.objects = {"": folder / "glue.o"}
        self._compile(glue, self.objects[""], f"-I{include}", "-DPy_LIMITED_API=0x030b0000")
        for source in SOURCES:
            # Under the name of a mutant, so that the same code is the same object.
            copy = folder / source.replace("/", "_") / "mutant.c"
            copy.parent.mkdir()
            shutil.copy(ROOT / source, copy)
            self.objects[source] = copy.with_suffix(".o")
            self._compile(copy, self.objects[source])

    def _compile(self, source: Path, to: Path, *more: str) -> bool:
        command = [*self.cc, *FLAGS, "-fPIC", f"-I{self.folder}", *more, "-c", str(source), "-o",
                   str(to)]  # fmt: skip
        return not subprocess.run(command, capture_output=True, check=False).returncode

    def judge(self, mutant: Mutant) -> str:
        """Its outcome."""
        with tempfile.TemporaryDirectory(dir=self.folder) as name:
            place = Path(name)
            lines = (ROOT / mutant.source).read_text().splitlines()
            lines[mutant.line - 1] = mutant.after
            source, changed = place / "mutant.c", place / "mutant.o"
            source.write_text("\n".join(lines) + "\n")
            same = self.objects[mutant.source]
            if not self._compile(source, changed) or changed.read_bytes() == same.read_bytes():
                return "none"
            objects = [str(o) for s, o in self.objects.items() if s != mutant.source]
            subprocess.run([*self.cc, "-shared", *objects, str(changed), "-lm", "-o",
                            str(place / "_traction_core.abi3.so")], check=True)  # fmt: skip
            (place / "sitecustomize.py").write_text("import _traction_core\n")
            paths = os.pathsep.join([str(place), str(ROOT)])
            command = [sys.executable, "-m", "pytest", "-x", "-q", "-p", "no:cacheprovider",
                       *TESTS[mutant.source]]  # fmt: skip
            try:
                done = subprocess.run(
                    command, cwd=ROOT, capture_output=True, timeout=LIMIT_S, check=False,
                    env={**os.environ, "PYTHONPATH": paths},
                )  # fmt: skip
            except subprocess.TimeoutExpired:
                return "killed"
            return "killed" if done.returncode else "survived"


def digest(source: str) -> str:
    """Of what the outcomes of a source depend on: its text, its own header, and how it is built."""
    header = (ROOT / source).with_suffix(".h")
    total = hashlib.sha256(" ".join(FLAGS).encode())
    for path in (ROOT / source, header):
        total.update(path.read_bytes() if path.exists() else b"")
    return total.hexdigest()


def main() -> int:
    """Judge the mutants of some sources and keep it, or some of the kept ones."""
    parser = argparse.ArgumentParser(prog="python -m tests.mutation.core", description=__doc__)
    parser.add_argument("source", nargs="*", help="sources; default: all that are stale")
    parser.add_argument("--sample", type=int)
    parser.add_argument("--seed", type=int, default=1)
    options = parser.parse_args()
    kept = _kept()
    digests, rows = kept["digests"], kept["mutants"]
    sources = options.source or [s for s in TESTS if digests.get(s) != digest(s)]
    chosen = [mutant for mutant in mutants() if mutant.source in sources]
    if options.sample:
        killed = [Mutant(*row[:4]) for row in rows if row[4] == "killed"]
        chosen = random.Random(options.seed).sample(killed, options.sample)
    with tempfile.TemporaryDirectory() as folder, ThreadPoolExecutor(os.cpu_count()) as pool:
        bench = Bench(Path(folder))
        outcomes = list(pool.map(bench.judge, chosen))
    new: list[list[Any]] = [[*m, outcome] for m, outcome in zip(chosen, outcomes, strict=True)]
    for row in new:
        if row[4] == "survived":
            print(f"{row[0]}:{row[1]}: {row[2]}  ->  {row[3]}")
    counts = {name: outcomes.count(name) for name in ("killed", "survived", "none")}
    print(counts)
    if options.sample:
        return int(counts["killed"] < len(new))
    # Why a survivor may survive is written by hand, and stays where its line has moved.
    reasons = {(row[0], row[2], row[3]): row[5] for row in rows if len(row) > 5}
    for row in new:
        if row[4] == "survived" and (row[0], row[2], row[3]) in reasons:
            row.append(reasons[row[0], row[2], row[3]])
    digests.update({source: digest(source) for source in sources})
    everything = [row for row in rows if row[0] not in sources] + new
    text = ",\n".join(json.dumps(row) for row in everything)
    KEPT.write_text(f'{{"digests": {json.dumps(digests)},\n"mutants": [\n{text}\n]}}\n')
    return 0


def _kept() -> dict[str, Any]:
    empty: dict[str, Any] = {"digests": {}, "mutants": []}
    return json.loads(KEPT.read_text()) if KEPT.exists() else empty


if __name__ == "__main__":
    sys.exit(main())
