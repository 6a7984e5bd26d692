"""Program download to a node: the sequence of CiA 302-3, as in the tools of CANopenNode, Lely and Zephyr.

Sans-IO: `program_download` is a generator that yields actions (read, write, pause, pre-operational) and is sent their
results. A write to 0x1F51 may or may not be answered, and a boot-up may follow, since the node resets into its
boot-loader and out of it; only the later values of 0x1F51, 0x1F57 and 0x1F56 count. An interrupted transfer starts
again with a clear, from the first byte: no known device can resume.
"""

from __future__ import annotations

import contextlib
import datetime
import enum
import zlib
from collections.abc import Generator
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Final, TypeAlias

from canopen_control.cia301.nmt import NmtCommand
from canopen_control.client.robot_client import periodic_call
from canopen_control.commissioning.identity import FIELDS
from canopen_control.commissioning.jobs import ProgramDate
from canopen_control.commissioning.node_session import is_abort
from canopen_control.commissioning.parameter_set import reason_of
from canopen_control.commissioning.restore import quiet_node
from canopen_control.errors import CanopenError, ConfigError, DriveError, RemoteError, SdoRestarted, SdoTimeout
from canopen_control.od.indices import FLASH_STATUS, PROGRAM_CONTROL, PROGRAM_DATA, PROGRAM_ID, SOFTWARE_DATE

if TYPE_CHECKING:
    from collections.abc import Iterator

    from canopen_control.commissioning.identity import DeviceIdentity
    from canopen_control.commissioning.jobs import JobRun, ProgramOptions
    from canopen_control.commissioning.node_session import NodeSession


STOP, START, CLEAR, CONFIRM = 0, 1, 3, 0x80  # values of 0x1F51 (CiA 302-3); 0x80 confirms a program on trial in Zephyr
_STOPPED: Final = (STOP, CLEAR)
_RESETTING: Final = (STOP, START)  # commands at which a node may reset
_BUSY_S: Final = 30.0  # maximum time to erase or write a flash
_POLL_S: Final = 0.1
_FIRST_POLL_S: Final = 0.01  # delay before the first poll of a flash; it doubles each time
_NO_STATUS_S: Final = 1.0  # pause for a flash without a busy bit (no 0x1F57)
_SILENCE_S: Final = 1.0  # time lost by a missing answer
_QUICK_S: Final = 0.15  # timeout while a node may be resetting: some boot-loaders wait for only 0.5 s
_QUICK_ROUNDS: Final = 4  # every fourth attempt has the normal timeout
_FLASH_S: Final = 10.0  # timeout of a node that erases or writes its flash before it answers
_DEVICE_FILE: Final = b"[fileinfo]"  # section of every EDS and DCF (CiA 306-1)
_TEXT: Final = (b"[", b";")  # first characters of an EDS or DCF
_EPOCH: Final = datetime.date(1984, 1, 1)  # day 0 of 0x1F52, as of 0x1020 (CiA 301, 7.5.2.23)
_DAY_MS: Final = 86_400_000
_REPORT_S: Final = 0.2  # interval of progress reports
_SILENT: Final = -1  # instead of a number if the node is silent; bit 0 of it means busy in 0x1F57
# bits 1 to 7 of 0x1F57 (CiA 302-3)
_ERRORS: Final = {
    1: "no valid program",
    2: "unknown data format",
    3: "format or CRC error",
    4: "the program was not cleared before",
    5: "flash write error",
    6: "address error",
    7: "the flash is secured",
    63: "unspecified error",
}


class DownloadStep(enum.Enum):
    """Steps of a download; the values are texts for users."""

    ASKING = "reading the present program"
    STOPPING = "stopping the program"
    CLEARING = "clearing the program"
    SENDING = "sending"
    CHECKING = "waiting for the flash"
    STARTING = "starting the program"
    CONFIRMING = "confirming the program"
    DONE = "done"


class DownloadAct(enum.Enum):
    """Kinds of actions that the generator requests."""

    READ = "read"
    WRITE = "write"
    PAUSE = "pause"
    PRE_OPERATIONAL = "pre-operational"


