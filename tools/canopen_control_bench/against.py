"""Compares this checkout with another commit: both are measured in alternating pairs in one run on the same machine.

    tools/bench against COMMIT FAMILY... [--pairs N] [--quick] [--as-is] [--json FILE]
    tools/bench --compiled against COMMIT FAMILY...

The other commit is unpacked into a temporary folder (`git archive`) and built as this checkout is, pure or compiled; it
runs in the environment of this checkout, each side with its own bench. In every second pair the other one is measured
first. Of each figure the table has the medians of both, and median, quartiles and extremes of the ratio: this checkout
by the other one. A ratio whose quartiles lie on one side of 1 is marked; compare a commit with itself for what this
machine makes of no difference at all.

Exit codes: 0 measured; 1 a family could not be measured; 2 wrong usage, no such commit, changes that are in no commit.
"""

from __future__ import annotations

import argparse
import json
import math
import os
import signal
import statistics
import subprocess
import sys
import tempfile
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

from canopen_control.errors import CanopenError, ConfigError
from canopen_control.host.signals import interrupt, on_signals
from canopen_control_bench.figure import AT_LEAST, OWN_CPU
from canopen_control_bench.runner import FAMILIES, GROUPS

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping, Sequence


MIN_PAIRS: Final = 7
_ROOT: Final = Path(__file__).resolve().parents[2]
_KNOWN: Final = (
    "import json; from canopen_control_bench.runner import FAMILIES, GROUPS; print(json.dumps({**GROUPS, **FAMILIES}))"
)

Figures = dict[tuple[str, str, str], dict[str, Any]]
"""Figures as the bench's JSON has them, by family, name and peer."""


class Unmeasured(CanopenError):
    """A family that could not be measured."""


@dataclass(frozen=True, slots=True)
class Side:
    """One of the two sides: its display name, and the folders from which its processes import."""

    name: str
    path: str

    @property
    def environment(self) -> dict[str, str]:
        """The environment of its processes."""
        return {**os.environ, "PYTHONPATH": self.path}


@dataclass(frozen=True, slots=True)
class Ratio:
    """One compared figure: the medians of both sides, and the ratios of the pairs (this checkout / the other)."""

    family: str
    name: str
    unit: str
    direction: str
    ours: float
    theirs: float
    ratios: tuple[float, ...]

    @property
    def median(self) -> float:
        """The median of the ratios, nan if any of them is nan."""
        return statistics.median(self.ratios) if all(map(math.isfinite, self.ratios)) else math.nan

    @property
    def quartiles(self) -> tuple[float, float]:
        """The quartiles of the ratios."""
        if math.isnan(self.median):
            return math.nan, math.nan
        low, _, high = statistics.quantiles(self.ratios, n=4, method="inclusive")
        return low, high

    @property
    def verdict(self) -> str:
        """Whether this checkout is better or worse, or empty if 1 is between the quartiles."""
        low, high = self.quartiles
        if not (low > 1.0 or high < 1.0):
            return ""
        return "better" if (low > 1.0) is (self.direction == AT_LEAST) else "worse"


