"""Jobs at one node, shared by all pages: short requests on threads, and one long job at a time. No toolkit.

Each request has its own connection, so that STOP and the stream of the state never wait behind it. A long job continues
when the page that started it is closed; every page shows its progress, and any page can end it.
"""

from __future__ import annotations

import contextlib
import threading
import time
from dataclasses import dataclass, field
from functools import partial
from typing import TYPE_CHECKING, Final, TypeVar

from canopen_control.client import RobotClient
from canopen_control.commissioning.live_reader import NodeObjects
from canopen_control.commissioning.object_rows import EditHistory
from canopen_control.commissioning.parameter_set import (
    backup_file_text,
    differences,
    parse_backup,
    read_parameters,
    read_same,
)
from canopen_control.commissioning.program_download import (
    DownloadProgress,
    DownloadStep,
    ProgramOptions,
    boot_check,
    download,
    interrupted_words,
    is_loader,
    refuse_other_product,
)
from canopen_control.commissioning.restore import (
    Reached,
    RestoreOptions,
    guarded_restore,
    quiet_node,
    refuse_other_drive,
    unfinished_words,
)
from canopen_control.errors import CanopenError, ConfigError, DriveError
from canopen_control.rpc.messages.robot import MAX_OBJECT
from canopen_control.view.robot_connection import SOURCE, in_thread

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    from canopen_control.commissioning.node_session import NodeSession
    from canopen_control.commissioning.object_rows import Edit
    from canopen_control.commissioning.parameter_set import ParameterSet
    from canopen_control.od.model import Entry
    from canopen_control.rpc.messages.robot import NodePlace
    from canopen_control.view.scope_run import ScopeRun
    from canopen_control.view.tune_job import TuneFound


# The long work of the Parameters tab at one node: backup, comparison, restore, clone. No toolkit; runs on threads.
#
# Each takes a session and the piece of work that pages look at, and returns the sentence at its end. What must not be
# is refused by the subpackage `commissioning`, in the same words as by the verbs.


MOST_PARAMETER_BYTES = 4_000_000  # of a DCF
_FEWEST = 1


def uploaded(data: bytes, name: str) -> ParameterSet:
    """Read an uploaded DCF; ConfigError or EdsError if it is invalid."""
    if not data:
        raise ConfigError(f"{name} is empty")
    return parse_backup(data, name)


def backup(session: NodeSession, work: NodeJob) -> str:
    """Read all parameters and store them as a file."""
    if unfinished := unfinished_words(session, Reached(robot=session.robot)):
        work.lines.append(unfinished)
    parameters, left_out = read_parameters(session, told=work.at)
    if len(parameters.values) < _FEWEST:
        raise DriveError(f"{session} has no parameter that can be read and written")
    text, lost = backup_file_text(parameters, session.name)
    work.lines += [f"left out: {reason}" for reason in (*map(str, left_out), *lost)]
    name = f"{session.name or f'node{session.node_id}'}.dcf"
    work.file = name, text.encode()
    return f"{session}: {len(parameters.values) - len(lost)} parameters in {name}"


def compare(session: NodeSession, work: NodeJob, file: ParameterSet) -> str:
    """Read the parameters of a file from the node and list the differences: address, name, file, node."""
    node, left_out = read_same(session, file, work.at)
    why = {unread.entry.address: unread.why for unread in left_out}
    changes = differences(file, node)
    work.lines += [*file.identity.strangers(node.identity), *file.identity.variations(node.identity)]
    work.table = [
        (
            f"0x{unread.entry.index:04X}:{unread.entry.subindex:02X}",
            unread.name,
            unread.a_text or "-",
            unread.b_text or why.get(unread.entry.address, "-"),
        )
        for unread in changes
    ]
    compared = len({*file.values, *node.values})
    if not changes:
        return f"{file.where} and {session}: {compared} parameters, equal"
    return f"{file.where} and {session}: {len(changes)} of {compared} parameters differ"


