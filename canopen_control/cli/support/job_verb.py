"""Common parts of the verbs that run a commissioning job: options, progress and result."""

from __future__ import annotations

import contextlib
import sys
from typing import TYPE_CHECKING, Any

from canopen_control.cli.support.arguments import add_former, argument
from canopen_control.cli.support.output import Progress, json_text
from canopen_control.commissioning.jobs import JobRun

if TYPE_CHECKING:
    import argparse
    from collections.abc import Iterator

    from canopen_control.commissioning.jobs import Job


def add_job_options(parser: argparse.ArgumentParser, job: Job) -> None:
    """Declare the options of a job for the parser of its verb."""
    for name, option in job.declared.items():
        if option.is_switch:
            parser.add_argument(option.flag, dest=name, action="store_true", help=option.text)
            continue
        given = "" if option.default in (None, "") else f" (default: {_shown(option.default)})"
        read = str if option.read is None else argument(option.read)
        parser.add_argument(
            option.flag,
            dest=name,
            metavar=option.metavar,
            action="append" if option.repeats else "store",
            type=read,
            default=[] if option.repeats else option.default,
            help=f"{option.text}{' (repeatable)' if option.repeats else given}",
        )
        if option.former:
            add_former(parser, option.former, option.flag, name, read)


def _shown(value: object) -> str:
    return f"{value:g}" if isinstance(value, float) else str(value)


def job_options(args: argparse.Namespace, job: Job, **others: object) -> Any:  # noqa: ANN401 - of the job's own type
    """Return the options object of a job from the arguments; `others` are options that the job does not declare."""
    return job.options(**{name: getattr(args, name) for name in job.declared}, **others)


class VerbRun(JobRun):
    """Run of a job by a verb of the command line, with progress and notes on standard error."""

    _progress: Progress | None = None

    def part(self, doing: str, unit: str = "") -> None:
        super().part(doing, unit)
        self.close()
        self._progress = Progress(doing, unit, rate=unit == "bytes")

    def show(self, done: int, total: int | None) -> None:
        super().show(done, total)
        if self._progress is not None:
            self._progress.at(done, total)

    def note(self, text: str) -> None:
        if self._progress is not None:
            self._progress.end()
        print(f"canopen-control: {text}", file=sys.stderr)

    def close(self) -> None:
        """Erase the progress display."""
        if self._progress is not None:
            self._progress.end()
            self._progress = None


@contextlib.contextmanager
def verb_run(job: Job) -> Iterator[VerbRun]:
    """Context with the run of a job; its progress display is erased on exit."""
    run = VerbRun(job, job.name)
    try:
        yield run
    finally:
        run.close()


def print_run(args: argparse.Namespace, run: JobRun, sentence: str) -> int:
    """Print the document of a job with --json, otherwise its lines and `sentence`; return 1 if it failed."""
    print(json_text(run.document) if args.json else "\n".join([*run.lines, sentence]))
    return 1 if run.failed else 0


def print_restored(args: argparse.Namespace, run: JobRun, sentence: str) -> int:
    """Print the result of a restore or a clone, with a hint about --store if nothing was stored."""
    return print_run(args, run, sentence if run.failed or args.store else f"{sentence} (--store)")