@dataclass(frozen=True, slots=True)
class DownloadOrder:
    """Requested action: read or write of an object, pause of `seconds`, or NMT pre-operational.

    For a read or write, `seconds` is the timeout of an answer; 0 means the default.
    """

    act: DownloadAct
    index: int = 0
    subindex: int = 0
    data: bytes = b""
    seconds: float = 0.0


@dataclass(frozen=True, slots=True)
class DownloadAnswer:
    """Result of an action: the data read, or the error of an abort or a timeout."""

    data: bytes = b""
    error: CanopenError | None = None


@dataclass(slots=True)
class DownloadProgress:
    """Progress of a download: step, and 0x1F56 and 0x1F52 before and after (None if missing)."""

    step: DownloadStep = DownloadStep.ASKING
    old: int | None = None
    new: int | None = None
    old_date: ProgramDate | None = None
    new_date: ProgramDate | None = None
    tries: int = 0
    notes: list[str] = field(default_factory=list)

    @property
    def untouched(self) -> bool:
        """Whether nothing has been written yet, or the download is complete."""
        return self.step in (DownloadStep.ASKING, DownloadStep.DONE)


Sequence: TypeAlias = Generator[DownloadOrder, DownloadAnswer, None]
Numbers: TypeAlias = Generator[DownloadOrder, DownloadAnswer, "int | None"]


def flash_text(status: int) -> str:
    """Return the status in 0x1F57 as text: "busy", an error, or ""."""
    if status & 1:
        return "busy"
    code = status >> 1 & 0x7F
    if not code:
        return ""
    suffix = f" of the manufacturer (0x{status >> 16:04X})" if code > 63 else ""
    return _ERRORS.get(code, f"error {code}{suffix}")


def refuse_no_program(image: bytes, name: str = "the program file") -> None:
    """Raise ConfigError for an empty file, and for an EDS or DCF."""
    if not image:
        raise ConfigError(f"{name} is empty; nothing was sent")
    if image.lstrip()[:1] in _TEXT and _DEVICE_FILE in image[:4096].lower():  # a program may have an EDS inside
        raise ConfigError(f"{name} is an EDS or DCF, not a program; nothing was sent")


def program_download(image: bytes, options: ProgramOptions, progress: DownloadProgress) -> Sequence:
    """Yield the actions of a download, receive their results, and update `progress`.

    Raise ConfigError if the node has no program download or the image is not a program, DriveError if a download fails.
    """
    refuse_no_program(image)
    number = options.number
    yield from _read_present(number, progress)
    yield DownloadOrder(DownloadAct.PRE_OPERATIONAL)
    while True:
        progress.tries += 1
        yield from _prepare(number, progress, options)
        progress.step = DownloadStep.SENDING
        outcome = yield DownloadOrder(DownloadAct.WRITE, PROGRAM_DATA, number, image, _FLASH_S)
        progress.step = DownloadStep.CHECKING
        if outcome.error is None:
            why = yield from _flash(number)
        else:
            why = reason_of(outcome.error)
            if is_abort(outcome.error) and (status := (yield from _number(FLASH_STATUS, number))) and status != _SILENT:
                why += f", flash: {flash_text(status)}"
        if not why:
            break
        if progress.tries >= options.tries:
            raise DriveError(
                f"the program was not accepted: {why}; the node has no program now and stays in its boot-loader"
            )
        progress.notes.append(f"started again: {why}")
    yield from _verify(image, number, options, progress)
    yield from _run(number, options, progress)
    yield from _verify_date(options, progress)
    progress.step = DownloadStep.DONE


def _read_present(number: int, progress: DownloadProgress) -> Sequence:
    progress.step = DownloadStep.ASKING
    outcome = yield DownloadOrder(DownloadAct.READ, PROGRAM_CONTROL, number)
    if outcome.error is not None:
        if not is_abort(outcome.error):
            raise outcome.error
        raise ConfigError(
            f"program {number} of the node cannot be loaded over CANopen: 0x1F51:{number:02X}: "
            f"{reason_of(outcome.error)}; use the manufacturer's tool"
        )
    progress.old = yield from _number(PROGRAM_ID, number)
    progress.old_date = yield from _date()


