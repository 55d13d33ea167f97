"""`python -m bench.ablation`: what each observation and each part of the detector is worth.

Each removal changes one line of the core, so that one part no longer acts. Every run is simulated
once per world and judged with each removal in turn. Writes docs/evaluation/ablation.md. On
development seeds, five minutes on one core. Nothing is tuned by it.
"""

from __future__ import annotations

import argparse
import multiprocessing
import tempfile
from collections.abc import Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from functools import partial
from pathlib import Path
from typing import Final, NamedTuple

from gateway.study.evaluation import Measured, pooled
from gateway.study.evaluation_runs import Plan, fitted, judge, recorded, seeds_of
from gateway.study.worlds import WORLDS
from tests.mutation.core import ROOT, Mutant, libraries
from tests.mutation.forked import become

PAGE: Final = ROOT / "docs" / "evaluation" / "ablation.md"
WORLDS_JUDGED: Final = ("ours", "held", "roller")
INPUTS: Final = "observations"
MODEL: Final = "switching model"
RULES: Final = "rules of the flag"
LOADS: Final = "gateway/core/loads.c"
ROTORS: Final = "gateway/core/rotors.c"
DRIVE: Final = "estimators/detect/switching_drive.c"
STEP: Final = "estimators/detect/switching.c"
NOISE: Final = "estimators/detect/switching_noise.c"
LOSS: Final = "gateway/core/switching_loss.c"

TEXT: Final = """\
# What each part of the detector is worth

`python -m bench.ablation --seeds {seeds}`: in each row one part of `switching` is removed, by a
change of one line of the core. All kinds of runs of a world are pooled, on development seeds.
Columns: F1; dangerous, the share of the lost time in which the flag is `Adhering` (%); false, the
share of the healthy time in which it is `AdhesionLost` (%); the share of the healthy time in which
it is `Adhering` (%).

A part whose row equals the first one has no effect in these runs.
[Below the table](#where-other-parts-act) are runs in which it has one.
"""
ELSEWHERE: Final = """\

## Where other parts act

Parts whose rows equal the first one, or nearly, were removed in other runs, too: in simulators of
other authors (`together`, `patch`, `n2_single`: all wheels, some, or one of two lose adhesion;
`cutout`, `lock12`: a drive is cut out, twelve wheels lock in braking; `start_bad`,
`start_bad_heavy`: a rail that is bad from the start, with heavy rotors; `fast_samples`: samples
each millisecond) and on [real wheels](../real_wheels.md). Changes are in percentage points, of the
runs named.
"""


class Removal(NamedTuple):
    """One part that is taken out: the line of `source` that starts with `line` is `without`.

    elsewhere: where it acts if not in these runs, as it was measured once.
    """

    name: str
    group: str
    source: str
    line: str
    without: str
    elsewhere: str = ""

    def mutant(self) -> Mutant:
        """The changed line. Raises ValueError unless the source has it exactly once."""
        lines = [line.strip() for line in (ROOT / self.source).read_text().splitlines()]
        at = [number for number, line in enumerate(lines, 1) if line.startswith(self.line)]
        if len(at) != 1:
            raise ValueError(f"{self.name}: {len(at)} lines of {self.source} start so: {self.line}")
        return Mutant(self.source, at[0], self.line, self.without)


