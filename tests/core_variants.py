"""The compiled core built in another way, and tests that run on it.

    python -m tests.core_variants build sanitize | coverage | libfuzzer
    python -m tests.core_variants sanitize | coverage | unfit [pytest arguments]

`sanitize`: AddressSanitizer and UndefinedBehaviorSanitizer; the first finding ends the run.
`unfit`: the tests that cannot run so, on the core as it is delivered.
`coverage`: fails unless the core's own tests run every line and branch of it (gcov). Both need gcc
and use the core that `build` has left; without one they build it.
`tests.fuzzing` has a third one built: libFuzzer's instruments and the same sanitizers, by the clang
in ziglang.
"""

import json
import os
import shutil
import subprocess
import sys
from pathlib import Path

from core_build import HEADERS, SOURCES

OUT = Path("out/core").absolute()
OWN = ("tests/unit/test_e2e.py", "tests/unit/test_e2e_reference.py", "tests/unit/test_records.py",
       "tests/unit/test_codec_reference.py",
       "tests/unit/test_flags.py",
       "tests/unit/test_flags_reference.py",
       "tests/unit/test_variational_reference.py",
       "tests/unit/test_response_reference.py",
       "tests/unit/test_detect_learning.py",
       "tests/unit/test_elementary.py",
       "tests/unit/test_maisd.py", "tests/unit/test_order_statistics.py",
       "tests/unit/test_sigma_mixed.py",
       "tests/unit/test_thermal_paper.py",
       "tests/unit/test_thermal_reference.py",
       "tests/unit/test_thermal_imm.py",
       "tests/unit/test_residuals_reference.py",
       "tests/unit/test_thermal_monitor_odd.py",
       "tests/unit/test_thermal_step_detector.py",
       "tests/unit/test_thermal_model.py",
       "tests/unit/test_thermal_coverage.py", "tests/unit/test_thermal_cut_out.py",
       "tests/unit/test_trigonometry.py",
       "tests/unit/test_est_acquisition.py",
       "tests/unit/test_est_adaptation.py",
       "tests/unit/test_est_current_calibration.py",
       "tests/unit/test_train_reference.py::test_any_course_of_a_train[0-16-800-0.5]",
       "tests/unit/test_train_reference.py::"
       "test_drives_that_are_off_keep_their_flags_until_their_speed_is_constant",
       "tests/unit/test_creep.py",
       "tests/unit/test_slip_bench.py::test_no_wheel_locks_or_slides_as_adhering_where_all_slide_at_once",
       "tests/unit/test_adhesion_reference.py", "tests/unit/test_switching.py",
       "tests/unit/test_drivers_batch.py",
       "tests/unit/test_estimate_reference.py",
       "tests/unit/test_temperature.py",
       "tests/unit/test_est_filter.py",
       "tests/unit/test_receive_reference.py", "tests/unit/test_left_out_samples.py",
       "tests/unit/test_sample_clock.py", "tests/unit/test_outbox.py",
       "tests/unit/test_ticks.py", "tests/unit/test_tick_log.py", "tests/golden/test_golden.py",
       "tests/unit/test_thermal_trend.py",
       "tests/unit/test_temperature_monitor.py", "tests/unit/test_temperature_reader.py",
       "tests/unit/test_thermal.py", "tests/unit/test_bad_from_power_up.py",
       "tests/unit/test_heatside.py::test_a_sensor_that_crept_and_is_mended_has_no_offset",
       "tests/unit/test_maisd_spikes.py",
       "tests/unit/test_dbc_candump.py", "tests/property/test_dbc_candump_property.py",
       "tests/unit/test_text_read.py", "tests/unit/test_one_signal.py",
       "tests/unit/test_sim_plant.py", "tests/unit/test_sim_adhesion.py",
       "tests/unit/test_sim_thermal.py",
       "tests/unit/test_inputs.py",
       "tests/unit/test_est_load_observer.py",
       "tests/unit/test_motion.py",
       "tests/unit/test_motion_reference.py",
       "tests/unit/test_integrity.py",
       "tests/unit/test_detect_paper.py",
       "tests/unit/test_thermal_rivals.py",
       "tests/fuzzing/test_fuzzing.py::test_every_target_holds[tick]")  # fmt: skip