def _prepare(number: int, progress: DownloadProgress, options: ProgramOptions) -> Sequence:
    """Stop and clear the program; raise DriveError if 0x1F51 or 0x1F57 does not confirm this."""
    progress.step = DownloadStep.STOPPING
    status = yield from _number(PROGRAM_CONTROL, number)
    if status != STOP:
        yield from _command(number, STOP, _STOPPED, options.start_s, "does not stop")
    yield DownloadOrder(DownloadAct.PRE_OPERATIONAL)  # the boot-loader may have booted meanwhile
    progress.step = DownloadStep.CLEARING
    yield from _command(number, CLEAR, (CLEAR,), options.start_s, "is not cleared")
    why = yield from _flash(number)
    if why:
        raise DriveError(f"the program was not cleared: {why}")


def _command(number: int, command: int, expected: tuple[int, ...], seconds: float, words: str) -> Sequence:
    """Write 0x1F51 until it shows an expected state; raise DriveError with `words` after `seconds`.

    While a node resets, short timeouts are used: a boot-loader that sees no master starts the program again.
    """
    refusal, rounds, status = "", 0, None
    while seconds > 0.0:
        rounds += 1
        soon = 0.0 if command not in _RESETTING or rounds % _QUICK_ROUNDS == 0 else _QUICK_S
        timeout = _FLASH_S if command == CLEAR else soon
        outcome = yield DownloadOrder(DownloadAct.WRITE, PROGRAM_CONTROL, number, bytes((command,)), timeout)
        if outcome.error is not None and is_abort(outcome.error):
            refusal = reason_of(outcome.error)
            yield DownloadOrder(DownloadAct.PRE_OPERATIONAL)
        elif outcome.error is not None:
            seconds -= timeout or _SILENCE_S
        yield DownloadOrder(DownloadAct.PAUSE, seconds=_POLL_S)
        status = yield from _number(PROGRAM_CONTROL, number, soon)
        if status in expected:
            return
        if refusal and (command, status) == (STOP, CONFIRM):
            raise DriveError(
                f"the running program is on trial and does not allow another download "
                f"(0x1F51:{number:02X} is 0x80, {refusal}): "
                f"make it permanent with `canopen-control sdo write NODE 1F51:{number} 0x80 --type u8`, or reset the "
                "node, which restores the previous program"
            )
        seconds -= _POLL_S + ((soon or _SILENCE_S) if status == _SILENT else 0.0)
    why = f": {refusal}" if refusal else ", and the node does not answer" if status == _SILENT else ""
    raise DriveError(f"the program {words} (0x1F51 <- {command}){why}")


def _flash(number: int) -> Generator[DownloadOrder, DownloadAnswer, str]:
    """Wait until the flash is not busy; return its error as text, or "" without an error or without 0x1F57."""
    seconds, pause = _BUSY_S, _FIRST_POLL_S
    while seconds > 0.0:
        status = yield from _number(FLASH_STATUS, number)
        if status is None:
            yield DownloadOrder(DownloadAct.PAUSE, seconds=_NO_STATUS_S)
            return ""
        if not status & 1:  # bit 0 of 0x1F57: in progress
            return flash_text(status)
        yield DownloadOrder(DownloadAct.PAUSE, seconds=pause)
        seconds -= pause + (_SILENCE_S if status == _SILENT else 0.0)
        pause = min(2.0 * pause, _POLL_S)
    return "the flash stays busy, or the node does not answer"


def _verify(image: bytes, number: int, options: ProgramOptions, progress: DownloadProgress) -> Sequence:
    progress.new = yield from _number(PROGRAM_ID, number)
    progress.new = None if progress.new == _SILENT else progress.new
    if options.expected is not None and progress.new != options.expected:
        shown = "nothing" if progress.new is None else f"0x{progress.new:08X}"
        raise DriveError(
            f"the node identifies its new program as {shown} (0x1F56), 0x{options.expected:08X} was expected; "
            "it was not started"
        )
    if progress.new is not None and progress.new == zlib.crc32(image):
        progress.notes.append("0x1F56 is the CRC-32 of the file")


