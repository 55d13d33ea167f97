"""The command line: verbs only.

Exit codes: 0 good, 1 an expectation failed or more than 1 % of the input was dropped, 2 bad input,
3 inconclusive (a machine that could not keep up with a bus), 130, 143, 141 ended by Ctrl-C,
SIGTERM, a broken pipe.
"""

from __future__ import annotations

import argparse
import importlib
import logging
import re
import signal
import sys
import time
from collections.abc import Sequence
from itertools import pairwise
from typing import Any, NoReturn

BEGAN_S = time.monotonic()
"""Start of this program, monotonic: the time from it is measured."""
VERBS = {
    "demo": "run the whole system on an embedded bus: simulated drives, gateway, display, picture",
    "run": "run the gateway on a bus",
    "replay": "run the gateway over a recorded log, as fast as the machine can",
    "shrink": "make a small test from a long log: the fewest frames that give the same flag",
    "monitor": "show a bus or a log live: drives, flags, loads, bus, events",
    "convert": "convert a log to candump, ASC, BLF, TRC, or its signals to Parquet, MF4, MCAP, CSV",
    "sim": "simulate inverter ECUs: on a bus in real time, or into a candump log",
    "hil": "run scenarios against the gateway and check their expectations",
    "vcan": "run a command with real SocketCAN interfaces, on any Linux machine, without root",
    "init": "write a first configuration, from the names and units in a DBC",
    "check": "check a configuration before deployment: DBC, bus load, timing, detection",
    "explain": "explain a Reason, Health or FaultClass, and what to do about it",
    "dbc": "write the message set as a DBC file, classic or CAN FD",
    "examples": "write configurations, tests, CI and container files to start from",
    "keygen": "generate keys that sign configurations or authenticate flags",
    "sign": "sign a configuration, with its DBC and its calibration",
    "verify": "verify that a configuration is the one that was signed",
    "calibrate": "learn thermal limits from fault-free logs",
    "reproduce": "repeat a paper's experiment: its tables and figures beside ours, and a report",
    "warm": "do nothing: the core is compiled when the package is built",
    "fleet": "replay many logs, in many processes or on a Dask cluster, into Parquet",
    "fleet-thresholds": "derive thresholds from the results of a healthy fleet",
    "completion": "print a script that completes verbs and options in a shell",
    "evaluate": "run the benchmark of detectors: random runs by seed, every detector, one table",
}
"""Verb -> one line of help; each is the module of that name (`-` is `_`) in `gateway.commands`."""
_DRIVES = {"demo", "sim", "hil"}
"""Verbs that simulate drives and read no log: they need python-can, but not its MF4 part."""
_SERVICES = (["run"], ["monitor"])
"""Verbs that run until they are stopped: a signal is their normal end, with an exit code of their
own."""


_BRIEF = {
    "replay", "check", "convert", "explain", "dbc", "examples", "calibrate", "keygen", "sign",
    "verify",
}  # fmt: skip
"""Verbs that leave no thread or process running, so that the program may end at once."""


def _module(verb: str) -> Any:
    return importlib.import_module(f"gateway.commands.{verb.replace('-', '_')}")


class _Once(argparse.Action):
    """Action of an option with a value: a second value is an error and overrides nothing."""

    def __call__(
        self,
        parser: argparse.ArgumentParser,
        namespace: argparse.Namespace,
        values: Any,
        option_string: str | None = None,
    ) -> None:
        """Store the value, once."""
        given = vars(namespace).setdefault("_given", set())
        if option_string is not None and self.dest in given:
            parser.error(f"argument {option_string}: given twice; give it once")
        given.add(self.dest)
        setattr(namespace, self.dest, values)


class _Parser(argparse.ArgumentParser):
    """A parser whose errors name the verb, option or value that was probably meant."""

    def error(self, message: str) -> NoReturn:
        """Print usage and message, exit with 2."""
        from dbc.text import near

        parsers = [self]
        for action in self._actions:
            if isinstance(action, argparse._SubParsersAction):  # noqa: SLF001 - no other way
                parsers += action.choices.values()
        if wrong := re.search(r"invalid choice: '(.*?)' \(choose from (.*)\)", message):
            message += near(wrong[1], re.findall(r"[\w-]+", wrong[2]))
        elif message.startswith("unrecognized arguments: -"):
            options = (name for one in parsers for name in one._option_string_actions)  # noqa: SLF001
            message += near(message.split()[2].partition("=")[0], options)
        super().error(message)


