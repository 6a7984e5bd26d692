"""Compare the speed of this package on this computer with similar packages, measured in the same run.

Every figure is a ratio to a comparison that ran right before or after it, or is compared with a limit. The comparisons
are the `canopen` package and python-can on the same bus, and calculated times of a bus. Absolute figures need an idle
computer; the table shows whether it was idle. --quick judges only ratios, and counts that must be zero.

    canopen-control bench                   the cycle
    canopen-control bench all --check       every family; exit code 1 if a figure misses its target
    canopen-control bench --quick --check   what CI checks: ratios and counts, in about two minutes
    canopen-control bench --quick --check simulated   only those families that may run in parallel

Exit codes: 0 success; 1 with --check a figure misses its target; 2 wrong usage.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from canopen_control.errors import ConfigError

if TYPE_CHECKING:
    import argparse
    from types import ModuleType


EXAMPLE = "canopen-control bench cycle --json cycle.json"
_PACKAGE = "canopen_control_bench"  # part of the wheel; in a checkout it is in tools/


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the options."""
    _command().add_arguments(parser)


def run(args: argparse.Namespace) -> int:
    """Run the benchmark; return 1 if --check is given and a figure misses its target, else 0."""
    return int(_command().run(args))


def _command() -> ModuleType:
    """Import and return the command module of the benchmark; raise ConfigError if its package is not installed."""
    try:
        from canopen_control_bench import command
    except ModuleNotFoundError as error:
        if error.name != _PACKAGE:
            raise
        raise ConfigError(
            f"the benchmark needs the package {_PACKAGE}, which is not installed: reinstall canopen-control with pip, "
            "or run tools/bench in a checkout"
        ) from error
    return command