def _run(number: int, options: ProgramOptions, progress: DownloadProgress) -> Sequence:
    progress.step = DownloadStep.STARTING
    yield from _command(number, START, (START, CONFIRM), options.start_s, "does not start")
    if options.confirm:
        progress.step = DownloadStep.CONFIRMING
        yield DownloadOrder(DownloadAct.PRE_OPERATIONAL)
        yield from _command(number, CONFIRM, (START,), options.start_s, "does not become permanent")


def _verify_date(options: ProgramOptions, progress: DownloadProgress) -> Sequence:
    """Check the date reported by the started program; raise DriveError if the date is unexpected."""
    progress.new_date = yield from _date()
    expected = options.expected_date
    if expected is not None and not expected.fits(progress.new_date):
        shown = "no date" if progress.new_date is None else str(progress.new_date)
        raise DriveError(f"the program runs, and reports {shown} (0x1F52); {expected} was expected")


def _date() -> Generator[DownloadOrder, DownloadAnswer, ProgramDate | None]:
    """Read the date of the program from 0x1F52, or return None if it is missing or invalid."""
    days = yield from _number(SOFTWARE_DATE, 1)
    if not days or not 0 < days <= 0xFFFF:
        return None
    milliseconds = yield from _number(SOFTWARE_DATE, 2)
    is_set = milliseconds is not None and 0 <= milliseconds < _DAY_MS
    return ProgramDate(_EPOCH + datetime.timedelta(days=days), milliseconds if is_set else None)


def _number(index: int, subindex: int, seconds: float = 0.0) -> Numbers:
    """Read and return a number, None if the node aborts, or `_SILENT` if it does not respond."""
    outcome = yield DownloadOrder(DownloadAct.READ, index, subindex, seconds=seconds)
    if outcome.error is not None:
        return None if is_abort(outcome.error) else _SILENT
    return int.from_bytes(outcome.data, "little")


# Execution of a program download through a service session, with checks of the node before and after.


_VENDOR: Final = FIELDS["vendor_id"][1]


def is_loader(identity: DeviceIdentity) -> bool:
    """Whether the node runs its boot-loader, whose device type (0x1000) names no profile."""
    return not (identity.device_type or 0) & 0xFFFF


def refuse_other_product(session: NodeSession, identity: DeviceIdentity) -> None:
    """Raise ConfigError if the node is not the product of its EDS; for a boot-loader the vendor is sufficient."""
    if session.od is None:
        return
    differences = session.identity_differences()
    if is_loader(identity):
        differences = [difference for difference in differences if difference.startswith(_VENDOR)]
    if differences:
        raise ConfigError(
            f"{session} does not match its EDS: {', '.join(differences)}; nothing was sent; for a boot-loader "
            "with an identity of its own, omit --eds"
        )


def download(session: NodeSession, image: bytes, options: ProgramOptions, progress: DownloadProgress) -> None:
    """Load a program into the node and start it; raise the errors of `program_download`, or BusError."""
    sequence = program_download(image, options, progress)
    outcome: DownloadAnswer | None = None
    while True:
        try:
            order = next(sequence) if outcome is None else sequence.send(outcome)
        except StopIteration:
            return
        outcome = _carry_out(session, order)


@dataclass(frozen=True, slots=True)
class ProgramReport:
    """Result of a download: 0x1F56 and 0x1F52 (as dates) before and after; None if the node lacks the object."""

    node_id: int
    program: int
    bytes: int
    old: int | None
    new: int | None
    old_date: str | None
    new_date: str | None
    tries: int
    notes: list[str]


