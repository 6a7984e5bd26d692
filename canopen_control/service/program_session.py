"""Drives a program download through a service session, and judges the node before and after it."""

from __future__ import annotations

import time
from typing import TYPE_CHECKING, Final

from canopen_control.cia301.nmt import NmtCommand
from canopen_control.errors import CanopenError, ConfigError, DriveError, RemoteError, SdoRestarted, SdoTimeout
from canopen_control.service.node_session import IDENTITY, is_abort
from canopen_control.service.program_download import Act, Order, Outcome, ProgramOptions, program_download
from canopen_control.service.read_parameters import device_identity

if TYPE_CHECKING:
    from collections.abc import Callable

    from canopen_control.service.node_session import NodeSession
    from canopen_control.service.parameter_set import DeviceIdentity
    from canopen_control.service.program_download import DownloadProgress

__all__ = ["boot_check", "download", "interrupted_words", "is_loader", "refuse_stranger"]

_PROFILE: Final = 0xFFFF
_VENDOR: Final = IDENTITY[0][0]


def is_loader(identity: DeviceIdentity) -> bool:
    """Whether the node shows its boot-loader: a device without a profile (0x1000)."""
    return not (identity.device_type or 0) & _PROFILE


def refuse_stranger(session: NodeSession, identity: DeviceIdentity) -> None:
    """Raise ConfigError where the node is another product than its EDS; a boot-loader may have a code of its own."""
    if session.od is None:
        return
    differences = session.identity_differences()
    if is_loader(identity):
        differences = [each for each in differences if each.startswith(_VENDOR)]
    if differences:
        raise ConfigError(
            f"{session} is no device of that EDS: {', '.join(differences)}; nothing was sent; of a boot-loader with an "
            "identity of its own that is known to be the drive's, leave --eds out"
        )


def download(
    session: NodeSession,
    image: bytes,
    options: ProgramOptions,
    progress: DownloadProgress,
    *,
    pause: Callable[[float], None] = time.sleep,
) -> None:
    """Load a program into the node and start it; errors of the bus are raised as they are, see `program_download`."""
    sequence = program_download(image, options, progress)
    outcome: Outcome | None = None
    while True:
        try:
            order = next(sequence) if outcome is None else sequence.send(outcome)
        except StopIteration:
            return
        outcome = _carry_out(session, order, pause)


def interrupted_words(session: NodeSession, progress: DownloadProgress, error: BaseException) -> str:
    """Say how far a download was that has ended half-way, and what to do next."""
    reason = str(error) or "interrupted"
    gone = "" if isinstance(error, DriveError) else "the old program may be gone: "
    return f"{session}: {progress.step.value}: {reason}; {gone}the same command begins anew"


def _carry_out(session: NodeSession, order: Order, pause: Callable[[float], None]) -> Outcome:
    try:
        if order.act in (Act.READ, Act.WRITE):
            return Outcome(_transferred(session, order))
        if order.act is Act.PAUSE:
            pause(order.seconds)
        elif not session.robot:  # whose robot it is has taken it out of operation
            session.transfers.command(NmtCommand.ENTER_PRE_OPERATIONAL)
    except CanopenError as error:
        if not _is_answer(error):
            raise
        return Outcome(error=error)
    return Outcome()


def _transferred(session: NodeSession, order: Order) -> bytes:
    """Read or write, and return what was read; each answer may take the time of the order, if it has one."""
    session.transfers.be_patient(order.seconds or None)
    try:
        if order.act is Act.READ:
            return session.read(order.index, order.subindex)
        session.write(order.index, order.subindex, order.data)
        return b""
    finally:
        session.transfers.be_patient(None)


def _is_answer(error: CanopenError) -> bool:
    """Whether the node has refused, was silent or has restarted; what is left is the bus or the robot."""
    kinds = (SdoTimeout, SdoRestarted, DriveError)
    told = isinstance(error, RemoteError) and error.kind in (SdoTimeout.__name__, SdoRestarted.__name__)
    return told or isinstance(error, kinds) or is_abort(error)


def boot_check(session: NodeSession, before: DeviceIdentity) -> DeviceIdentity:
    """Return who the node is with its new program; DriveError where that is the boot-loader still, or a stranger."""
    after = device_identity(session)
    if is_loader(after):
        raise DriveError(f"{session}: the new program does not run: the node shows its boot-loader")
    if not is_loader(before) and (strangers := before.strangers(after)):
        raise DriveError(f"{session} is another product with the new program: {', '.join(strangers)}")
    return after