def restore(
    session: NodeSession, work: NodeJob, file: ParameterSet, options: RestoreOptions, *, any_node: bool = False
) -> str:
    """Write and verify the parameters of a file; DriveError if the node refused some."""
    if session.od is None:
        session.od = file.od.for_node(session.node_id)
    if not any_node:
        refuse_other_drive(file, session)
    report = guarded_restore(session, file, options, note=work.lines.append, told=work.at)
    work.lines += [f"refused: {text}" for text in report.refused]
    work.lines += [f"kept as it is: {text}" for text in report.protected]
    if report.refused:
        raise DriveError(report.words(session))
    return report.words(session)


def clone_from(session: NodeSession, work: NodeJob, source: NodeJobs, options: RestoreOptions) -> str:
    """Read all parameters of another node and write them into this one."""
    work.doing = f"reading {source.place.name}"
    parameters = source.with_session(lambda source_session: read_parameters(source_session, told=work.at)[0])
    work.doing = f"writing {session.name or session}"
    work.done, work.total = 0, None
    return restore(session, work, parameters, options, any_node=True)


# The long work of the Firmware tab: checks, download with its progress, the boot check. No toolkit; on a thread.


MOST_FIRMWARE_BYTES: Final = MAX_OBJECT
"""Of a program through a running robot; a longer one goes straight on the bus (`firmware --can`)."""
_LOOK_S: Final = 0.3


def options_of(number: str, expected: str) -> ProgramOptions:
    """Return the options of a form; ConfigError for an invalid field."""
    try:
        program = int(number or "1", 0)
        wanted = int(expected, 0) if expected.strip() else None
    except ValueError:
        raise ConfigError(f"{number!r} and {expected!r}: expected a number, decimal or 0x") from None
    if not 1 <= program <= 254:
        raise ConfigError(f"program {program}: programs are 1 to 254")
    if wanted is not None and not 0 <= wanted < 1 << 32:
        raise ConfigError(f"{expected}: 0x1F56 holds 32 bits")
    return ProgramOptions(program, wanted)


def check_image(image: bytes, name: str) -> None:
    """Raise ConfigError with the reason for a file that cannot be a program."""
    if not image:
        raise ConfigError(f"{name} is empty; nothing was sent")
    if len(image) > MOST_FIRMWARE_BYTES:
        raise ConfigError(
            f"{name} has {len(image)} bytes, a running robot passes on {MOST_FIRMWARE_BYTES}: end it with "
            "`shutdown` and use `canopen-control firmware --can`"
        )
    if image.lstrip()[:10].upper().startswith((b"[FILEINFO]", b"[DEVICEINF")):
        raise ConfigError(f"{name} is an EDS or a DCF and no program; nothing was sent")


def load_program(session: NodeSession, work: NodeJob, image: bytes, options: ProgramOptions) -> str:
    """Load a program and start it; DriveError with the present state of the node if that failed."""
    identity = session.identity()
    refuse_other_product(session, identity)
    if is_loader(identity):
        work.lines.append(f"{session} is in its boot-loader")
    progress = DownloadProgress()
    try:
        with quiet_node(session, starts_again=False), _watched(session, work, progress, len(image)):
            download(session, image, options, progress)
    except CanopenError as error:
        if progress.untouched:
            raise
        raise DriveError(interrupted_words(session, progress, error)) from error
    work.lines += progress.notes
    boot_check(session, identity)
    old, new = (f"0x{date:08X}" if date is not None else "unknown" for date in (progress.old, progress.new))
    return f"{session}: program {options.number} of {len(image)} bytes runs: {old} -> {new}"


@contextlib.contextmanager
def _watched(session: NodeSession, work: NodeJob, progress: DownloadProgress, size: int) -> Iterator[None]:
    """Report step and bytes from a separate thread while this one waits for the transfer."""
    over = threading.Event()

    def watch() -> None:
        while not over.wait(_LOOK_S):
            work.doing = progress.step.value
            if progress.step is DownloadStep.SENDING:
                done, total = session.transfers.progress()
                work.done, work.total = done, total or size
            else:
                work.done, work.total = 0, None

    thread = threading.Thread(target=watch, name="firmware progress", daemon=True)
    thread.start()
    try:
        yield
    finally:
        over.set()
        thread.join()


T = TypeVar("T")


