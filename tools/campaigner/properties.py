"""`tools/campaign --properties`: runs the property tests with random instead of fixed examples.

Examples are drawn from a seed, which is printed first, and there are ten times as many. Tests that ./tools/test runs
with a few of many values (`sweep`) run with all of them. A failure prints the example (`@reproduce_failure`), and the
same seed finds it again.
"""

from __future__ import annotations

import argparse
import os
import random
import subprocess
import sys
from typing import TYPE_CHECKING, Final

if TYPE_CHECKING:
    from collections.abc import Sequence

_SELECTION: Final = "(hypothesis or sweep) and not process and not socketcan and not hardware"
_NO_TESTS: Final = 5  # pytest's exit code


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="tools/campaign --properties", description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--properties", action="store_true", help=argparse.SUPPRESS)
    parser.add_argument("--seed", type=int, help="default: drawn, and printed")
    parser.add_argument("--times", type=float, default=10.0, help="how many times more examples (default: 10)")
    parser.add_argument("paths", nargs="*", metavar="PATH", help="test files or folders; default: all")
    return parser


def main(arguments: Sequence[str]) -> int:
    """Run the property tests; return 0 if all passed, 1 if one failed or none was found, 2 for wrong arguments."""
    parser = _parser()
    args = parser.parse_args(arguments)
    if not 0.01 <= args.times <= 1000.0:
        parser.error(f"--times is {args.times:g}; give a factor from 0.01 to 1000")
    seed = random.SystemRandom().randrange(1, 1_000_000) if args.seed is None else args.seed
    print(f"seed {seed}; again: tools/campaign --properties --seed {seed}", flush=True)
    command = [sys.executable, "-m", "pytest", "-q", "-m", _SELECTION, "-n", "2", "--dist", "worksteal"]
    command += [f"--hypothesis-seed={seed}", "--timeout=1200", *args.paths]
    code = subprocess.run(command, env={**os.environ, "CANOPEN_CONTROL_EXAMPLES": str(args.times)}).returncode
    if code == _NO_TESTS:
        print("tools/campaign: no property was found in these paths", file=sys.stderr)
    return min(code, 1)