def main(arguments: Sequence[str]) -> int:
    """Measure both sides and print the ratios."""
    args = _parser().parse_args(arguments)
    try:
        with on_signals((signal.SIGTERM,), interrupt), tempfile.TemporaryDirectory(prefix="bench-") as folder:
            return _run(args, Path(folder))
    except ConfigError as error:
        print(f"tools/bench against: {error}", file=sys.stderr)
        return 2
    except Unmeasured as error:
        print(f"tools/bench against: {error}", file=sys.stderr)
        return 1
    except KeyboardInterrupt:
        return 130


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(prog="tools/bench against", description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("commit", metavar="COMMIT", help="a git revision: a hash, a branch, HEAD~3")
    parser.add_argument("family", nargs="+", metavar="FAMILY", help=f"one of: {', '.join((*FAMILIES, *GROUPS))}")
    parser.add_argument(
        "--pairs", type=int, default=MIN_PAIRS, metavar="N", help=f"number of pairs (default and minimum: {MIN_PAIRS})"
    )
    parser.add_argument("--quick", action="store_true", help="short runs, same as for the bench")
    parser.add_argument("--as-is", action="store_true", help="allow CPU idle states, same as for the bench")
    parser.add_argument("--json", type=Path, metavar="FILE", help="write the ratios of all pairs to a file")
    parser.add_argument("--compiled", action="store_true", help="compile the cycle modules of both commits")
    return parser


def _run(args: argparse.Namespace, folder: Path) -> int:
    for name in args.family:
        if name not in (*FAMILIES, *GROUPS):
            raise ConfigError(f"no family {name!r}; available: {', '.join((*FAMILIES, *GROUPS))}")
    if args.pairs < MIN_PAIRS:
        raise ConfigError(
            f"--pairs {args.pairs}: at least {MIN_PAIRS} pairs are needed to distinguish a change from chance"
        )
    if args.json is not None and not args.json.absolute().parent.is_dir():
        raise ConfigError(f"--json {args.json}: there is no folder {args.json.absolute().parent}")
    here, there = _commit("HEAD"), _commit(args.commit)
    if changed := _git("status", "--porcelain", "--untracked-files=no").splitlines():
        raise ConfigError(
            f"{changed[0][3:]}{f' and {len(changed) - 1} more files' if len(changed) > 1 else ''} of this checkout "
            "changed since its commit; commit or stash that, so that what is measured has a name"
        )
    words = [*args.family, *(["--quick"] if args.quick else []), *(["--as-is"] if args.as_is else [])]
    _unpack(there, folder)
    sides = [
        Side(f"this checkout ({here[:9]})", _built(_ROOT, compiled=args.compiled)),
        Side(there[:9], _built(folder, compiled=args.compiled)),
    ]
    _require_families(sides[1], args.family)
    found = [(Figures(), Figures()) for _ in range(args.pairs)]
    for number, pair in enumerate(found):
        for place in (0, 1) if number % 2 == 0 else (1, 0):
            side = sides[place]
            print(f"pair {number + 1} of {args.pairs}: {side.name}", file=sys.stderr, flush=True)
            pair[place].update(_measured(side, words, folder / "report.json"))
    ratio, alone = ratios(found)
    kind = "compiled" if args.compiled else "pure"
    print(f"{sides[0].name} against {sides[1].name}, {args.pairs} alternating pairs, {kind}\n\n{table(ratio)}")
    for text in alone:
        print(text)
    if args.json is not None:
        rows = [{**asdict(row), "median": row.median, "quartiles": row.quartiles} for row in ratio]
        document = {"here": here, "there": there, "compiled": args.compiled, "pairs": args.pairs, "figures": rows}
        args.json.write_text(json.dumps(document, indent=2) + "\n")
    return 0


def _git(*words: str) -> str:
    """Run git and return its output; ConfigError if git fails or is not installed."""
    try:
        done = subprocess.run(["git", "-C", str(_ROOT), *words], capture_output=True, text=True, check=False)
    except OSError:
        raise ConfigError("git is not installed; it knows the other commit") from None
    if done.returncode:
        raise ConfigError(done.stderr.strip().partition("\n")[0] or f"git {words[0]} failed")
    return done.stdout


def _commit(name: str) -> str:
    """Return the hash of a commit; ConfigError if it does not exist."""
    try:
        return _git("rev-parse", "--verify", "--quiet", "--end-of-options", f"{name}^{{commit}}").strip()
    except ConfigError as error:
        if "git repository" in str(error) or "installed" in str(error):
            raise
        raise ConfigError(f"no commit {name!r} in {_ROOT}; git log shows those there are") from None


def _unpack(commit: str, folder: Path) -> None:
    """Extract the files of a commit."""
    archive = folder / "commit.tar"
    _git("archive", "--format=tar", f"--output={archive}", commit)
    subprocess.run(["tar", "-x", "-f", str(archive), "-C", str(folder)], check=True)
    archive.unlink()
    if not (folder / "tools" / "canopen_control_bench" / "runner.py").exists():
        raise ConfigError(f"commit {commit[:9]} has no bench of its own (tools/canopen_control_bench)")


def _built(folder: Path, *, compiled: bool) -> str:
    """Prepare a checkout for import, with its bytecode compiled, and return its folders."""
    if compiled:
        done = subprocess.run([_ROOT / "tools" / "compile", folder], stdout=subprocess.PIPE, text=True, check=False)
        if done.returncode:
            raise ConfigError(f"{folder}: its modules cannot be compiled; the lines above say why")
        return done.stdout.strip().splitlines()[-1]
    for path in ("canopen_control", "tools/canopen_control_bench"):
        subprocess.run([sys.executable, "-m", "compileall", "-q", str(folder / path)], check=False)
    return f"{folder}{os.pathsep}{folder / 'tools'}"


def _require_families(side: Side, names: Iterable[str]) -> None:
    """Raise ConfigError for a family that the other commit lacks, or that cannot run here."""
    done = subprocess.run(
        [sys.executable, "-P", "-c", _KNOWN], env=side.environment, capture_output=True, text=True, check=False
    )
    if done.returncode:
        raise ConfigError(f"commit {side.name} does not run in this environment: {_last(done.stderr)}")
    known = json.loads(done.stdout)
    if strange := next((name for name in names if name not in known), None):
        raise ConfigError(f"commit {side.name} has no family {strange!r}; it has: {', '.join(known)}")


def _measured(side: Side, words: Sequence[str], report: Path) -> Figures:
    """Measure one side once; Unmeasured if a family failed."""
    report.unlink(missing_ok=True)
    command = [sys.executable, "-P", "-m", "canopen_control", "bench", *words, "--json", str(report)]
    with subprocess.Popen(
        command, env=side.environment, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True
    ) as process:
        try:
            _, said = process.communicate()
        except BaseException:
            process.terminate()  # it ends its child processes, and removes its folders
            raise
    if not report.exists() or not report.stat().st_size:
        raise Unmeasured(f"{side.name}: the bench ended with {process.returncode}: {_last(said)}")
    found = json.loads(report.read_text())
    if failures := found["failures"]:
        family, text = next(iter(failures.items()))
        raise Unmeasured(f"{side.name}: {family}: {text}")
    return {
        (family, figure["name"], figure["peer_name"]): figure
        for family, figures in found["figures"].items()
        for figure in figures
    }


def _last(text: str) -> str:
    return (text.strip().splitlines() or ["it does not say why"])[-1]


def ratios(pairs: Sequence[tuple[Figures, Figures]]) -> tuple[list[Ratio], list[str]]:
    """Return the ratios of the figures that both sides have in all pairs, and lines about the remaining figures."""
    keys = list(dict.fromkeys(key for pair in pairs for side in pair for key in side))
    found, alone = [], []
    for key in keys:
        seen = [sum(key in pair[place] for pair in pairs) for place in (0, 1)]
        family, name, peer = key
        if min(seen) < len(pairs):
            which = (
                "this checkout alone"
                if seen[0] > seen[1]
                else "the other one alone"
                if seen[1] > seen[0]
                else "some runs"
            )
            alone.append(f"{family}: {name}: seen by {which}")
            continue
        ours, theirs = ([_value(pair[place][key]) for pair in pairs] for place in (0, 1))
        first = pairs[0][0][key]
        found.append(
            Ratio(
                family,
                f"{name} / {peer}" if sum(other[:2] == key[:2] for other in keys) > 1 else name,
                f"{first['unit']}/s CPU" if first["peer_name"] == OWN_CPU else first["unit"],
                first["direction"],
                statistics.median(ours),
                statistics.median(theirs),
                tuple(map(_ratio, ours, theirs)),
            )
        )
    return found, alone


def _value(figure: Mapping[str, Any]) -> float:
    """Return the value to compare: the measured value, or the work done per CPU second."""
    return float(figure["ratio" if figure["peer_name"] == OWN_CPU else "ours"])


def _ratio(ours: float, theirs: float) -> float:
    """Return a ratio; 1 if both counts are 0, nan if only the divisor is 0."""
    if theirs:
        return ours / theirs
    return 1.0 if not ours else math.nan


def table(found: Sequence[Ratio]) -> str:
    """Return the ratios as a table."""
    head = ("family", "figure", "here", "there", "unit", "ratio", "quartiles", "extremes", "")
    rows = [head, *(_row(result) for result in found)]
    widths = [max(len(row[column]) for row in rows) for column in range(len(head))]
    return "\n".join(
        "  ".join(cell.ljust(width) for cell, width in zip(row, widths, strict=True)).rstrip() for row in rows
    )


def _row(ratio: Ratio) -> tuple[str, ...]:
    numbers: Mapping[str, str] = {"ours": f"{ratio.ours:.4g}", "theirs": f"{ratio.theirs:.4g}"}
    if math.isnan(ratio.median):
        return (ratio.family, ratio.name, numbers["ours"], numbers["theirs"], ratio.unit, "-", "-", "-", "")
    low, high = ratio.quartiles
    return (
        ratio.family,
        ratio.name,
        numbers["ours"],
        numbers["theirs"],
        ratio.unit,
        f"{ratio.median:.3f}",
        f"{low:.3f} to {high:.3f}",
        f"{min(ratio.ratios):.3f} to {max(ratio.ratios):.3f}",
        ratio.verdict,
    )


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
