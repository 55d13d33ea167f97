"""Mutants of the compiled core: each compiled by itself, and judged by the core's own tests.

    python -m tests.mutation.core            # all that have changed, into core.json; hours
    python -m tests.mutation.core --sample 12 --seed 3   # exit 1 if one is found no more

A mutant changes one operator, one number or one condition, or leaves out one statement. One whose
machine code is that of the original is none. Of a source with more than SAMPLE of them that many
are judged, by seed. Outcomes: killed, survived, none. A survivor has a sixth column, by hand: why
it may survive, beginning with "equivalent: " where nothing that it does tells it from the original.
Only the mutated source is compiled, and its functions take the place of the core's in a child of a
pytest that has imported and collected the tests once (forked.py).
"""

from __future__ import annotations

import argparse
import hashlib
import json
import random
import re
import subprocess
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any, NamedTuple

from core_build import FLAGS, compiler

ROOT = Path(__file__).parents[2]
KEPT = Path(__file__).with_name("core.json")
E2E = ("tests/unit/test_e2e_reference.py", "tests/unit/test_e2e.py")
CANDUMP = ("tests/unit/test_dbc_candump.py", "tests/property/test_dbc_candump_property.py")
CANDUMP_READ = ("tests/unit/test_candump_read.py", *CANDUMP)
CODEC = ("tests/unit/test_codec_reference.py",)
RESPONSE = ("tests/unit/test_response_reference.py", "tests/unit/test_detect_learning.py")
MONITOR = (
    "tests/unit/test_thermal_reference.py", "tests/unit/test_thermal_monitor_odd.py",
    "tests/unit/test_thermal_monitor_order.py", "tests/unit/test_thermal_monitor.py",
    "tests/unit/test_thermal_coverage.py", "tests/unit/test_thermal_cut_out.py",
)  # fmt: skip
IMM = ("tests/unit/test_thermal_reference.py", "tests/unit/test_thermal_imm.py")
ACQUISITION = tuple(f"tests/unit/test_est_acquisition.py::{name}" for name in (
    "test_it_equals_the_reference", "test_the_check_equals_the_reference",
    "test_chords_of_known_motion", "test_chords_of_another_length_start_anew",
    "test_no_chord_has_no_direction_and_is_never_ready",
    "test_constants_beyond_any_motor_overflow_a_mean_and_it_starts_anew",
    "test_the_longest_chord_that_a_flux_explains_bounds_no_speed",
    "test_a_filter_of_which_any_number_has_diverged_disagrees",
    "test_on_its_limits_a_filter_is_consistent",
))  # fmt: skip
MOTION = ("tests/unit/test_motion_reference.py", *(
    f"tests/unit/test_motion.py::{name}" for name in (
        "test_a_rotor_that_turns_and_is_not_found_is_implausible",
        "test_without_a_reading_a_fast_drive_is_unknown",
        "test_motion_that_stands_still_beside_a_moving_rotor_is_not_known",
        "test_motion_stands_still_while_all_others_move",
        "test_motion_that_stands_is_compared_with_every_other_drive_since_it_stands",
        "test_of_every_drive_the_speeds_are_kept_that_were_measured_when_its_motion_changed",
        "test_a_command_that_stays_and_a_speed_that_has_come_to_that_of_motion_are_no_contradiction",
        "test_a_speed_within_four_standard_deviations_of_motion_does_not_contradict_it",
        "test_a_filter_starts_anew_from_20_ms_before_the_end_of_implausible_input",
        "test_a_current_that_stays_while_its_rotor_turns_is_implausible",
        "test_at_high_speed_the_largest_current_of_a_tick_explains_the_torque",
        "test_a_current_of_which_one_half_stays_is_no_repeat",
        "test_an_angle_that_is_off_for_a_minute_is_the_new_one",
        "test_at_a_crawl_a_motion_that_repeats_for_more_than_two_and_a_half_cycles_accuses_nobody",
        "test_on_its_limits_motion_is_in_order", "test_on_their_limits_command_and_load_fit",
        "test_a_load_that_its_observer_still_follows_contradicts_no_filter",
        "test_with_fifteen_percent_of_rated_a_current_says_something",
        "test_without_a_motion_the_noise_of_the_filters_speed_changes_no_source",
        "test_a_drive_that_crawls_has_the_load_of_its_motion_and_without_one_that_of_its_filter",
    )
))  # fmt: skip
GOLDEN = "tests/golden/test_golden.py"
"""Recorded logs through the whole tick: for every source that a tick goes through."""
TESTS = {
    "dbc/crc.c": E2E, "dbc/e2e.c": E2E,
    "dbc/decode.c": CODEC, "dbc/encode.c": CODEC,
    "gateway/core/flags.c": ("tests/unit/test_flags.py", "tests/unit/test_flags_reference.py"),
    "estimators/detect/variational.c": ("tests/unit/test_variational_reference.py",),
    **dict.fromkeys((
        "estimators/detect/switching.c", "estimators/detect/switching_drive.c",
        "estimators/detect/switching_mixture.c", "estimators/detect/switching_noise.c",
    ), ("tests/unit/test_switching_reference.py", "tests/unit/test_switching.py")),
    "gateway/core/switching_loss.c": ("tests/unit/test_adhesion_reference.py",),
    "gateway/core/common_loss.c": ("tests/unit/test_adhesion_reference.py",),
    "estimators/detect/load_reference.c": RESPONSE,
    "estimators/detect/command_response.c": RESPONSE,
    "estimators/elementary.c": ("tests/unit/test_elementary.py",),
    "estimators/order_statistics.c": ("tests/unit/test_order_statistics.py",),
    "estimators/maisd.c": ("tests/unit/test_maisd.py",),
    "estimators/thermal/gaussian_mixture.c": ("tests/unit/test_sigma_mixed.py",),
    "estimators/thermal/sigma_mixed.c": ("tests/unit/test_sigma_mixed.py",),
    "estimators/thermal/model.c": ("tests/unit/test_thermal_reference.py",),
    "estimators/thermal/step_detector.c": (
        "tests/unit/test_thermal_reference.py", "tests/unit/test_residuals_reference.py",
    ),
    "estimators/thermal/peers.c": ("tests/unit/test_thermal_reference.py",),
    "estimators/thermal/hypotheses.c": ("tests/unit/test_thermal_reference.py",),
    "estimators/thermal/imm.c": IMM,
    "estimators/thermal/imm_predict.c": IMM,
    "estimators/thermal/imm_update.c": IMM,
    "estimators/thermal/residuals.c": (
        "tests/unit/test_residuals_reference.py", "tests/unit/test_thermal_step_detector.py",
    ),
    "estimators/thermal/monitor.c": MONITOR,
    "gateway/core/temperature.c": ("tests/unit/test_temperature.py", "tests/unit/test_sensors.py"),
    "estimators/trigonometry.c": ("tests/unit/test_trigonometry.py",),
    "estimators/acquisition.c": ACQUISITION,
    "estimators/adaptation.c": ("tests/unit/test_est_adaptation.py",),
    "estimators/current_calibration.c": ("tests/unit/test_est_current_calibration.py",),
    "estimators/filter.c": ("tests/unit/test_est_filter.py",),
    "estimators/filter_simd.c": ("tests/unit/test_est_filter.py",),
    **dict.fromkeys((
        "gateway/core/receive.c", "gateway/core/sequence.c", "gateway/core/supervision.c",
    ), ("tests/unit/test_receive_reference.py",)),
    "gateway/core/pairing.c": (
        "tests/unit/test_receive_reference.py", "tests/unit/test_left_out_samples.py::"
        "test_what_a_sender_leaves_out_without_counting_changes_nothing",
    ),
    "gateway/core/sample_clock.c": ("tests/unit/test_sample_clock.py",),
    "gateway/core/rotors.c": (
        "tests/unit/test_train_reference.py", "tests/unit/test_adhesion_reference.py",
    ),
    "gateway/core/integrity.c": ("tests/unit/test_integrity.py",),
    "estimators/thermal/trend.c": ("tests/unit/test_thermal_trend.py",),
    "estimators/thermal/cut_out.c": (
        "tests/unit/test_temperature_monitor.py", "tests/unit/test_thermal_cut_out.py",
    ),
    **dict.fromkeys((
        "gateway/core/thermal.c", "gateway/core/temperature_window.c",
        "gateway/core/thermal_evidence.c",
    ), (
        "tests/unit/test_temperature_monitor.py", "tests/unit/test_thermal.py",
        "tests/unit/test_bad_from_power_up.py", "tests/unit/test_maisd_spikes.py",
        "tests/unit/test_heatside.py::test_a_faulty_sensor_hides_no_heat_and_is_none_itself",
        "tests/unit/test_heatside.py::test_a_sensor_that_crept_and_is_mended_has_no_offset",
        "tests/unit/test_temperature_reader.py::test_the_current_is_known_without_another_signal",
        "tests/unit/test_temperature_reader.py::test_a_current_is_known_as_long_as_its_own_frames_are_good",
    )),
    "gateway/core/busload.c": ("tests/unit/test_outbox.py",),
    "gateway/core/transmit.c": (
        "tests/unit/test_outbox.py", "tests/unit/test_creep.py::test_cantools_reads_what_is_sent",
    ),
    "gateway/core/train_speed.c": ("tests/unit/test_train_reference.py",),
    "gateway/core/train.c": ("tests/unit/test_train_reference.py",),
    "gateway/core/creep.c": ("tests/unit/test_creep.py",),
    "sim/physics/plant.c": ("tests/unit/test_sim_plant.py", "tests/unit/test_sim_adhesion.py"),
    "sim/physics/thermal.c": ("tests/unit/test_sim_thermal.py",),
    "dbc/candump_read.c": CANDUMP_READ, "dbc/candump_write.c": CANDUMP,
    "dbc/text_read.c": ("tests/unit/test_text_read.py",),
    "gateway/core/loads.c": tuple(f"tests/unit/test_adhesion_reference.py::{name}" for name in (
        "test_numbers_on_limits", "test_what_lies_behind_the_drives_is_left_alone", "test_anything",
    )),
    "dbc/socketcan.c": ("tests/unit/test_drivers_batch.py",),
    "gateway/core/estimate.c": ("tests/unit/test_estimate_reference.py",),
    "gateway/core/adhesion.c": ("tests/unit/test_adhesion_reference.py",),
    "gateway/core/inputs.c": ("tests/unit/test_inputs.py",),
    "estimators/load_observer.c": ("tests/unit/test_est_load_observer.py",),
    "gateway/core/motion.c": MOTION,
    "gateway/core/tick.c": (
        "tests/unit/test_ticks.py", "tests/unit/test_tick_log.py::"
        "test_a_full_log_takes_no_tick_and_its_memory_outlives_who_reads_it",
    ),
    "gateway/core/plausibility.c": MOTION,
    "gateway/core/current_plausibility.c": MOTION,
    **dict.fromkeys((
        "estimators/detect/paper.c", "estimators/detect/paper_vb.c",
        "estimators/detect/message_passing.c",
    ), ("tests/unit/test_detect_paper.py",)),
    "gateway/core/thermal_log.c": ("tests/unit/test_temperature_reader.py",),
    **dict.fromkeys(
        ("gateway/core/tick_log.c", "gateway/core/table_text.c"), ("tests/unit/test_tick_log.py",)
    ),
    "estimators/thermal/rivals/ekf.c": ("tests/unit/test_thermal_rivals.py",),
}  # fmt: skip
"""Those that answer for a source."""
NOT_YET: tuple[str, ...] = ()
"""Sources of which 94 % have not been killed since their text last changed."""
SAMPLE = 60
"""At most so many of a source, by seed; the same ones until its text changes."""
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
COMMENT = re.compile(r"/\*.*?\*/", re.DOTALL)
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