REMOVALS: Final = (
    Removal("torque command", INPUTS, LOADS,
            "response->usable = a->rotor_inputs[k].command_valid && answers;",
            "response->usable = 0;"),
    Removal("commands of the drives relative to one another", INPUTS, LOADS,
            "mine->command_ratio = ratio;", ";",
            "`patch`, 4 runs: false 1.48 more, missed 3.0 more."),
    Removal("speeds of the wheels relative to one another", INPUTS, ROTORS,
            "if (t->rotor[k].motor != k)", "if (t->rotor[k].motor >= 0)"),
    Removal("torque that accelerates a rotor with its train", INPUTS, ROTORS,
            "r->acceleration_torque = clamp(own, -most, most);", "r->acceleration_torque = 0.0;"),
    Removal("deceleration by friction brakes", INPUTS, ROTORS, "if (slows)", "if (0)",
            "Acted in 1 of 50 runs, by 0.02. It stays: brakes and a loss of all wheels look "
            "alike ([what did not work](../what_did_not_work.md))."),
    Removal("sudden acceleration of a single rotor", INPUTS,
            "estimators/detect/command_response.c",
            "const double more = spins_up(drive, least) ? CONFIRMED_S : dt;",
            "const double more = dt;",
            "`together`, 4 runs: dangerous 1.75 more."),
    Removal("standard deviation of the estimated load", INPUTS, NOISE,
            "const double variance = larger(noise->variance, square(in->sigma));",
            "const double variance = noise->variance;"),
    Removal("lasting differences between drives", MODEL, DRIVE,
            "#define RATIO_SD ", "#define RATIO_SD 1e-4"),
    Removal("temporary differences between drives", MODEL, DRIVE,
            "#define CURVE_SD ", "#define CURVE_SD 1e-4",
            "`together` and `patch`, 4 runs each: false 2.0 and 1.3 more."),
    Removal("heavy tails of the noise", MODEL, DRIVE,
            "#define TAIL ", "#define TAIL 0.0",
            "`patch`, 4 runs: false 1.0 more."),
    Removal("variance of the noise is learnt", MODEL, NOISE, "learn_variance(s, i, g, e);", ";"),
    Removal("scatter of the noise is learnt", MODEL, NOISE,
            "learn_scatter(&s->noises[i], e);", ";"),
    Removal("noise after a change of the demand", MODEL, NOISE,
            "s->noises[i].lag = larger(LAG_KEPT * s->noises[i].lag, LAG * moved);", ";",
            "`patch`, 4 runs: false 0.9 more."),
    Removal("jumps of the demand", MODEL, STEP,
            "return propose_jumps(s, &walked, from, later, tried);", "return tried;"),
    Removal("wobbles and turns of the demand", MODEL, STEP,
            "for (int move = CALM; move < MOVES; move++) {",
            "for (int move = CALM; move < WOBBLE; move++) {"),
    Removal("drives that lose adhesion together", MODEL, STEP,
            "const double often = larger(EVENT * frequency(h.m), LEAST_P);",
            "const double often = LEAST_P;",
            "`n2_single` and `patch`, 4 runs each: dangerous 1.1 and 0.6 more, missed 6.3 "
            "and 4.4."),
    Removal("losses are rare at little load", MODEL, STEP, "return x * x * x;", "return 1.0;",
            "`together`, 8 runs: false 1.8 more. Robot, 4 recordings: `Adhering` 1.5 less."),
    Removal("more than one hypothesis", MODEL, "estimators/detect/switching_mixture.c",
            "if (s->kept >= SWITCHING_KEPT)", "if (s->kept >= 1)",
            "`n2_single` and `patch`, 4 runs each: dangerous 1.1 and 0.6 more."),
    Removal("restart after contradictions", MODEL, STEP, "if (s->contradicted >= ANEW_STEPS)",
            "if (0)",
            "Vehicle, first minute of 4 recordings: `Adhering` 0.5 less, but false 3.1 "
            "less, too. It stays: without it a loss that was there at the start is learnt "
            "(`test_switching.py`)."),
    Removal("loss of all drives at once", RULES, LOSS, "const double all = follow_common_loss(a);",
            "const double all = 0.0;"),
    Removal("drives that carry what they are asked for", RULES, LOSS,
            "if (!any && answers(a, k))", "if (0)",
            "Acted in 1 of 50 runs (`together`): false 0.14 more, unknown 0.9 more."),
    Removal("wheels that have just gripped", RULES, LOSS, "if (has_gripped(a, k, bad)) {",
            "if (0) {",
            "Vehicle, first minute of 4 recordings: false 3.7 more."),
    Removal("drives that are held back after a regrip", RULES, LOSS,
            "p = held_back(a, k, p, bad, uncertain);", ";",
            "`together` and `patch`, 4 runs each: false 0.9 and 0.4 more."),
    Removal("a train that rolls", RULES, LOSS,
            "if (asked ? rolls_along(a, k) : rolls(a, k)) {", "if (asked && rolls_along(a, k)) {"),
    Removal("a drive that is cut out and rolls along", RULES, LOSS,
            "if (asked ? rolls_along(a, k) : rolls(a, k)) {", "if (!asked && rolls(a, k)) {",
            "`cutout`, 12 runs: false 3.8 more, unknown 10.3 more."),
    Removal("a demand that no drive was asked for", RULES, LOSS,
            "in->answers = (uint8_t)(answers(a, k) || never_asked(a, k));",
            "in->answers = (uint8_t)answers(a, k);",
            "`lock12`, 12 runs: false 3.1 more, unknown 8.6 more."),
    Removal("a drive behind its command beside one that answers", RULES, LOSS,
            "const int seems_lost = mine->p_response >= UNDECIDED && another_answers(a, k);",
            "const int seems_lost = 0;",
            "`start_bad` and `start_bad_heavy`, 12 runs each: dangerous 0.8 and 2.2 more."),
    Removal("brakes do not explain an earlier deficit", RULES,
            "estimators/detect/command_response.c",
            "if (!(p > OPEN) || drive->deficit_s > 0.0)", "if (!(p > OPEN))",
            "`fast_samples`, 32 runs: dangerous 3.0 more."),
    Removal("commands that pass through zero", RULES, LOSS,
            "const int passing = is_asked(&a->responses[k]) && !mine->response_valid;",
            "const int passing = 0;",
            "Acted in 1 of 234 runs: a drive with 0.4 of the others' command was false for "
            "0.06 more."),
)  # fmt: skip


