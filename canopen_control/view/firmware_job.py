"""The long work of the Firmware tab: checks, download with its progress, the boot check. No toolkit; on a thread."""

from __future__ import annotations

import contextlib
import threading
from typing import TYPE_CHECKING, Final

from canopen_control.errors import CanopenError, ConfigError, DriveError
from canopen_control.rpc.messages.robot import MAX_OBJECT
from canopen_control.service.guarded_restore import quiet_node
from canopen_control.service.program_download import DownloadProgress, DownloadStep, ProgramOptions
from canopen_control.service.program_session import boot_check, download, interrupted_words, is_loader, refuse_stranger
from canopen_control.service.read_parameters import device_identity

if TYPE_CHECKING:
    from collections.abc import Iterator

    from canopen_control.service.node_session import NodeSession
    from canopen_control.view.node_desk import NodeWork

__all__ = ["MOST_BYTES", "check_image", "load_program", "options_of"]

MOST_BYTES: Final = MAX_OBJECT
"""Of a program through a running robot; a longer one goes straight on the bus (`firmware --can`)."""
_LOOK_S: Final = 0.3


def options_of(number: str, expected: str) -> ProgramOptions:
    """Return the options of what a person has written; ConfigError with what it has to be."""
    try:
        program = int(number or "1", 0)
        wanted = int(expected, 0) if expected.strip() else None
    except ValueError:
        raise ConfigError(f"{number!r} and {expected!r}: a number is wanted, decimal or 0x") from None
    if not 1 <= program <= 254:
        raise ConfigError(f"program {program}: programs are 1 to 254")
    if wanted is not None and not 0 <= wanted < 1 << 32:
        raise ConfigError(f"{expected}: 0x1F56 holds 32 bits")
    return ProgramOptions(program, wanted)


def check_image(image: bytes, name: str) -> None:
    """Refuse a file that cannot be a program; ConfigError with the reason."""
    if not image:
        raise ConfigError(f"{name} is empty; nothing was sent")
    if len(image) > MOST_BYTES:
        raise ConfigError(
            f"{name} has {len(image)} bytes, a running robot passes on {MOST_BYTES}: end it with `shutdown` and use "
            "`canopen-control firmware --can`"
        )
    if image.lstrip()[:10].upper().startswith((b"[FILEINFO]", b"[DEVICEINF")):
        raise ConfigError(f"{name} is an EDS or a DCF and no program; nothing was sent")


def load_program(session: NodeSession, work: NodeWork, image: bytes, options: ProgramOptions) -> str:
    """Load a program and start it; DriveError with what the node has now where that failed."""
    identity = device_identity(session)
    refuse_stranger(session, identity)
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
    old, new = (f"0x{each:08X}" if each is not None else "unknown" for each in (progress.old, progress.new))
    return f"{session}: program {options.number} of {len(image)} bytes runs: {old} -> {new}"


@contextlib.contextmanager
def _watched(session: NodeSession, work: NodeWork, progress: DownloadProgress, size: int) -> Iterator[None]:
    """Follow step and bytes from a thread of its own, while this one waits for the transfer."""
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