def mutants(source: str) -> list[Mutant]:
    """All of a source of the core."""
    return [
        Mutant(source, number, line.strip(), after.strip())
        for number, line in code_lines((ROOT / source).read_text())
        for after in changes(line)
    ]


def sample(source: str) -> list[Mutant]:
    """Those of a source that are judged: all, or SAMPLE of them by seed."""
    every = mutants(source)
    if len(every) <= SAMPLE:
        return every
    return sorted(random.Random(source).sample(every, SAMPLE))


def _compile(source: Path, to: Path) -> bool:
    # Whoever looks behind the end of an array is stopped there, as by the sanitizers in CI.
    bounds = ("-fsanitize=bounds", "-fsanitize-undefined-trap-on-error")
    command = [*compiler(), *FLAGS, "-O1", *bounds, "-fPIC", f"-I{ROOT}", "-c", str(source),
               "-o", str(to)]  # fmt: skip
    return not subprocess.run(command, capture_output=True, check=False).returncode


def libraries(source: str, chosen: Sequence[Mutant], folder: Path) -> list[Path | None]:
    """A shared library of each mutant of a source; None: it is none, or cannot be compiled."""
    lines = (ROOT / source).read_text().splitlines()
    # All under one name and at one place, so that the same code is the same object.
    changed, made = folder / "mutant.c", folder / "mutant.o"

    def object_of(text: Sequence[str]) -> bytes:
        changed.write_text("\n".join(text) + "\n")
        return made.read_bytes() if _compile(changed, made) else b""

    original = object_of(lines)
    found: list[Path | None] = []
    for k, mutant in enumerate(chosen):
        at = mutant.line - 1
        if object_of([*lines[:at], mutant.after, *lines[at + 1 :]]) in (original, b""):
            found.append(None)
            continue
        # Its own functions and tables first, then those of the core that is loaded.
        found.append(folder / f"{k}.so")
        subprocess.run([*compiler(), "-shared", "-Wl,-Bsymbolic", str(made), "-lm", "-o",
                        str(found[-1])], check=True)  # fmt: skip
    return found