def _parser(words: Sequence[str], *, whole: bool = False) -> argparse.ArgumentParser:
    """Make the parser; only the verb in use is imported, so that `--help` stays quick.

    Verbs and options that the words cannot mean are left out, too; `whole` includes them all.
    """
    asked = words[:1] if words and words[0] in VERBS and not whole else VERBS
    plain = not whole and len(words) == 2 and not words[1].startswith("-")
    parser = _Parser(
        prog="traction-gateway",
        description="CAN-bus hardware-in-the-loop gateway for railway traction.",
    )
    parser.add_argument("--version", action="store_true", help="print the version and exit")
    verbs = parser.add_subparsers(dest="verb", metavar="VERB")
    for verb in asked:
        text = VERBS[verb]
        sub = verbs.add_parser(verb, help=text, description=text[0].upper() + text[1:] + ".")
        sub.register("action", None, _Once)
        sub.add_argument(
            "-v", "--verbose", action="count", default=0, help="more messages on stderr"
        )
        sub.add_argument("--log-format", choices=("text", "json"), default="text",
                         help="format of the log on stderr")  # fmt: skip
        if verb in words:
            from gateway.commands.help_examples import examples

            module = _module(verb)
            module.arguments(sub)
            sub.epilog = "\n\n".join(filter(None, (sub.epilog, examples(verb))))
            sub.formatter_class = argparse.RawDescriptionHelpFormatter
            if not plain and hasattr(module, "more_arguments"):
                module.more_arguments(sub)
    return parser


def main(argv: Sequence[str] | None = None) -> int:
    """Entry point; the user never gets a traceback from bad input or from a signal."""
    words = list(sys.argv[1:] if argv is None else argv)
    from gateway.io import endings

    with endings.raised() as note:
        try:
            code = _printed(words)
        except KeyboardInterrupt as error:
            # Stopped before it was ready. SIGTERM is how systemd stops a service at any time.
            ended = endings.ended_by(error)
            service = words[:1] in _SERVICES and ended.number == signal.SIGTERM
            code = 0 if service else ended.code
        except BrokenPipeError:
            code = endings.BROKEN_PIPE
        except Exception:
            if note.ended is None:
                raise
            code = note.ended.code  # it was turned into another error on the way
        if note.ended is not None and words[:1] not in _SERVICES:
            code = note.ended.code
        endings.silence()
    return code


def _printed(words: list[str]) -> int:
    """Run the command, then flush standard output: no output may be lost without an error."""
    from gateway.io import endings

    try:
        code = _run_command(words)
    except SystemExit:  # of argparse
        endings.flush()
        raise
    try:
        endings.flush()
    except BrokenPipeError:
        return code or endings.BROKEN_PIPE
    except OSError as error:
        sys.stderr.write(f"traction-gateway: standard output: {error}\n")
        return 2
    return code


def _run_command(words: list[str]) -> int:
    """Run the command. Lets signals, broken pipes and errors of this program through."""
    from gateway.io import quick_start

    with quick_start.unsearched():
        from dbc.text import printable
        from gateway.io import log_setup as logs

        if _DRIVES.intersection(words[:1]):
            quick_start.python_can()
        quick_start.pydantic()
        if _BRIEF.intersection(words[:1]):
            quick_start.one_blas_thread()
        form = _log_format(words)
        limit = logs.begin(logging.WARNING, form)
        parser = _parser(words)
    options = parser.parse_args(words)
    if options.version:
        from importlib.metadata import version

        print(f"traction-gateway {version('traction-gateway')}")
        return 0
    if options.verb is None:
        parser.print_help()
        return 2
    levels = (logging.WARNING, logging.INFO, logging.DEBUG)
    logging.getLogger().setLevel(levels[min(options.verbose, 2)])
    if options.log_format != form:  # abbreviated option
        form = options.log_format
        logs.reshape(form)
    command = _module(options.verb)
    options.began_s = BEGAN_S
    options.whole = lambda: _parser(tuple(VERBS), whole=True)
    from gateway.commands.common import refuse_overwriting

    try:
        refuse_overwriting(options)
        return int(command.run(options))
    except BrokenPipeError:
        raise
    except Exception as error:
        if not _is_users(error):
            raise
        text = " ".join((_of_a_file(error) or str(error)).split())
        text = printable(text, len(text))  # it may quote names of files
        logs.say(text if form == "json" else f"traction-gateway: {text}", form)
        return 2
    finally:
        if unsaid := limit.suppressed():
            logs.say(f"{unsaid} lines of the log were suppressed", form, logging.WARNING)


def _log_format(words: Sequence[str]) -> str:
    """The format asked for, before there is a parser: making the parser may already log."""
    pairs = pairwise(words)
    asked = ("--log-format", "json") in pairs or "--log-format=json" in words
    return "json" if asked else "text"


def _of_a_file(error: Exception) -> str:
    """Message of an OSError about a file: its name, what is wrong, what to do; else empty."""
    if not isinstance(error, OSError) or not error.filename or not error.strerror:
        return ""
    known = {
        FileExistsError: "File exists; name another one",
        NotADirectoryError: "is not a folder; name another one",
        IsADirectoryError: "is a folder; name a file",
        FileNotFoundError: "no such file or folder",
    }
    return f"{error.filename}: {known.get(type(error), error.strerror)}"


def _is_users(error: Exception) -> bool:
    """True for an error in the input, False for one in this program."""
    from dbc.text import InputError

    return isinstance(error, InputError | OSError)


def program() -> NoReturn:
    """Run the command line as a program and exit."""
    code = main()
    if _BRIEF.intersection(sys.argv[1:2]):
        from gateway.io import endings

        endings.leave(code)
    sys.exit(code)


if __name__ == "__main__":
    program()