def _child(to: object, library: Path | None, work: partial[Measured]) -> None:
    if library is not None:
        become(library)
    to.send(work())  # type: ignore[attr-defined]


def without(library: Path | None, work: partial[Measured]) -> Measured:
    """Work in a process of its own, whose core is changed by a library."""
    fork = multiprocessing.get_context("fork")
    here, there = fork.Pipe(duplex=False)
    child = fork.Process(target=_child, args=(there, library, work))
    child.start()
    there.close()
    measured: Measured = here.recv()
    child.join()
    return measured


def one_run(changed: Sequence[Path | None], run: tuple[Plan, str, int]) -> list[Measured]:
    """One run, judged by the detector as it is and with each removal."""
    plan, family, seed = run
    recording = recorded(plan, family, seed)
    config, codec = fitted(plan, "switching", recording.scenario, recording.variation)
    work = partial(judge, recording, config, codec)
    return [without(library, work) for library in changed]


def judged(seeds: Sequence[int], jobs: int) -> dict[str, list[Measured]]:
    """World to the pooled measures of all its runs: the detector as it is, then each removal."""
    with tempfile.TemporaryDirectory() as name:
        changed: list[Path | None] = [None]
        for k, removal in enumerate(REMOVALS):
            (folder := Path(name) / str(k)).mkdir()
            changed += libraries(removal.source, [removal.mutant()], folder)
        found = {}
        for world in WORLDS_JUDGED:
            plan = Plan(WORLDS[world].usual, ("switching",), tuple(seeds), world=world)
            runs = [(plan, family, seed) for family in plan.families for seed in seeds]
            with ProcessPoolExecutor(jobs, multiprocessing.get_context("fork")) as pool:
                each = list(pool.map(partial(one_run, changed), runs))
            found[world] = [pooled(column) for column in zip(*each, strict=True)]
    return found


def cells(measured: Measured) -> list[str]:
    """F1, dangerous, false and `Adhering` share of one world."""
    flags = measured.flags
    shares = flags.dangerous_share, flags.false_share, flags.good_share
    return [f"{flags.f1:.3f}", *(f"{100.0 * share:.2f}" for share in shares)]


def page(found: dict[str, list[Measured]], seeds: str) -> Iterator[str]:
    yield TEXT.format(seeds=seeds)
    names = [f"{world}: {c}" for world in found for c in ("F1", "dangerous", "false", "adhering")]
    yield f"| without | {' | '.join(names)} |"
    yield "|---" * (len(names) + 1) + "|"
    for k, removal in enumerate((None, *REMOVALS)):
        row = [cell for world in found.values() for cell in cells(world[k])]
        if removal is not None and removal.group != (REMOVALS[k - 2].group if k > 1 else ""):
            yield f"| **{removal.group}** |{' |' * len(names)}"
        yield f"| {removal.name if removal else '(nothing)'} | {' | '.join(row)} |"
    yield ELSEWHERE
    yield from (f"- {each.name}: {each.elsewhere}" for each in REMOVALS if each.elsewhere)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seeds", default="0-1")
    parser.add_argument("-j", "--jobs", type=int, default=2)
    parser.add_argument("-o", "--output", type=Path, default=PAGE)
    options = parser.parse_args()
    lines = page(judged(seeds_of(options.seeds), options.jobs), options.seeds)
    options.output.write_text("\n".join(lines) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
