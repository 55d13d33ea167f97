"""What several verbs share: options, progress, exit codes."""

from __future__ import annotations

import argparse
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Final

from dbc.candump.grammar import Verdict
from dbc.text import number_or_nan, printable
from gateway.io.console import console, note
from gateway.settings.config import ConfigError

if TYPE_CHECKING:
    from dbc.candump.reader import LogReader
    from dbc.codec import Codec

GOOD, FAILED, BAD_INPUT, INCONCLUSIVE = 0, 1, 2, 3
"""Exit codes of the contract."""
PROBLEMS_SHOWN: Final = 5
"""Most faults of one log that are printed."""
ENTRIES_SHOWN: Final = 50
"""Most entries of a DBC that are printed."""


def positive_seconds(text: str) -> float:
    """Parse a duration in seconds. Raises ArgumentTypeError unless positive and below 1e7."""
    seconds = number_or_nan(text)
    if not 0.0 < seconds < 1e7:
        raise argparse.ArgumentTypeError(f"{text!r} is not a duration in seconds")
    return seconds


def number_of_jobs(text: str) -> int:
    """Parse a number of processes. Raises ArgumentTypeError unless it is 1 to 256."""
    if not text.isdecimal() or not 1 <= int(text) <= 256:
        raise argparse.ArgumentTypeError(f"{text!r} is not a number of processes")
    return int(text)


def refuse_overwriting(options: argparse.Namespace) -> None:
    """Raise ConfigError if a file that the verb writes is also one that it reads or writes."""
    values = vars(options)
    for key in ("output", "junit", "truth"):
        if not values.get(key):
            continue
        path = Path(values[key])
        for other, value in values.items():
            for item in value if isinstance(value, list) else [value]:
                if other not in (key, "verb") and _same_file(path, item):
                    cure = f"is the file of `{other}` too; name another one for `{key}`"
                    raise ConfigError(str(path), [cure])


def _same_file(path: Path, other: object) -> bool:
    """Whether both are one file; text that names no file may be a file's name by chance."""
    if not path.exists():
        return path == other
    return (
        isinstance(other, str | Path)
        and path.is_file()
        and Path(other).exists()
        and path.samefile(other)
    )


def add_duration(parser: argparse.ArgumentParser) -> None:
    """Add `--duration` of a scenario."""
    parser.add_argument("--duration", type=positive_seconds, metavar="S",
                        help="duration in s (default: the scenario's)")  # fmt: skip


def add_config(parser: argparse.ArgumentParser) -> None:
    """Add `--config`."""
    parser.add_argument(
        "--config", type=Path, metavar="TRAIN.toml",
        help="configuration; without it: three drives on nodes 1-3 with the bench motor",
    )  # fmt: skip


def add_signature(parser: argparse.ArgumentParser, *, required: bool = False) -> None:
    """Add `--public-key` and `--signature`."""
    parser.add_argument(
        "--public-key", type=Path, metavar="PUBLIC.pem", required=required,
        help="refuse a configuration that is not signed with this ed25519 key",
    )  # fmt: skip
    parser.add_argument(
        "--signature", type=Path, metavar="FILE.sig",
        help="signature (default: the configuration's path plus .sig)",
    )  # fmt: skip


def add_bus(parser: argparse.ArgumentParser) -> None:
    """Add python-can's own bus options: -i, -c, -b, --fd, --data-bitrate, --bus-kwargs .."""
    from gateway.io import quick_start

    quick_start.python_can()
    import can.cli

    can.cli.add_bus_arguments(parser)


def names_bus(options: argparse.Namespace) -> bool:
    """Whether the options of `add_bus` name a bus."""
    return hasattr(options, "interface") or hasattr(options, "channel")


def add_line(parser: argparse.ArgumentParser) -> None:
    """Add `--line`."""
    parser.add_argument(
        "--line", metavar="PATTERN",
        help="pattern of a line of the log, such as '{ms:x} {id:x} {data}'; 'auto' proposes one",
    )  # fmt: skip


def pattern_of(log: Path, line: str | None) -> str:
    """The pattern that `--line` names, "" without it; for `auto`, print and return the proposal.

    Raises ConfigError if the pattern is wrong or empty, or if no proposal fits.
    """
    if line is None:
        return ""
    from dbc.logs.opening import first_lines
    from dbc.logs.pattern import Pattern, PatternError
    from dbc.logs.proposals import proposed
    from dbc.logs.screen import is_screen_form

    if line != "auto":
        try:
            return Pattern(line).pattern
        except PatternError as error:
            cure = "docs/files.md has the fields, and examples"
            raise ConfigError("--line", [str(error), cure]) from None
    lines = [text.decode("latin-1") for text in first_lines(log)] if log.is_file() else []
    found = proposed(lines)
    if found is None:
        shown_line = printable(lines[0][:80]) if lines else "(nothing that is text)"
        cure = "write one: docs/files.md has the fields, and examples"
        if any(map(is_screen_form, lines)):
            cure = "its lines have no times: record with `candump -L IF`"
        raise ConfigError(
            f"{log}: no pattern fits its first lines", [f"the first one: {shown_line}", cure]
        )
    total = found.good + found.bad
    print(f"--line '{found.pattern}': fits {found.good} of {total} lines examined")
    if found.assumed:
        print(f"assumed: {found.assumed}; if that is wrong, correct the pattern")
    return found.pattern


def faults(reader: LogReader) -> dict[str, int]:
    """Number of faulty lines or objects of a log, by cause."""
    return {verdict.name.lower(): n for verdict, n in reader.counts.items() if verdict.is_fault}


def report_dbc(codec: Codec) -> None:
    """Print the entries of a DBC that are not used, on stderr."""
    if codec.left_out:
        count = len(codec.left_out)
        what = "entry is" if count == 1 else "entries are"
        head = f"{codec.path.name}: {count} {what} not used, or only in part:"
        console().print(head, markup=False, soft_wrap=True)
        for line in codec.left_out[:ENTRIES_SHOWN]:
            console().print(f"  {line}", markup=False, soft_wrap=True)
        if count > ENTRIES_SHOWN:
            console().print(f"  and {count - ENTRIES_SHOWN} more")


def report_log(reader: LogReader) -> None:
    """Print the counts of a log that was read, on stdout; first faults and notes on stderr."""
    counts = sorted((verdict.name.lower(), n) for verdict, n in reader.counts.items() if n)
    print(f"{reader.unit}: " + ", ".join(f"{name} {n}" for name, n in counts))
    one = reader.unit.removesuffix("s")
    for number, verdict, text in reader.problems[:PROBLEMS_SHOWN]:
        console().print(f"{one} {number}: {verdict.name.lower()}: {text}", markup=False)
    for text in reader.notes:
        console().print(f"note: {text}", markup=False, soft_wrap=True)
    if reader.counts[Verdict.CUT]:
        why = reader.truncated or "its last line is incomplete"
        text = f"warning: the log is cut: {why}; its last, incomplete frame is not used"
        console().print(text, markup=False, soft_wrap=True)


def verdict_of_input(dropped: Mapping[str, int], used: int) -> int:
    """Exit code for what was left out of a log; a warning on stderr if that is too much.

    dropped: number of lines or frames by cause; used: number of those that were not dropped.
    """
    from gateway.reports.dropped import warning

    text = warning(dropped, used)
    if text:
        note(f"warning: {text}")
    return FAILED if text else GOOD


def shown(path: Path) -> str:
    """Path as text for the terminal, with control characters escaped."""
    return printable(str(path))
