"""The journal of a restore: what a node held before, as a DCF on the disk, so that a restore that was killed is undone.

It is written before the first value is, and gone when all is proven or put back. Who finds one knows that a restore
ended half-way, by SIGKILL or with the power of the computer: the same command goes on, since only what differs is
written; to restore the journal itself puts back what the node held. What an earlier journal knows of a parameter is
older than what the node holds now, and stays.
"""

from __future__ import annotations

import shlex
from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

from canopen_control.host.files import state_dir
from canopen_control.service.kept_parameters import KeptParameters
from canopen_control.service.read_parameters import device_identity

if TYPE_CHECKING:
    from collections.abc import Mapping

    from canopen_control.od.model import Address, ObjectDictionary, Value
    from canopen_control.service.node_session import NodeSession
    from canopen_control.service.parameter_set import DeviceIdentity
    from canopen_control.service.restore import Restore

__all__ = ["Reached", "RestoreJournal", "unfinished_words"]

_FOLDER: Final = "restores"


@dataclass(frozen=True, slots=True)
class Reached:
    """How a verb reaches a node: its bus's channel, or the name of the robot; and whether it wrote all of a backup."""

    channel: str = ""
    robot: str = ""
    include_protected: bool = False


class RestoreJournal:
    """The journal of the node of `session`; `reached` is how a verb reaches the node."""

    def __init__(self, session: NodeSession, identity: DeviceIdentity, reached: Reached) -> None:
        self._session, self._reached = session, reached
        self._kept = KeptParameters(_FOLDER, session, identity, reached.channel)
        self.path = self._kept.path
        self._old = self._kept.parameters

    @property
    def unfinished(self) -> str:
        """Say that an earlier restore ended half-way and what to do; "" where none did."""
        if self._old is None:
            return ""
        return (
            f"{self._session}: a restore of {self._old.date} ended half-way: the same command again goes on; "
            f"{self.undo_words} what the node held before it"
        )

    @property
    def undo_words(self) -> str:
        """Say which command puts back what the node held before."""
        return f"`canopen-control restore {shlex.join([str(self.path), *self._words()])}` puts back"

    def begin(self, od: ObjectDictionary, held: Mapping[Address, Value]) -> None:
        """Keep what the node holds before it is written; ConfigError where that cannot be, and nothing is written."""
        old = {} if self._old is None else self._old.values
        self._kept.keep(od, {**held, **old})

    def end(self, restore: Restore) -> None:
        """Forget what was proven or put back; what an earlier restore wrote beside that is kept."""
        if restore.refused and restore.undone:
            kept: Mapping[Address, Value] = {} if self._old is None else self._old.values
        else:
            old = {} if self._old is None else self._old.values
            kept = {address: value for address, value in old.items() if address not in restore.wanted}
        if kept:
            self._kept.keep(restore.od, kept)
        else:
            self._kept.forget()
            self._old = None

    def _words(self) -> list[str]:
        how, node = self._reached, str(self._session.name or self._session.node_id)
        found = [node, *(["--can", how.channel] if how.channel else ["--name", how.robot] if how.robot else [])]
        return [*found, *(["--include-protected"] if how.include_protected else [])]


def unfinished_words(session: NodeSession, reached: Reached) -> str:
    """Say that a restore of a node ended half-way, "" where none did; the node is asked who it is if it may be so."""
    if not any(state_dir(_FOLDER).glob(f"node{session.node_id}-*.dcf")):
        return ""
    return RestoreJournal(session, device_identity(session), reached).unfinished