def load_program(session: NodeSession, run: JobRun, image: bytes, options: ProgramOptions) -> str:
    """Load a program, start it and check that it runs; a DriveError names the failed step."""
    identity = session.identity()
    refuse_other_product(session, identity)
    if is_loader(identity):
        run.note(f"{session} is in its boot-loader")
    progress = DownloadProgress()
    try:
        with quiet_node(session, starts_again=False), _watched(session, run, progress, len(image)):
            download(session, image, options, progress)
    except (CanopenError, KeyboardInterrupt) as error:
        if progress.untouched:
            raise
        raise DriveError(interrupted_words(session, progress, error)) from error
    boot_check(session, identity)
    run.lines += [f"{session}: {note}" for note in progress.notes]
    old_date, new_date = (None if date is None else str(date) for date in (progress.old_date, progress.new_date))
    run.document = ProgramReport(
        session.node_id,
        options.number,
        len(image),
        progress.old,
        progress.new,
        old_date,
        new_date,
        progress.tries,
        progress.notes,
    )
    old, new = _program_text(progress.old, old_date), _program_text(progress.new, new_date)
    return f"{session}: program {options.number} of {len(image)} bytes runs: {old} -> {new}"


def _program_text(number: int | None, date: str | None) -> str:
    value = "unknown" if number is None else f"0x{number:08X}"
    return value if date is None else f"{value} of {date}"


@contextlib.contextmanager
def _watched(session: NodeSession, run: JobRun, progress: DownloadProgress, size: int) -> Iterator[None]:
    """Context with a thread that reports the step and the bytes of the transfer to the run."""

    def report() -> None:
        if run.doing != progress.step.value:
            run.part(progress.step.value, "bytes")
        if progress.step is DownloadStep.SENDING:
            done, total = session.transfers.progress()
            run.show(done, total or size)

    with periodic_call(report, _REPORT_S, name="firmware progress"):
        yield


def interrupted_words(session: NodeSession, progress: DownloadProgress, error: BaseException) -> str:
    """Return a text with the failed step of a download, the reason and the remedy."""
    reason = str(error) or "interrupted"
    warning = "" if isinstance(error, DriveError) else "the old program may be gone: "
    return f"{session}: {progress.step.value}: {reason}; {warning}repeat the command to start again"


def _carry_out(session: NodeSession, order: DownloadOrder) -> DownloadAnswer:
    try:
        if order.act in (DownloadAct.READ, DownloadAct.WRITE):
            return DownloadAnswer(_transferred(session, order))
        if order.act is DownloadAct.PAUSE:
            session.transfers.pause(order.seconds)
        elif not session.robot:  # in a robot, the node was taken out and is PRE-OPERATIONAL already
            session.transfers.command(NmtCommand.ENTER_PRE_OPERATIONAL)
    except CanopenError as error:
        if not _is_answer(error):
            raise
        return DownloadAnswer(error=error)
    return DownloadAnswer()


def _transferred(session: NodeSession, order: DownloadOrder) -> bytes:
    """Read or write an object with the order's timeout (0: default); return the data read."""
    session.transfers.set_timeout(order.seconds or None)
    try:
        if order.act is DownloadAct.READ:
            return session.read(order.index, order.subindex)
        session.write(order.index, order.subindex, order.data)
        return b""
    finally:
        session.transfers.set_timeout(None)


def _is_answer(error: CanopenError) -> bool:
    """Whether an error comes from the node (abort, timeout or restart) and not from the bus or the robot."""
    kinds = (SdoTimeout, SdoRestarted, DriveError)
    is_timeout = isinstance(error, RemoteError) and error.kind in (SdoTimeout.__name__, SdoRestarted.__name__)
    return is_timeout or isinstance(error, kinds) or is_abort(error)


def boot_check(session: NodeSession, before: DeviceIdentity) -> DeviceIdentity:
    """Return the identity of the new program; raise DriveError for a boot-loader or another product than `before`."""
    after = session.identity()
    if is_loader(after):
        raise DriveError(f"{session}: the new program does not run: the node is in its boot-loader")
    if not is_loader(before) and (strangers := before.strangers(after)):
        raise DriveError(f"{session} is another product with the new program: {', '.join(strangers)}")
    return after
