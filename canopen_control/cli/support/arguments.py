"""Argument types for argparse, such as numbers within bounds, and options shared by several verbs."""

from __future__ import annotations

import argparse
import math
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

from canopen_control.commissioning.quantity import number_that, seconds_above_0, whole_between
from canopen_control.data_files import data_path
from canopen_control.errors import ConfigError

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence


T = TypeVar("T")


def argument(read: Callable[[str], T]) -> Callable[[str], T]:
    """Return an argparse type that calls `read`, and turns its ConfigError or ValueError into a usage error."""

    def as_argument(text: str) -> T:
        try:
            return read(text)
        except (ConfigError, ValueError) as error:
            raise argparse.ArgumentTypeError(str(error)) from None

    return as_argument


def number(title: str, accept: Callable[[float], bool]) -> Callable[[str], float]:
    """Return an argparse type for numbers that `accept` accepts; `title` describes them in the error message."""
    return argument(number_that(accept, title))


def whole_number(title: str, numbers: range) -> Callable[[str], int]:
    """Return an argparse type for integers in `numbers`, decimal or 0x; `title` describes them in the error message."""
    return argument(whole_between(numbers.start, numbers.stop - 1, title))


def eds_path(text: str) -> Path:
    """Return the path of an EDS file, or of the bundled file of this name if the path does not exist."""
    path = Path(text).expanduser()
    bundled = data_path("eds", text)
    return bundled if path.name == text and not path.exists() and bundled.is_file() else path


node_id = whole_number("node-ID: 1 to 127", range(1, 128))
seconds = argument(seconds_above_0)
timeout_seconds = number("time in seconds above 0 and up to 60", lambda value: 0.0 < value <= 60.0)


def add_duration(
    parser: argparse.ArgumentParser,
    meaning: str,
    *,
    former: str,
    dest: str = "seconds",
    default: float | None = None,
    read: Callable[[str], float] = seconds,
) -> None:
    """Declare --for S; the old name `former` of the option is still accepted."""
    parser.add_argument("--for", dest=dest, type=read, default=default, metavar="S", help=meaning)
    add_former(parser, former, "--for", dest, read)


def add_former(
    parser: argparse.ArgumentParser, former: str, new: str, dest: str, read: Callable[[str], Any] = str
) -> None:
    """Declare the old name of an option, which is hidden in the help and prints a notice if used."""
    parser.add_argument(former, action=_Renamed, new=new, dest=dest, type=read)


def add_new_name(parser: argparse.ArgumentParser, meaning: str) -> None:
    """Declare --as NAME, the name for a new robot; the old option --name is still accepted."""
    parser.add_argument("--as", dest="name", metavar="NAME", help=meaning)
    add_former(parser, "--name", "--as", "name")


class Names(argparse.Action):
    """Argparse action for names that a user may repeat or separate by commas; the result is one list of names."""

    def __init__(self, option_strings: Sequence[str], dest: str, **options: Any) -> None:  # noqa: ANN401 - argparse.Action takes them
        super().__init__(option_strings, dest, **({"default": []} | options))

    def __call__(
        self, _: argparse.ArgumentParser, namespace: argparse.Namespace, values: object, __: str | None = None
    ) -> None:
        words = values if isinstance(values, list) else [values]
        names = [name.strip() for word in words for name in str(word).split(",")]
        if not all(names):
            raise argparse.ArgumentError(self, f"{','.join(map(str, words))!r} contains an empty name; write a,b")
        setattr(namespace, self.dest, [*(getattr(namespace, self.dest) or ()), *names])


def one_name(text: str) -> str:
    """Return a name or a node-ID; raise ArgumentTypeError with advice for a list of names."""
    if "," in text:
        raise argparse.ArgumentTypeError(f"{text!r}: give one name here, and repeat the command for each of the others")
    return text


def switched_on(args: argparse.Namespace, verb: str) -> bool:
    """Whether the `state` argument is on; raise ConfigError with both forms if neither on nor off is given."""
    if args.state is None:
        bus = "" if args.can is None else f" --can {args.can}"
        raise ConfigError(
            f"add on or off: canopen-control {verb} {args.what} {args.name} on{bus}; to list the active ones: "
            f"canopen-control {verb} {args.what}{bus}"
        )
    return bool(args.state == "on")


class _Renamed(argparse.Action):
    """Argparse action for the old name of an option, which is hidden; a notice names the new option."""

    def __init__(self, option_strings: Sequence[str], dest: str, new: str, **options: Any) -> None:  # noqa: ANN401 - argparse.Action takes them
        super().__init__(option_strings, dest, default=argparse.SUPPRESS, help=argparse.SUPPRESS, **options)
        self.new = new

    def __call__(
        self, parser: argparse.ArgumentParser, namespace: argparse.Namespace, values: object, option: str | None = None
    ) -> None:
        print(f"{parser.prog}: {option} is now called {self.new}; the former name is still accepted", file=sys.stderr)
        setattr(namespace, self.dest, values)


def whole(text: str) -> int:
    """Parse a whole number, decimal or 0x."""
    try:
        return int(text, 0)
    except ValueError:
        raise argparse.ArgumentTypeError(f"{text!r} is not a whole number, decimal or 0x") from None


def finite(text: str) -> float:
    """Parse a finite number, since nan and infinity cannot be commanded."""
    try:
        value = float(text)
    except ValueError:
        raise argparse.ArgumentTypeError(f"{text!r} is not a number") from None
    if not math.isfinite(value):
        raise argparse.ArgumentTypeError(f"{text} is not a value that a drive could reach")
    return value
