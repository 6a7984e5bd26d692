"""Declarations of the commissioning jobs and their options, and the state of a running job.

A job is declared once, as an entry of `JOBS` with a dataclass of its options. Three user interfaces use this
declaration: the command line for its arguments (`cli/support/job_verb.py`), the page for its inputs
(`view/drive/drive_tab.py`), and the monitor, which runs the command, for its input line (`monitor/drive_objects.py`).
The job itself is a function of a session, a `JobRun` and the options, in a module of this subpackage; it returns a
sentence with the result.
"""

from __future__ import annotations

import datetime
import threading
from dataclasses import dataclass, field, fields, replace
from functools import partial
from typing import TYPE_CHECKING, Any, Final

from canopen_control.commissioning.quantity import (
    Quantity,
    number_that,
    parse_quantity,
    seconds_above_0,
    whole_between,
)
from canopen_control.errors import ConfigError, DriveError

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping, Sequence

    from canopen_control.commissioning.node_session import Transfers


# -- options: the same for the command line, the page and the monitor


@dataclass(frozen=True, slots=True)
class JobOption:
    """Option of a job, with its flags and metavar on the command line and its help text.

    `read` parses a text (ConfigError if it is invalid); None keeps the text. An option that `repeats` has a list of
    values.
    """

    text: str
    name: str = ""
    flag: str = ""
    former: str = ""
    metavar: str = ""
    default: Any = None
    read: Callable[[str], Any] | None = None
    repeats: bool = False

    @property
    def is_switch(self) -> bool:
        return isinstance(self.default, bool)

    def value_of(self, text: str) -> Any:  # noqa: ANN401 - of the option's own type
        """Parse a text; raise ConfigError if it is invalid.

        An empty text means the default. An option that `repeats` takes a comma-separated list instead.
        """
        if self.repeats:
            return [part.strip() for part in text.split(",") if part.strip()]
        text = text.strip()
        return self.default if not text else text if self.read is None else self.read(text)


def option(
    default: object,
    text: str,
    *,
    flag: str = "",
    former: str = "",
    metavar: str = "",
    read: Callable[[str], Any] | None = None,
) -> Any:  # noqa: ANN401 - as `dataclasses.field`, of any type
    """Declare a dataclass field as an option of a job; the flag defaults to the field's name."""
    declared = JobOption(text, flag=flag, former=former, metavar=metavar, read=read, repeats=default == ())
    return field(default=default, metadata={"option": declared})


def options_of(kind: type[Any]) -> dict[str, JobOption]:
    """Return the options declared in a dataclass, by field name."""
    declared = ((entry, entry.metadata["option"]) for entry in fields(kind) if "option" in entry.metadata)
    return {
        entry.name: replace(
            one, name=entry.name, flag=one.flag or f"--{entry.name.replace('_', '-')}", default=entry.default
        )
        for entry, one in declared
    }


@dataclass(frozen=True, slots=True)
class NoOptions:
    """Options of a job without options."""


@dataclass(frozen=True, slots=True)
class Reached:
    """Options that select the bus or robot of a node (`--can`, `--name`), and whether `--include-protected` is set."""

    channel: str = ""
    robot: str = ""
    include_protected: bool = False


@dataclass(frozen=True, slots=True)
class RestoreOptions:
    """Options of a restore or a clone; `reached` is used only in suggested commands."""

    protect: Sequence[str] = option((), "exclude these objects: an address as in '0x2*', or a name", metavar="GLOB")
    include_protected: bool = option(False, "also write the calibration of another drive")
    keep: bool = option(False, "keep the accepted values if the drive refuses others")
    store: bool = option(False, "store in the drive (0x1010) after verification")
    any_node: bool = option(False, "accept a drive with another node-ID and serial number")
    reached: Reached = field(default_factory=Reached)


@dataclass(frozen=True, slots=True)
class ProgramDate:
    """Date of a program (0x1F52); `milliseconds` after midnight are None if only the `day` is known."""

    day: datetime.date
    milliseconds: int | None = None

    def __str__(self) -> str:
        if self.milliseconds is None:
            return self.day.isoformat()
        midnight = datetime.datetime.combine(self.day, datetime.time())
        return (midnight + datetime.timedelta(milliseconds=self.milliseconds)).isoformat(" ", "seconds")

    def fits(self, other: ProgramDate | None) -> bool:
        """Whether another date equals this date; if this date has no time, only the days are compared."""
        if other is None or other.day != self.day:
            return False
        return self.milliseconds is None or self.milliseconds == other.milliseconds


