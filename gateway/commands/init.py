"""`init`: write a first configuration from the names in a DBC and, if given, a recording."""

from __future__ import annotations

import argparse
import os
import re
import shlex
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Final

from gateway.commands.common import BAD_INPUT, add_line, pattern_of, shown
from gateway.io.console import note
from gateway.settings.config import ConfigError

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from dbc.spec import MessageSpec
    from gateway.mapping import guess
    from gateway.mapping.bus_fit import Cycle
    from gateway.mapping.first_config import Shared

MOST_DRIVES: Final = 16
FRAMES: Final = 200_000
"""Number of frames of a log that are read."""


def arguments(parser: argparse.ArgumentParser) -> None:
    """Options of the verb."""
    parser.description = (
        "Write a first configuration with comments. From a third-party DBC, signals are chosen\n"
        "by name and unit; uncertain ones are only put into comments. Then `check` runs, and\n"
        "gives the exit code. On a terminal, missing options are asked for; otherwise they are\n"
        "guessed."
    )
    parser.add_argument("--drives", type=int, metavar="N", help=f"1 to {MOST_DRIVES} (default: 1)")
    parser.add_argument("--dbc", type=Path, metavar="FILE",
                        help="DBC of the inverters (default: our own message set)")  # fmt: skip
    parser.add_argument("--log", type=Path, metavar="FILE",
                        help="recording of that bus, for cycle times and identifiers")  # fmt: skip
    add_line(parser)
    parser.add_argument("--log-channel", metavar="NAME", help="channel, if the log has several")
    parser.add_argument("--id-offset", type=_whole_number, metavar="N", default=0,
                        help="offset of the first drive's identifiers from the DBC's")  # fmt: skip
    parser.add_argument("--id-step", type=_whole_number, metavar="N",
                        help="offset from one drive's identifiers to the next's")  # fmt: skip
    parser.add_argument("-o", "--output", type=Path, default=Path("train.toml"), metavar="FILE",
                        help="new file for the configuration (default: train.toml)")  # fmt: skip


def _whole_number(text: str) -> int:
    """Parse a whole number, such as 32 or 0x20. Raises ArgumentTypeError for anything else."""
    try:
        return int(text, 0)
    except ValueError:
        msg = f"{text!r} is not a whole number, such as 32 or 0x20"
        raise argparse.ArgumentTypeError(msg) from None


def run(options: argparse.Namespace) -> int:
    """Write and check the configuration. Raises ConfigError, DbcMismatch, LogError, OSError."""
    from gateway.io.log_file import require_file
    from gateway.io.whole_file import refuse_unwritable, write_text
    from gateway.mapping import first_config

    if options.log:
        require_file(options.log)
    if options.output.exists():
        raise ConfigError(f"{options.output}: already exists", ["name another file with -o"])
    refuse_unwritable(options.output)
    dbc = _asked_dbc() if options.dbc is None else options.dbc
    drives = _asked_drives() if options.drives is None else options.drives
    if not 1 <= drives <= MOST_DRIVES:
        raise ConfigError("--drives", [f"{drives}: expected 1 to {MOST_DRIVES}"])
    text = _of_dbc(dbc, drives, options) if dbc else first_config.ours(drives, "")
    write_text(options.output, text)
    print(f"written: {shown(options.output)}")
    log = ["--log", str(options.log)] if options.log else []
    log += ["--line", options.line] if options.log and options.line is not None else []
    if options.log and options.log_channel is not None:
        log += ["--log-channel", options.log_channel]
    return _check(options.output, log)


def _of_dbc(dbc: Path, drives: int, options: argparse.Namespace) -> str:
    from dbc.tolerant import read_any_dbc
    from gateway.mapping import first_config, guess

    specs, left_out = read_any_dbc(dbc)
    if left_out:
        note(f"{dbc.name}: {len(left_out)} entries cannot be used; `convert` lists them")
    named = Path(os.path.relpath(dbc, options.output.parent)).as_posix()
    if guess.of_this_project(specs):
        return first_config.ours(drives, named)
    of_log = _cycles_of_log(options) if options.log else {}
    # Subtract the first drive's offset, so that identifiers are those of the DBC.
    of_log = {key - options.id_offset: one for key, one in of_log.items()}
    there = [spec for spec in specs if spec.key in of_log] if of_log else list(specs)
    found = guess.candidates(there)
    chosen = guess.chosen(found)
    if not any(one.sure for one in chosen):
        where = f" that are in {options.log}" if of_log else ""
        raise ConfigError(
            str(dbc),
            [f"no signal{where} has the name and the unit of one that the gateway uses; write "
             "[inverter.NAME.use] by hand, docs/inverters.md lists what can be mapped"],
        )  # fmt: skip
    shared = _shared(named, specs, of_log, chosen, drives, options.id_step)
    shared = shared._replace(found=found, offset=options.id_offset)
    _say(shared, drives)
    return first_config.mapped(drives, shared)