@dataclass(slots=True)
class NodeJob:
    """Long job with its progress and result; written by its thread, read by the pages.

    `key` is the tab that it belongs to, `doing` its present step. `told` is the sentence at its end, `good` whether
    it succeeded, None until then; `lines`, `table` and `file` (name and bytes) are its further results.
    """

    key: str
    title: str
    unit: str = ""
    doing: str = ""
    done: int = 0
    total: int | None = None
    began: float = field(default_factory=time.monotonic)
    told: str = ""
    good: bool | None = None
    lines: list[str] = field(default_factory=list)
    table: list[tuple[str, ...]] = field(default_factory=list)
    file: tuple[str, bytes] | None = None
    _rated: tuple[str, float, int] = ("", 0.0, 0)
    _ending: threading.Event = field(default_factory=threading.Event)

    def at(self, done: int, total: int | None = None) -> None:
        """Report progress; DriveError if the end was requested."""
        self.done, self.total = done, total
        if self._ending.is_set():
            raise DriveError("a page asked for its end")

    def pace(self, now: float) -> tuple[float, float] | None:
        """Return the fraction per second and the remaining seconds; None if unknown."""
        part, since, before = self._rated
        if part != self.doing or self.done < before or not self.done:
            self._rated = self.doing, now, self.done
            return None
        gained, elapsed = self.done - before, now - since
        if gained <= 0 or elapsed <= 0.0 or self.total is None:
            return None
        return gained / elapsed, max(0.0, (self.total - self.done) * elapsed / gained)

    def end(self) -> None:
        """Request the end of the job at its next step."""
        self._ending.set()

    @property
    def over(self) -> bool:
        """Whether the job has ended."""
        return self.good is not None


class NodeJobs(NodeObjects):
    """Jobs of the node at `place` of the running robot `robot`; `history` are the writes of all pages."""

    def __init__(
        self, robot: str, place: NodePlace, connect: Callable[[str, float], RobotClient] = RobotClient.connect
    ) -> None:
        super().__init__(robot, place, SOURCE, connect)
        self.work: NodeJob | None = None
        self.scope: ScopeRun | None = None
        self.tuned: TuneFound | None = None
        self.history = EditHistory()
        self._editing = threading.Lock()

    async def ask(self, work: Callable[[NodeSession], T]) -> T:
        """Return the result of `work` with a session of the node, on a thread; raises its errors."""
        return await in_thread(partial(self.with_session, work))

    def with_session(self, work: Callable[[NodeSession], T]) -> T:
        """Return the result of `work` with a session of the node; blocks, for threads."""
        with self.session() as session:
            return work(session)

    # ------------------------------------------------------------------------------------ single objects

    async def write(self, entry: Entry, text: str) -> Edit:
        """Write an object from the user's text; CanopenError with the reason of a refusal."""
        return await in_thread(partial(self._edit, lambda session: self.history.write(session, entry, text)))

    async def undo(self) -> Edit:
        """Undo the newest write; CanopenError with the reason if it is not possible."""
        return await in_thread(partial(self._edit, self.history.undo))

    def _edit(self, change: Callable[[NodeSession], Edit]) -> Edit:
        if self.work is not None and not self.work.over:
            raise DriveError(f"{self.place.name} is busy: {self.work.title}; nothing was written")
        with self._editing:
            return self.with_session(change)

    # ------------------------------------------------------------------------------------ what takes long

    @property
    def busy(self) -> bool:
        """Whether a job runs."""
        return self.work is not None and not self.work.over

    def begin(self, work: NodeJob, function: Callable[[NodeSession, NodeJob], str]) -> str | None:
        """Start a job on a thread; `function` returns the final sentence. Returns the reason if it cannot start."""
        if self.work is not None and not self.work.over:
            return f"{self.place.name} is busy: {self.work.title}; wait for its end"
        self.work = work
        threading.Thread(target=self._run, args=(work, function), name=f"page {work.key}", daemon=True).start()
        return None

    def _run(self, work: NodeJob, function: Callable[[NodeSession, NodeJob], str]) -> None:
        good = False
        try:
            with self._editing:
                work.told = self.with_session(lambda session: function(session, work))
            good = True
        except CanopenError as error:
            work.told = str(error)
        except Exception as error:  # noqa: BLE001 - the page shows it and continues
            work.told = f"{work.title} ended with {type(error).__name__}: {error}"
        finally:
            work.good = good
