"""Show the most used verbs, all verbs, or the help of one verb or of one of its actions."""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    import argparse


EXAMPLE = """canopen-control help run
         canopen-control help bus status
         canopen-control help --all"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the options."""
    parser.add_argument("verb", nargs="?", metavar="VERB", help="show the help of this verb")
    parser.add_argument("action", nargs="*", metavar="ACTION", help="show the help of this action of the verb")
    parser.add_argument("--all", action="store_true", help="list every verb")


def run(args: argparse.Namespace) -> int:
    """Print the overview, or leave as `VERB --help` does."""
    from canopen_control.cli.main import main
    from canopen_control.cli.verbs import overview

    if args.verb is not None:
        return main([args.verb, *args.action, "--help"])
    print(overview(everything=args.all), end="")
    return 0