"""Tests that answer for the core: together they run every line and branch of it."""
REPEATS = tuple(f"tests/unit/test_{name}" for name in (
    "creep.py::test_anything_is_as_the_reference_has_it[7]",
    "creep.py::test_anything_is_as_the_reference_has_it[16]",
    "est_acquisition.py::test_reversal_through_zero",
    "est_filter.py::test_a_bad_number_stops_its_drive_only",
    "est_filter.py::test_it_equals_the_reference",
    "flags_reference.py::test_flags_of_drives_go_as_single_ones",
    "maisd_spikes.py::test_a_code_that_comes_again_and_again_makes_no_motor_hot",
    "maisd_spikes.py::test_a_loose_contact_makes_no_motor_hot",
    "sample_clock.py::test_it_equals_the_reference",
    "thermal_cut_out.py::test_a_calibration_with_it_judges_the_driven_motor_as_one_without",
    "thermal_cut_out.py::test_it_is_not_judged_until_some_blocks_after_it_is_driven_again",
    "thermal_monitor_odd.py::test_20_000_hostile_blocks_leave_probabilities_and_covariances",
    "ticks.py::test_other_storms_and_few_ticks_at_a_time",
))  # fmt: skip
"""Of them those that take seconds and run nothing that others do not: `make test` has them."""
HOSTILE = ("tests/unit/test_receive_reference.py", "tests/unit/test_left_out_samples.py",
           "tests/unit/test_codec_reference.py", "tests/unit/test_drivers_batch.py",
           "tests/property/test_dbc_candump_property.py",
           "tests/unit/test_text_read.py", "tests/unit/test_one_signal.py",
           "tests/unit/test_thermal_monitor_odd.py", "tests/unit/test_outbox.py",
           "tests/unit/test_tick_log.py",
           "tests/golden/test_golden.py",
           "tests/fuzzing/test_fuzzing.py::test_every_target_holds[tick]")  # fmt: skip
"""Of them those that give the core any numbers, and whole logs: for the sanitizers in CI. All tests
run under them in `make test-all`."""
UNFIT = (
    "tests/mutation", "tests/web", "tests/unit/test_ablation.py",
    "tests/unit/test_help_examples.py::test_they_run",
    "tests/unit/test_drivers_scheduling.py::"
    "test_what_was_given_from_outside_is_used_and_not_asked_for",
    "tests/unit/test_drivers_service.py::test_the_locked_memory_is_bounded",
)  # fmt: skip
"""Tests that cannot run under AddressSanitizer, and do not need it: mutants build cores of their
own, the browser and user-mode-linux end with the library preloaded, and a program with it locks no
memory."""
SANITIZERS = "-fsanitize=address,undefined -fno-sanitize-recover=all -fno-omit-frame-pointer"
FLAGS = {
    "sanitize": f"-g {SANITIZERS}", "coverage": "-O0 --coverage",
    "libfuzzer": "-O1 -g -fno-omit-frame-pointer -fno-sanitize-recover=all -fsanitize=address"
    " -fsanitize=undefined -fsanitize=fuzzer-no-link",
}  # fmt: skip
"""Of several names behind one `-fsanitize=` zig takes some, and leaves out AddressSanitizer."""


def build(name):
    """A folder with the core in this variant."""
    if shutil.which("gcc") is None:
        sys.exit(f"core variants: {name} needs gcc (Debian: apt-get install gcc)")
    place = OUT / name
    shutil.rmtree(place, ignore_errors=True)
    command = [sys.executable, "setup.py", "-q", "build_ext", "--force", f"--build-lib={place}",
               f"--build-temp={place / 'objects'}"]  # fmt: skip
    environment = {"CC": "gcc", "LDSHARED": f"gcc -shared {FLAGS[name]}", "CORE_FLAGS": FLAGS[name]}
    if name == "libfuzzer":
        # What it calls comes with the library that atheris brings along.
        clang = f"{sys.executable} -m ziglang cc {FLAGS[name]}"
        environment = {"CC": clang, "LDSHARED": "gcc -shared", "CFLAGS": ""}
    subprocess.run(command, env={**os.environ, **environment}, check=True)
    # Imported before Python looks into the checkout, where the core lies as it is delivered.
    (place / "sitecustomize.py").write_text("import _traction_core  # noqa: F401\n")
    return place