def _shared(
    dbc: str, specs: Sequence[MessageSpec], of_log: Mapping[int, Cycle],
    chosen: Sequence[guess.Guess], drives: int, id_step: int | None,
) -> Shared:  # fmt: skip
    from dbc.frame import MS
    from gateway.mapping import first_config, guess
    from gateway.mapping.bus_fit import disagrees

    sure = [g.message for g in chosen if g.sure]
    used = {spec.key: guess.layout(spec) for spec in sure}
    step, source = id_step, "as --id-step says"
    if step is None:
        step, source = (
            guess.step(used, {s.key: guess.layout(s) for s in specs}, drives),
            "as in the file",
        )
    if step is None and len(used) > 1:  # one identifier may be anybody's
        step = guess.step(dict.fromkeys(used), dict.fromkeys(of_log), drives)
        source = "as in the log"
    if step is None:
        step, source = _free_step(set(used), drives), ""
    measured = {spec.name: of_log[spec.key] for spec in specs if spec.key in of_log}
    cycles = {}
    for spec in specs:
        ms = measured[spec.name].ms if spec.name in measured else None
        if not spec.cycle_ns or (ms is not None and disagrees(ms, spec.cycle_ns / MS)):
            cycles[spec.name] = ms
    name = re.sub(r"\W+", "_", Path(dbc).stem).strip("_").lower() or "inverter"
    return first_config.Shared(name, dbc, chosen, {}, cycles, measured, 0, step, source)


def _free_step(used: set[int], drives: int) -> int:
    """The smallest step with which no two drives share an identifier."""
    step = 1
    while any(i + step * k in used for i in used for k in range(1, drives)):
        step += 1
    return step


def _say(shared: Shared, drives: int) -> None:
    from gateway.mapping import first_config

    for guess in shared.chosen:
        verb = "is" if guess.sure else "may be"
        print(f"{guess.quantity:<16} {verb} {guess.name}")
    if drives > 1 and not shared.source:
        note(
            f"identifiers of the next drive are guessed, {shared.step:#x} higher: give --id-step, "
            "or correct id_offset"
        )
    guessed = first_config.guessed(shared)
    for name in guessed:
        if name in shared.measured:
            note(f"no cycle time of {name} from the log: {shared.measured[name].problem}")
    if guessed:
        cure = "correct cycle_ms" if shared.measured else "give --log, or correct cycle_ms"
        note(f"the DBC has no cycle time of {', '.join(guessed)}; it is guessed: {cure}")


def _cycles_of_log(options: argparse.Namespace) -> dict[int, Cycle]:
    """Cycle time of every identifier that comes often enough in a log's first frames.

    Raises ConfigError if no identifier comes often enough, BadLogError for another channel.
    """
    import numpy as np

    from gateway.io.log_file import OneChannel, open_log
    from gateway.mapping import bus_fit

    log = options.log
    parts, count = [], 0
    read = open_log(log, strict=False, line=pattern_of(log, options.line))
    for block in OneChannel(read.blocks, options.log_channel):
        parts.append((bus_fit.keys(block), block.t_ns))
        count += block.size
        if count >= FRAMES:
            break
    keys, times = (
        (np.concatenate(column) for column in zip(*parts, strict=True)) if parts else ((), ())
    )
    found = {key: bus_fit.cycle(times[keys == key]) for key in np.unique(keys).tolist()}
    often = {key: one for key, one in found.items() if one.frames > bus_fit.LEAST_STEPS}
    if not often:
        problem = "no message occurs often enough to measure its cycle time: give a longer log"
        raise ConfigError(str(log), [problem])
    return often


def _asked_drives() -> int:
    if not sys.stdin.isatty():
        return 1
    answer = _answer("number of drives [1]: ") or "1"
    return int(answer) if answer.isdecimal() else 0


def _asked_dbc() -> Path | None:
    if not sys.stdin.isatty():
        return None
    answer = _answer("DBC of the inverters [this project's message set]: ")
    return Path(answer).expanduser() if answer else None


def _answer(question: str) -> str:
    """What the user types. Raises ConfigError at the end of the input (Ctrl-D)."""
    try:
        return input(question).strip()
    except EOFError:
        raise ConfigError("init", ["no answer; give --drives and --dbc"]) from None


def _check(path: Path, more: Sequence[str]) -> int:
    """Run `check PATH --no-timing`; the file stays even if the check finds it wrong."""
    from gateway.commands import check

    parser = argparse.ArgumentParser()
    check.arguments(parser)
    check.more_arguments(parser)
    again = f"run `{shlex.join(['traction-gateway', 'check', str(path), *more])}`"
    try:
        problems = check.examine(parser.parse_args([str(path), "--no-timing", *more]))
    except ConfigError as error:
        for problem in error.problems:
            note(problem)
        note(f"{shown(path)} has errors: correct it, and {again}")
        return BAD_INPUT
    if problems.unfit or problems.too_much_load:
        note(f"{shown(path)} can be read; correct what does not fit, and {again}")
    elif problems.blind:
        note(f"{shown(path)} is right as far as it goes: map more signals for an adhesion flag, "
             "if this inverter sends them")  # fmt: skip
    elif problems.unfound:
        note(f"{shown(path)} can be read: put in the motor's data, and {again}")
    return problems.code
