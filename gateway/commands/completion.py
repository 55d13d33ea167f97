"""`completion SHELL`: print the script with which a shell completes verbs, options and files."""

from __future__ import annotations

import argparse
from collections.abc import Mapping
from pathlib import Path

from gateway.commands.common import GOOD
from gateway.io.extras import need

SHELLS = ("bash", "zsh", "tcsh")


def arguments(parser: argparse.ArgumentParser) -> None:
    """Options of the verb."""
    parser.add_argument("shell", choices=SHELLS)


def run(options: argparse.Namespace) -> int:
    """Print the script. It holds all names, so completing a word does not start the program."""
    need(("shtab",), "completion", "completion")
    import shtab

    parser = options.whole()
    _files(parser, shtab.FILE)
    print(shtab.complete(parser, shell=options.shell))
    return GOOD


def _files(parser: argparse.ArgumentParser, how: Mapping[str, object]) -> None:
    """Complete arguments that are or may be paths with the names of files."""
    for action in parser._actions:  # noqa: SLF001 - argparse has no other way to ask
        if isinstance(action, argparse._SubParsersAction):  # noqa: SLF001
            for verb in action.choices.values():
                _files(verb, how)
        elif action.type is Path or action.dest in ("scenario", "config"):
            action.complete = how  # type: ignore[attr-defined]