def built(name):
    """The folder that `build` has left, or a new one if it is older than a source."""
    made = OUT / name / "sitecustomize.py"
    newest = max(Path(one).stat().st_mtime for one in (*SOURCES, *HEADERS))
    return made.parent if made.exists() and made.stat().st_mtime > newest else build(name)


def run(place, tests, **environment):
    """Exit status of pytest on the core in this folder."""
    paths = os.pathsep.join([str(place), str(Path.cwd())])
    command = [sys.executable, "-m", "pytest", "-p", "no:cacheprovider", *tests]
    return subprocess.run(
        command, env={**os.environ, "PYTHONPATH": paths, **environment}, check=False
    ).returncode


def sanitize(arguments):
    """Run tests; the hostile ones if none are named."""
    place = built("sanitize")
    # That of C++ too: without it AddressSanitizer ends a program that throws, as FreeType's does.
    libraries = [
        subprocess.run(
            ["gcc", f"-print-file-name={name}"], capture_output=True, text=True, check=True
        ).stdout.strip()
        for name in ("libasan.so", "libstdc++.so.6")
    ]
    # Python itself frees nothing at its end.
    named = any(one.startswith("tests") for one in arguments)
    left_out = [f"--deselect={one}" for one in UNFIT]
    return run(place, [*left_out, *arguments] if named else [*HOSTILE, *arguments],
               LD_PRELOAD=" ".join(libraries),
               ASAN_OPTIONS="detect_leaks=0", UBSAN_OPTIONS="print_stacktrace=1")  # fmt: skip


def unreached(place, source):
    """Lines of code in a source, and the lines and branches of it that nothing has run."""
    data = place / "objects" / Path(source).with_suffix(".gcda")
    if not data.exists():
        return 0, [f"{source}: not run at all"]
    told = subprocess.run(
        ["gcov", "--json-format", "--branch-probabilities", "--stdout", str(data)],
        capture_output=True, text=True, check=True,
    ).stdout  # fmt: skip
    # A source that includes another and has no code of its own is none of them.
    lines = [line for f in json.loads(told)["files"] if f["file"] == source for line in f["lines"]]
    text = Path(source).read_text().splitlines()
    left = []
    for line in lines:
        at = f"{source}:{line['line_number']}"
        # A branch for another processor, and what it leads to, are not run on this one.
        if any("/* another processor */" in one for one in text[line["line_number"] - 2 :][:2]):
            continue
        if line["count"] == 0:
            left.append(f"{at}: never run")
        left += [
            f"{at}: branch {k} never taken"
            for k, branch in enumerate(line["branches"])
            if branch["count"] == 0
        ]
    return len(lines), left


def coverage(arguments):
    """0 if the core's own tests pass and run all of it."""
    place = built("coverage")
    for counts in place.rglob("*.gcda"):
        counts.unlink()
    code = run(place, [*OWN, *(f"--deselect={one}" for one in REPEATS), *arguments])
    bad = code != 0
    for source in SOURCES:
        lines, left = unreached(place, source)
        print(f"{source:24} {lines:5} lines, {len(left)} lines or branches not run")
        print("".join(f"  {one}\n" for one in left), end="")
        bad |= bool(left)
    return int(bad)


if __name__ == "__main__":
    what, *more = sys.argv[1:] or [""]
    if what == "sanitize":
        sys.exit(sanitize(more))
    if what == "coverage":
        sys.exit(coverage(more))
    if what == "unfit":
        sys.exit(
            subprocess.run([sys.executable, "-m", "pytest", *UNFIT, *more], check=False).returncode
        )
    if what == "build":
        build(*more)
        sys.exit(0)
    sys.exit(__doc__)
