"""Writes parameters into a node and proves that it holds them, or puts back what it held.

What the node holds is read first; only what differs is written, in the order of `restore_order`. What it refuses is
tried once more after all others (an object may depend on one that came later), then everything is read back: a value
that the drive changed on its way in counts as refused. Where anything was refused, what was written is undone, unless
the caller keeps it; so a refusal leaves the drive as it was. Nothing is stored but by `store`.
"""

from __future__ import annotations

import enum
import time
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Final

from canopen_control.errors import CanopenError, ConfigError, DriveError, SdoTimeout
from canopen_control.service.node_session import is_abort
from canopen_control.service.parameter_diff import value_text
from canopen_control.service.parameter_set import same_value
from canopen_control.service.read_parameters import entry_label, read_values, reason_of
from canopen_control.service.restore_order import restore_groups

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping

    from canopen_control.od.model import Address, ObjectDictionary, Value
    from canopen_control.service.node_session import NodeSession
    from canopen_control.service.parameter_set import DeviceIdentity, ParameterSet
    from canopen_control.service.restore_order import RestoreGroup

    Told = Callable[[int, int], None]

__all__ = ["Restore", "RestoreStep", "check_device", "refuse_moving", "store"]

SAVE: Final = b"save"
_STORE: Final = (0x1010, 1)
_STORE_S: Final = 15.0  # what writing a flash may take
_POLL_S: Final = 0.2


class RestoreStep(enum.Enum):
    """How far a restore is."""

    READING = "reading what the drive holds"
    WRITING = "writing"
    VERIFYING = "reading back"
    UNDOING = "putting back what the drive held"
    DONE = "done"


def check_device(parameters: ParameterSet, identity: DeviceIdentity, session: NodeSession) -> list[str]:
    """Return in what revision and software differ; ConfigError for another product, which takes nothing."""
    if strangers := parameters.identity.strangers(identity):
        raise ConfigError(
            f"{parameters.where} is of another product than {session}: {', '.join(strangers)}; nothing was written"
        )
    return parameters.identity.variations(identity)


def refuse_moving(session: NodeSession) -> None:
    """Raise DriveError where an axis has, or may have, torque: nothing is written into a drive that may move."""
    if powered := session.powered_axes():
        axes = "" if powered == [0] else f" (axis {', '.join(map(str, powered))})"
        raise DriveError(f"{session} is enabled{axes}; nothing was written: disable it first, `axis disable`")


@dataclass(slots=True)
class Restore:
    """One restore of `wanted` into the node of `session`, whose objects have the types of `od`.

    `keep_held` is called with what the node holds before the first write, and may refuse. `run` may end with an error
    of the bus or the node in the middle; `step`, `written` and `planned` then say how far it was. `verified` are the
    parameters that were proven to be as wanted, `undone`: all that was written is as before.
    """

    session: NodeSession
    od: ObjectDictionary
    wanted: Mapping[Address, Value]
    told: Told | None = None
    keep_held: Callable[[Mapping[Address, Value]], None] | None = None
    step: RestoreStep = RestoreStep.READING
    held: dict[Address, Value] = field(default_factory=dict)
    planned: int = 0
    written: list[str] = field(default_factory=list)
    refused: list[str] = field(default_factory=list)
    verified: int = 0
    undone: bool = False

    def run(self, *, keep: bool = False) -> bool:
        """Write and prove; return whether all is as wanted. With `keep` what was taken stays where some was not."""
        entries = [self.od[address] for address in self.wanted]
        self.held, left_out = read_values(self.session, entries)
        self.refused = list(map(str, left_out))
        if self.refused and not keep:
            self.undone, self.step = True, RestoreStep.DONE  # nothing was written yet
            return False
        groups = restore_groups(self.od, self.wanted, self.held)
        if groups and self.keep_held is not None:
            self.keep_held(self.held)
        self.step = RestoreStep.WRITING
        failed = self._write(groups)
        self._prove({group.name: why for group, why in failed})
        if self.refused and not keep and self.written:
            self._undo()
        self.step = RestoreStep.DONE
        return not self.refused

    def _write(self, groups: list[RestoreGroup]) -> list[tuple[RestoreGroup, str]]:
        """Write the groups, and once more those that were refused; return what was refused twice."""
        self.planned = len(groups)
        failed: list[tuple[RestoreGroup, str]] = []
        for _ in range(2):
            failed = []
            for group in groups:
                if (why := self._write_group(group)) is None:
                    self.written.append(group.name)
                else:
                    failed.append((group, why))
                if self.told is not None:
                    self.told(len(self.written), self.planned)
            groups = [group for group, _ in failed]
        return failed

    def _write_group(self, group: RestoreGroup) -> str | None:
        """Write a group; return why the node refused it. A PDO whose mapping was refused is left invalid."""
        for write in group.writes:
            try:
                self.session.write(*write.address, write.data)
            except CanopenError as error:
                if not is_abort(error):
                    raise
                return reason_of(error)
        return None

    def _prove(self, failed: Mapping[str, str]) -> None:
        """Read everything back: what is not as wanted was refused, or changed by the drive."""
        self.step = RestoreStep.VERIFYING
        found, left_out = read_values(self.session, [self.od[address] for address in self.held])
        self.refused += [f"{name}: {why}" for name, why in failed.items()]
        self.refused += map(str, left_out)
        for address, value in found.items():
            entry, wanted = self.od[address], self.wanted[address]
            if same_value(entry, wanted, value):
                self.verified += 1
                continue
            name = entry_label(entry)
            if name not in failed:
                asked, has = value_text(entry, wanted), value_text(entry, value)
                self.refused.append(f"{name}: asked {asked}, the drive has {has}")

    def _undo(self) -> None:
        """Put back what the drive held before."""
        self.step = RestoreStep.UNDOING
        now, _ = read_values(self.session, [self.od[address] for address in self.held])
        for group in restore_groups(self.od, self.held, now):
            self._write_group(group)
        after, _ = read_values(self.session, [self.od[address] for address in self.held])
        left = [address for address, value in self.held.items()
                if address not in after or not same_value(self.od[address], value, after[address])]  # fmt: skip
        self.undone = not left
        self.refused += [f"{entry_label(self.od[address])}: could not be put back" for address in left]


def store(session: NodeSession, *, pause: Callable[[float], None] = time.sleep) -> None:
    """Store all parameters (0x1010:01 with its signature), and wait until the drive answers again.

    A drive that writes its flash may be silent meanwhile. ConfigError for one that cannot store, else what it answers.
    """
    if _STORE not in session.dictionary:
        raise ConfigError(f"{session} has no 0x1010:01, so it cannot store; the values are lost with the power")
    try:
        session.write(*_STORE, SAVE)
    except SdoTimeout:
        _wait_for_answer(session, pause)


def _wait_for_answer(session: NodeSession, pause: Callable[[float], None]) -> None:
    for _ in range(round(_STORE_S / _POLL_S)):
        pause(_POLL_S)
        try:
            session.read(*_STORE)
        except SdoTimeout:
            continue
        return
    raise DriveError(f"{session}: no answer {_STORE_S:g} s after it was told to store; do not switch it off yet")
