"""`init`: write a first configuration from the names in a DBC and, if given, a recording."""

from __future__ import annotations

import argparse
import os
import re
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Final

from gateway.commands.common import BAD_INPUT, add_line, pattern_of, shown
from gateway.io.console import note

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from dbc.spec import MessageSpec
    from gateway.mapping import guess
    from gateway.mapping.first_config import Shared

MOST_DRIVES: Final = 16
FRAMES: Final = 200_000
"""Number of frames of a log that are read."""
GUESSED_MS: Final = 10.0
_LEAST_FRAMES: Final = 3
_EXTENDED: Final = 1 << 31


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
    """Parse a decimal number, or a hexadecimal one with 0x in front. Raises ValueError."""
    return int(text, 0)


def run(options: argparse.Namespace) -> int:
    """Write and check the configuration. Raises ConfigError, DbcMismatch, LogError, OSError."""
    from gateway.io.whole_file import write_text
    from gateway.mapping import first_config
    from gateway.settings.config import ConfigError

    if options.output.exists():
        raise ConfigError(f"{options.output}: already exists", ["name another file with -o"])
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
    from gateway.settings.config import ConfigError

    specs, left_out = read_any_dbc(dbc)
    if left_out:
        note(f"{dbc.name}: {len(left_out)} entries cannot be used; `convert` lists them")
    named = Path(os.path.relpath(dbc, options.output.parent)).as_posix()
    if guess.of_this_project(specs):
        return first_config.ours(drives, named)
    periods = _periods(options) if options.log else {}
    # Subtract the first drive's offset, so that identifiers are those of the DBC.
    periods = {key - options.id_offset: ms for key, ms in periods.items()}
    there = [spec for spec in specs if spec.key in periods] if periods else list(specs)
    found = guess.candidates(there)
    chosen = guess.chosen(found)
    if not any(map(first_config.is_sure, chosen)):
        where = f" that are in {options.log}" if periods else ""
        raise ConfigError(
            str(dbc),
            [f"no signal{where} has the name and the unit of one that the gateway uses; write "
             "[inverter.NAME.use] by hand, docs/inverters.md lists what can be mapped"],
        )  # fmt: skip
    shared = _shared(named, specs, periods, chosen, drives, options.id_step)
    shared = shared._replace(found=found, offset=options.id_offset)
    _say(shared, drives)
    return first_config.mapped(drives, shared)


def _shared(
    dbc: str, specs: Sequence[MessageSpec], periods: Mapping[int, float],
    chosen: Sequence[guess.Guess], drives: int, id_step: int | None,
) -> Shared:  # fmt: skip
    from gateway.mapping import first_config, guess

    sure = [g.message for g in chosen if first_config.is_sure(g)]
    used = {spec.key: guess.layout(spec) for spec in sure}
    step, source = id_step, "as --id-step says"
    if step is None:
        step, source = (
            guess.step(used, {s.key: guess.layout(s) for s in specs}, drives),
            "as in the file",
        )
    if step is None and len(used) > 1:  # one identifier may be anybody's
        step = guess.step(dict.fromkeys(used), dict.fromkeys(periods), drives)
        source = "as in the log"
    if step is None:
        step, source = _free_step(set(used), drives), ""
    cycles = {spec.name: periods.get(spec.key, GUESSED_MS) for spec in specs if not spec.cycle_ns}
    name = re.sub(r"\W+", "_", Path(dbc).stem).strip("_").lower() or "inverter"
    return first_config.Shared(name, dbc, chosen, {}, cycles, bool(periods), 0, step, source)


def _free_step(used: set[int], drives: int) -> int:
    """The smallest step with which no two drives share an identifier."""
    step = 1
    while any(i + step * k in used for i in used for k in range(1, drives)):
        step += 1
    return step


def _say(shared: Shared, drives: int) -> None:
    from gateway.mapping.first_config import is_sure

    for guess in shared.chosen:
        verb = "is" if is_sure(guess) else "may be"
        print(f"{guess.quantity:<16} {verb} {guess.name}")
    if drives > 1 and not shared.source:
        note(
            f"identifiers of the next drive are guessed, {shared.step:#x} higher: give --id-step, "
            "or correct id_offset"
        )
    if not shared.measured and any(
        g.message.name in shared.cycle_ms for g in shared.chosen if is_sure(g)
    ):
        note("the DBC has no cycle times; they are guessed: give --log, or correct cycle_ms")


def _periods(options: argparse.Namespace) -> dict[int, float]:
    """Median period in ms of every identifier in a log's first frames.

    Raises ConfigError if no identifier comes often enough, BadLogError for another channel.
    """
    import numpy as np

    from dbc.frame import EXTENDED
    from gateway.io.replay import OneChannel, open_log
    from gateway.settings.config import ConfigError

    log = options.log
    parts, seen = [], 0
    read = open_log(log, strict=False, line=pattern_of(log, options.line))
    for block in OneChannel(read.blocks, options.log_channel):
        keys = block.can_id.astype(np.int64)
        keys |= np.where(block.flags & EXTENDED, _EXTENDED, 0)
        parts.append((keys, block.t_ns))
        seen += block.size
        if seen >= FRAMES:
            break
    problem = "no message occurs often enough to measure its cycle time: give a longer log"
    none = ConfigError(str(log), [problem])
    if not parts:
        raise none
    keys, times = (np.concatenate(column) for column in zip(*parts, strict=True))
    out = {}
    for key in np.unique(keys).tolist():
        steps = np.diff(np.sort(times[keys == key]))
        if len(steps) >= _LEAST_FRAMES:
            ms = float(np.median(steps)) / 1e6
            out[key] = max(round(ms) if ms >= 2 else round(ms, 1), 0.1)
    if not out:
        raise none
    return out


def _asked_drives() -> int:
    if not sys.stdin.isatty():
        return 1
    answer = input("number of drives [1]: ").strip() or "1"
    return int(answer) if answer.isdecimal() else 0


def _asked_dbc() -> Path | None:
    if not sys.stdin.isatty():
        return None
    answer = input("DBC of the inverters [this project's message set]: ").strip()
    return Path(answer).expanduser() if answer else None


def _check(path: Path, more: Sequence[str]) -> int:
    """Run `check PATH --no-timing`; the file stays even if the check finds it wrong."""
    from gateway.commands import check
    from gateway.settings.config import ConfigError

    parser = argparse.ArgumentParser()
    check.arguments(parser)
    check.more_arguments(parser)
    try:
        code = check.run(parser.parse_args([str(path), "--no-timing", *more]))
    except ConfigError as error:
        for problem in error.problems:
            note(problem)
        code = BAD_INPUT
    if code:
        note(f"{shown(path)} has errors: correct it, and run `traction-gateway check {path}`")
    return code