def judge(source: str, chosen: Sequence[Mutant]) -> list[str]:
    """Outcomes of mutants of one source, by its tests."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        made = libraries(source, chosen, folder)
        listed, results = folder / "mutants.json", folder / "results"
        listed.write_text(json.dumps([str(at) for at in made if at is not None]))
        command = [sys.executable, "-m", "tests.mutation.forked", str(listed), str(results),
                   *dict.fromkeys((*TESTS[source], GOLDEN))]  # fmt: skip
        done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=False)
        told = iter(results.read_text().splitlines() if results.exists() else ())
        try:
            by = ["none" if at is None else json.loads(next(told)) for at in made]
        except StopIteration:
            sys.exit(f"{source}: {done.stdout}{done.stderr}")
    return [each if each == "none" else "killed" if each else "survived" for each in by]


def digest(source: str) -> str:
    """Of what the outcomes of a source depend on: its code, its own header, and how it is built.

    Comments are no code, but their lines count: mutants are kept by line.
    """
    header = (ROOT / source).with_suffix(".h")
    total = hashlib.sha256(" ".join(FLAGS).encode())
    for path in (ROOT / source, header):
        text = path.read_text(encoding="utf-8") if path.exists() else ""
        code = COMMENT.sub(lambda comment: "\n" * comment[0].count("\n"), text)
        total.update("\n".join(line.rstrip() for line in code.split("\n")).encode())
    return total.hexdigest()


def main() -> int:
    """Judge the mutants of some sources and keep it, or some of the kept ones."""
    parser = argparse.ArgumentParser(prog="python -m tests.mutation.core", description=__doc__)
    parser.add_argument("source", nargs="*", help="sources; default: all that are stale")
    parser.add_argument("--sample", type=int)
    parser.add_argument("--seed", type=int, default=1)
    options = parser.parse_args()
    kept = _kept()
    if options.sample:
        killed = [Mutant(*row[:4]) for row in kept["mutants"] if row[4] == "killed"]
        chosen = random.Random(options.seed).sample(killed, options.sample)
        return int(any(row[4] != "killed" for row in _judged(chosen)))
    for source in options.source or [s for s in TESTS if kept["digests"].get(s) != digest(s)]:
        _keep(source, _judged(sample(source)))
    return 0


def _judged(chosen: Sequence[Mutant]) -> list[list[Any]]:
    """Mutants with their outcomes; survivors are printed."""
    rows: list[list[Any]] = []
    for source in dict.fromkeys(mutant.source for mutant in chosen):
        began = time.monotonic()
        own = [mutant for mutant in chosen if mutant.source == source]
        new = [[*m, outcome] for m, outcome in zip(own, judge(source, own), strict=True)]
        counts = Counter(row[4] for row in new)
        real = counts["killed"] + counts["survived"]
        print(
            f"{source}: {len(own)} of {len(mutants(source))} mutants in"
            f" {time.monotonic() - began:.0f} s, {counts['none']} are none, {counts['killed']} of"
            f" {real} killed ({100.0 * counts['killed'] / max(real, 1):.1f} %)"
        )
        for row in new:
            if row[4] == "survived":
                print(f"  {row[1]}: {row[2]}  ->  {row[3]}")
        sys.stdout.flush()
        rows += new
    return rows


def _keep(source: str, new: list[list[Any]]) -> None:
    kept = _kept()
    rows = kept["mutants"]
    # Why a survivor may survive is written by hand, and stays where its line has moved.
    reasons = {(row[0], row[2], row[3]): row[5] for row in rows if len(row) > 5}
    for row in new:
        if row[4] == "survived" and (row[0], row[2], row[3]) in reasons:
            row.append(reasons[row[0], row[2], row[3]])
    digests = {**kept["digests"], source: digest(source)}
    everything = sorted([row for row in rows if row[0] != source] + new)
    text = ",\n".join(json.dumps(row) for row in everything)
    # Written beside and put in its place: a judge that is stopped leaves a whole file.
    beside = KEPT.with_suffix(".new")
    beside.write_text(
        f'{{"digests": {json.dumps(digests, sort_keys=True)},\n"mutants": [\n{text}\n]}}\n'
    )
    beside.replace(KEPT)


def _kept() -> dict[str, Any]:
    empty: dict[str, Any] = {"digests": {}, "mutants": []}
    return json.loads(KEPT.read_text()) if KEPT.exists() else empty


if __name__ == "__main__":
    sys.exit(main())