def parse_date(text: str) -> ProgramDate:
    """Parse a day, or a day and a time, in ISO 8601 format; raise ConfigError if the text is not a date."""
    day, _, at = text.partition("T")
    try:
        midnight = datetime.datetime.combine(datetime.date.fromisoformat(day), datetime.time())
        if not at:
            return ProgramDate(midnight.date())
        since = midnight.combine(midnight.date(), datetime.time.fromisoformat(at).replace(tzinfo=None)) - midnight
        return ProgramDate(midnight.date(), since // datetime.timedelta(milliseconds=1))
    except ValueError:
        raise ConfigError(f"{text!r} is not a date: 2026-11-21, or 2026-11-21T14:30:00") from None


@dataclass(frozen=True, slots=True)
class ProgramOptions:
    """Options of a program download; `expected_date` may be a day without a time."""

    number: int = option(
        1,
        "number of the program in the node",
        flag="--program",
        metavar="N",
        read=whole_between(1, 254, "number of a program: 1 to 254"),
    )
    expected: int | None = option(
        None,
        "value that 0x1F56 must have before the program is started",
        flag="--expect",
        metavar="ID",
        read=whole_between(0, 0xFFFFFFFF, "whole number of 32 bits, decimal or 0x"),
    )
    expected_date: ProgramDate | None = option(
        None,
        "date that 0x1F52 of the running program must have: 2026-11-21, or 2026-11-21T14:30:00",
        flag="--expect-date",
        metavar="DAY[TTIME]",
        read=parse_date,
    )
    confirm: bool = option(False, "confirm a program that runs on trial (0x80, as in Zephyr)")
    tries: int = 2
    start_s: float = 30.0


_positive: Final = number_that(lambda value: value > 0, "number above 0")
_SPEED, _TRAVEL = "X[rad/s|rpm|pps]", "X[rad|deg|turns|counts]"


@dataclass(frozen=True, slots=True)
class MotionOptions:
    """Options of a job that moves an axis; `max_current` is in per mille of the rated current."""

    seconds: float | None = option(None, "move at once, for S seconds", flag="--for", metavar="S", read=seconds_above_0)
    max_speed: Quantity | None = option(
        None, "speed limit (default: 60rpm)", metavar=_SPEED, read=partial(parse_quantity, kind="velocity")
    )
    max_travel: Quantity | None = option(
        None,
        "travel limit in each direction (default: 10turns)",
        metavar=_TRAVEL,
        read=partial(parse_quantity, kind="position"),
    )
    max_current: float = option(
        1000.0,
        "current limit in per mille of the rated current",
        metavar="PERMILLE",
        read=number_that(lambda value: value > 0, "current in per mille above 0"),
    )
    counts: float | None = option(
        None, "position counts per turn, if neither the EDS nor the drive has them", metavar="N", read=_positive
    )
    axis: int = option(0, "axis number of a drive with several", metavar="N", read=whole_between(0, 7, "axis: 0 to 7"))
    allow_unsupervised: bool = option(False, "accept a drive that would not stop when this computer fails")


@dataclass(frozen=True, slots=True)
class TuneOptions(MotionOptions):
    """Options of a tuning run: `crossover` in Hz, `phase_margin` in degrees and `loop_delay` in ms."""

    seconds: float | None = option(
        None, "duration in s (default: step 2, bode 8, identify 8)", flag="--for", metavar="S", read=seconds_above_0
    )
    crossover: float = option(20.0, "crossover frequency of the proposal", metavar="HZ", read=_positive)
    phase_margin: float = option(
        60.0,
        "phase margin of the proposal",
        metavar="DEG",
        read=number_that(lambda value: 20 <= value <= 85, "phase margin in degrees: 20 to 85"),
    )
    loop_delay: float = option(0.5, "dead time of the drive's own loop", metavar="MS", read=_positive)
    store: bool = option(False, "store the gains in the drive (0x1010)")


@dataclass(frozen=True, slots=True)
class ScopeOptions:
    """Options of a scope; `length` and `before` are in s; if `before` is None, it is a fifth of `length`."""

    rate: float = option(
        50.0,
        "polling rate",
        metavar="HZ",
        read=number_that(lambda value: 0 < value <= 1000.0, "rate in Hz above 0, at most 1000"),
    )
    length: float = option(
        5.0, "length of a capture", flag="--for", former="--length", metavar="S", read=seconds_above_0
    )
    trigger: str = option("", "start of a capture: SIGNAL:rising|falling|above|below:LEVEL, or fault", metavar="T")
    before: float | None = option(
        None, "seconds of the capture before the trigger (default: a fifth of it)", metavar="S", read=seconds_above_0
    )
    shots: int = option(
        1, "number of captures", metavar="N", read=whole_between(1, 999_999, "number of shots: 1 or more")
    )
    rolling: bool = option(False, "capture repeatedly, until Ctrl-C")


# -- the jobs


@dataclass(frozen=True, slots=True)
class Job:
    """Declaration of a job: command, description, example for the input line, and tab on the page.

    `options` is a dataclass, of which the fields in `without` do not apply. `can_end` is True if the job may be
    cancelled.
    """

    name: str
    does: str
    takes: str
    tab: str = ""
    options: type[Any] = NoOptions
    without: tuple[str, ...] = ()
    can_end: bool = True

    @property
    def declared(self) -> Mapping[str, JobOption]:
        return {name: one for name, one in options_of(self.options).items() if name not in self.without}

    @property
    def asks(self) -> str:
        """Hint for the monitor's input line: argument and flags of the job."""
        flags = [
            f"{one.flag}={one.metavar}" if one.metavar else one.flag
            for one in self.declared.values()
            if not one.repeats
        ]
        return "; also ".join(filter(None, (self.takes, ", ".join(flags))))


_PARAMETERS: Final = "parameters"
BACKUP: Final = Job("backup", "save the parameters as a DCF", "FILE.dcf", _PARAMETERS)
DIFF: Final = Job("diff", "compare with a file or another node", "FILE.dcf or NODE", _PARAMETERS)
RESTORE: Final = Job("restore", "write the parameters of a DCF", "FILE.dcf", _PARAMETERS, RestoreOptions)
CLONE: Final = Job(
    "clone", "write the parameters of another node", "NODE", _PARAMETERS, RestoreOptions, without=("any_node",)
)
FIRMWARE: Final = Job("firmware", "load a program", "FILE", "firmware", ProgramOptions, can_end=False)
JOG: Final = Job("jog", "turn the axis slowly", "20rpm,3s or 90deg", options=MotionOptions)
SCOPE: Final = Job("scope", "record objects over time", "0x6064,0x606C,--output=step.csv", "scope", ScopeOptions)
TUNE: Final = Job(
    "tune",
    "measure step and frequency responses, identify gains",
    "step=30rpm, bode, identify=150 or revert; --yes confirms the limits in advance",
    "tune",
    TuneOptions,
)
DUMP: Final = Job("dump", "print all values", "table or csv")
NMT: Final = Job("nmt", "change the NMT state", "preop, start, reset-node")
JOBS: Final = {job.name: job for job in (JOG, SCOPE, TUNE, BACKUP, DIFF, RESTORE, CLONE, FIRMWARE, DUMP, NMT)}
"""Jobs by command name."""


# -- one run


@dataclass
class JobRun:
    """Progress and result of a job, written by the job's thread and read by the pages.

    `doing` names the current part of the work. `sentence` is the result; `good` is True if the job succeeded, None
    while it runs. Further results are `lines`, `table`, `file` (name and bytes) and `document` (for programs).
    `transfers` are those of the job's session, or None if `end` must not cancel them.
    """

    job: Job
    title: str
    unit: str = ""
    doing: str = ""
    done: int = 0
    total: int | None = None
    sentence: str = ""
    good: bool | None = None
    failed: bool = False
    lines: list[str] = field(default_factory=list)
    table: list[tuple[str, ...]] = field(default_factory=list)
    file: tuple[str, bytes] | None = None
    document: object = None
    _rated: tuple[str, float, int] = ("", 0.0, 0)
    transfers: Transfers | None = None
    _ending: threading.Event = field(default_factory=threading.Event)

    def part(self, doing: str, unit: str = "") -> None:
        """Start a part of the work whose progress is counted in `unit`."""
        self.doing, self.unit, self.done, self.total = doing, unit or self.unit, 0, None

    def at(self, done: int, total: int | None = None) -> None:
        """Report progress; raise DriveError if the end of the job was requested."""
        self.show(done, total)
        if self._ending.is_set():
            raise DriveError("a page requested the end")

    def show(self, done: int, total: int | None) -> None:
        """Update the progress, even if the end of the job was requested."""
        self.done, self.total = done, total

    def note(self, text: str) -> None:
        """Add a line to the report of the job."""
        self.lines.append(text)

    def pace(self, now: float) -> tuple[float, float] | None:
        """Return progress per second and remaining seconds, or None if they cannot be estimated."""
        part, since, before = self._rated
        if part != self.doing or self.done < before or not self.done:
            self._rated = self.doing, now, self.done
            return None
        gained, elapsed = self.done - before, now - since
        if gained <= 0 or elapsed <= 0.0 or self.total is None:
            return None
        return gained / elapsed, max(0.0, (self.total - self.done) * elapsed / gained)

    def end(self) -> None:
        """Request that the job end at its next progress report; a separate thread cancels the transfer in progress."""
        self._ending.set()
        if self.transfers is not None:
            threading.Thread(target=self.transfers.cancel, name=f"end of {self.job.name}", daemon=True).start()

    @property
    def over(self) -> bool:
        return self.good is not None
