"""`explain CODE`: print what a code of a flag frame means, and what to do about it."""

from __future__ import annotations

import argparse

from dbc.text import near
from gateway.commands.common import GOOD
from gateway.settings.config import ConfigError


def arguments(parser: argparse.ArgumentParser) -> None:
    """Options of the verb."""
    parser.add_argument("code", nargs="*", help="number or name, such as 8 or TooFewDrives")


def run(options: argparse.Namespace) -> int:
    """Print the codes, or all if none is given. Raises ConfigError for an unknown code."""
    from gateway.reports import explanations

    if not options.code:
        print(explanations.text(explanations.ALL))
        return GOOD
    unknown = [word for word in options.code if not explanations.named(word)]
    if unknown:
        names, cure = (
            [one.name for one in explanations.ALL],
            "; `explain` without a code prints all",
        )
        raise ConfigError(
            "explain", [f"no code {word!r}{near(word, names) or cure}" for word in unknown]
        )
    print(explanations.text([one for word in options.code for one in explanations.named(word)]))
    return GOOD
