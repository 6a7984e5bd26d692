"""Writing of parameters to a node with verification; after a refusal the previous values are restored.

The present values are read first; only different ones are written, in an order that devices accept. A refused parameter
is written once more after all others, because it may depend on a later one. Then everything is read back: a value that
the drive has changed counts as refused. If anything was refused, the written values are undone unless the caller keeps
them, so that a refusal leaves the drive unchanged. Only `store` writes to the non-volatile memory.
"""

from __future__ import annotations

import contextlib
import enum
import fnmatch
import os
import re
import shlex
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Final

from canopen_control.cia301.nmt import NmtCommand, NmtState
from canopen_control.cia301.pdo import INVALID_BIT, NO_RTR_BIT
from canopen_control.cia402 import objects as o
from canopen_control.commissioning.node_session import is_abort
from canopen_control.commissioning.parameter_set import (
    ParameterSet,
    entry_label,
    kept_text,
    protection_of,
    read_backup,
    read_values,
    reason_of,
    same_value,
    value_text,
)
from canopen_control.errors import CanopenError, ConfigError, DiskFull, DriveError, SdoTimeout
from canopen_control.host.files import space_advice, state_dir, write_whole
from canopen_control.od.codec import encode
from canopen_control.od.pdos import COMMUNICATION, MAPPING, pdo_of

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Mapping, Sequence

    from canopen_control.commissioning.identity import DeviceIdentity
    from canopen_control.commissioning.jobs import Reached, RestoreOptions
    from canopen_control.commissioning.node_session import NodeSession
    from canopen_control.od.model import Address, Entry, ObjectDictionary, Value

    ProgressCallback = Callable[[int, int], None]


# Order of writing parameters, so that a device accepts them (CiA 301, 7.5.2.35 to 38; CiA 402).
#
# Objects on which others depend come first: communication, then the PDOs one after the other, the resolution of units,
# the motor, limits, ramps, gains, the rest by index, the mode of operation, and finally 0x1020. Of a pair of limits,
# the limit that widens the range comes first. A PDO is made invalid before it is changed, its count is 0 while its
# entries are written, and it becomes valid last, if at all; bit 30 of its COB-ID stays as the device has it.


_PDOS: Final = 1
_OTHERS: Final = 7
_RANKS: Final[dict[int, tuple[int, ...]]] = {
    0: (*range(0x1000, 0x1400),),
    2: (0x2000, 0x2001, 0x208C, *range(0x608F, 0x6098), o.POLARITY, *range(0x60A8, 0x60AC)),
    3: (*range(0x2002, 0x208C), *range(0x208D, 0x6000), o.MAX_CURRENT, o.MOTOR_RATED_CURRENT, o.MOTOR_RATED_TORQUE),
    4: (
        *(o.MAX_MOTOR_SPEED, o.MAX_PROFILE_VELOCITY, o.MAX_ACCELERATION, o.MAX_DECELERATION, o.MAX_TORQUE),
        *(o.POSITIVE_TORQUE_LIMIT, o.NEGATIVE_TORQUE_LIMIT, o.POSITION_RANGE_LIMIT, o.SOFTWARE_POSITION_LIMIT),
    ),
    5: (0x6007, *range(0x605A, 0x6060), *range(0x6065, 0x6071), *range(0x6081, 0x6089), *range(0x6098, 0x609B)),
    6: (0x60F6, 0x60F9, 0x60FB),
    8: (o.MODES_OF_OPERATION,),
    9: (0x1020,),
}
_RANK_OF: Final = {index: rank for rank, indices in _RANKS.items() for index in indices}
_PAIRS: Final = frozenset((o.POSITION_RANGE_LIMIT, o.SOFTWARE_POSITION_LIMIT))  # subindex 1 the least, 2 the greatest
_COB_ID: Final = 1


@dataclass(frozen=True, slots=True)
class Write:
    """A single SDO download."""

    address: Address
    data: bytes


@dataclass(frozen=True, slots=True)
class RestoreGroup:
    """Writes of one parameter or of one PDO; `name` is for messages."""

    name: str
    writes: tuple[Write, ...]


def restore_groups(
    od: ObjectDictionary, target: Mapping[Address, Value], current: Mapping[Address, Value]
) -> list[RestoreGroup]:
    """Return the writes, in order, that change a device from `current` to `target`.

    Both mappings contain parameters of `od`; an address that `current` lacks is not written.
    """
    common = {address: value for address, value in target.items() if address in current}
    changed = {
        address: value for address, value in common.items() if not same_value(od[address], value, current[address])
    }
    groups: list[tuple[tuple[int, int, int], RestoreGroup]] = []
    for kind, number in {pdo for index, _ in changed if (pdo := pdo_of(index)) is not None}:
        writes = tuple(_pdo_writes(od, kind, number, common, current))
        place = _PDOS, COMMUNICATION[kind] + number, 0
        groups.append((place, RestoreGroup(f"{kind.upper()} {number}", writes)))
    for address, value in changed.items():
        if pdo_of(address[0]) is None:
            entry = od[address]
            write = Write(address, encode(value, entry.data_type))
            groups.append((_place(address, common, current), RestoreGroup(entry_label(entry), (write,))))
    return [group for _, group in sorted(groups, key=lambda item: item[0])]


def _place(address: Address, target: Mapping[Address, Value], current: Mapping[Address, Value]) -> tuple[int, int, int]:
    """Return the sort key of a parameter: rank, index, and subindex, negated if the upper limit comes first."""
    index, subindex = address
    base, _ = o.axis_of(index)
    if base in _PAIRS:
        new, old = target.get((index, 2)), current.get((index, 2))
        widens = isinstance(new, int) and isinstance(old, int) and new > old
        subindex = -subindex if widens else subindex
    return _RANK_OF.get(base, _OTHERS), index, subindex


def _pdo_writes(
    od: ObjectDictionary, kind: str, number: int, planned: Mapping[Address, Value], current: Mapping[Address, Value]
) -> Iterator[Write]:
    """Yield the writes of one PDO: invalid COB-ID, settings, count 0, entries, count, and the final COB-ID."""
    communication, mapping = COMMUNICATION[kind] + number - 1, MAPPING[kind] + number - 1
    cob_id = communication, _COB_ID
    present = current.get(cob_id)
    can_switch = cob_id in planned and isinstance(present, int)

    def put(address: Address, value: Value) -> Write:
        return Write(address, encode(value, od[address].data_type))

    def differs(address: Address) -> bool:
        return not same_value(od[address], planned[address], current[address])

    if can_switch and isinstance(present, int) and not present & INVALID_BIT:
        yield put(cob_id, present | INVALID_BIT)
    for address in sorted(planned):
        if address[0] == communication and address[1] > _COB_ID and differs(address):
            yield put(address, planned[address])
    slots = [address for address in sorted(planned) if address[0] == mapping and address[1]]
    if any(differs(address) for address in (*slots, (mapping, 0)) if address in planned):
        yield from _mapping_writes(od, (mapping, 0), slots, planned, current)
    if can_switch and isinstance(present, int):
        target = planned[cob_id]
        if isinstance(target, int) and not (target & INVALID_BIT and target & ~NO_RTR_BIT == present & ~NO_RTR_BIT):
            yield put(cob_id, target & ~NO_RTR_BIT | present & NO_RTR_BIT)


def _mapping_writes(
    od: ObjectDictionary,
    count: Address,
    slots: list[Address],
    target: Mapping[Address, Value],
    current: Mapping[Address, Value],
) -> Iterator[Write]:
    """Yield the writes of a PDO mapping; if `target` lacks the count, only of the entries that differ."""
    if count not in target:
        for address in slots:
            if not same_value(od[address], target[address], current[address]):
                yield Write(address, encode(target[address], od[address].data_type))
        return
    yield Write(count, encode(0, od[count].data_type))
    used = target[count]
    for address in slots:
        if isinstance(used, int) and address[1] <= used:
            yield Write(address, encode(target[address], od[address].data_type))
    yield Write(count, encode(used, od[count].data_type))


SAVE: Final = b"save"
_STORE: Final = (0x1010, 1)
_STORE_S: Final = 15.0  # maximum time to write a flash
_POLL_S: Final = 0.2


class RestoreStep(enum.Enum):
    """Steps of a restore; the values are texts for users."""

    READING = "reading the present values"
    WRITING = "writing"
    VERIFYING = "reading back"
    UNDOING = "restoring the previous values"
    DONE = "done"


def check_device(parameters: ParameterSet, identity: DeviceIdentity, session: NodeSession) -> list[str]:
    """Return the differences in revision and software version; raise ConfigError for another product."""
    if strangers := parameters.identity.strangers(identity):
        raise ConfigError(
            f"{parameters.where} belongs to a different product than {session}: {', '.join(strangers)}; "
            "nothing was written"
        )
    return parameters.identity.variations(identity)


def refuse_moving(session: NodeSession) -> None:
    """Raise DriveError if an axis may have torque, since an enabled drive must not be reconfigured."""
    if powered := session.powered_axes():
        axes = "" if powered == [0] else f" (axis {', '.join(map(str, powered))})"
        raise DriveError(f"{session} is enabled{axes}; nothing was written: disable it first, `axis disable`")


@dataclass(slots=True)
class Restore:
    """Restore of the values `target` in the node of `session`, with the data types of `od`.

    `keep_held` is called with the present values before the first write, and may raise an error. `run` may raise an
    error of the bus or the node at any point; `step`, `written` and `planned` then show the progress. `verified` is the
    number of values that were read back correctly; `undone` is True if the drive has all its previous values.
    """

    session: NodeSession
    od: ObjectDictionary
    target: Mapping[Address, Value]
    progress: ProgressCallback | None = None
    keep_held: Callable[[Mapping[Address, Value]], None] | None = None
    step: RestoreStep = RestoreStep.READING
    held: dict[Address, Value] = field(default_factory=dict)
    planned: int = 0
    written: list[str] = field(default_factory=list)
    refused: list[str] = field(default_factory=list)
    verified: int = 0
    undone: bool = False

    def run(self, *, keep: bool = False) -> bool:
        """Write the parameters that differ and verify all; return True unless the node has refused any.

        With `keep`, the accepted values stay in the drive even if other values were refused.
        """
        entries = [self.od[address] for address in self.target]
        self.held, left_out = read_values(self.session, entries)
        self.refused = list(map(str, left_out))
        if self.refused and not keep:
            self.undone, self.step = True, RestoreStep.DONE  # nothing was written yet
            return False
        groups = restore_groups(self.od, self.target, self.held)
        if groups and self.keep_held is not None:
            self.keep_held(self.held)
        self.step = RestoreStep.WRITING
        failed = self._write(groups)
        self._verify({group.name: why for group, why in failed})
        if self.refused and not keep and self.written:
            self._undo()
        self.step = RestoreStep.DONE
        return not self.refused

    def _write(self, groups: list[RestoreGroup]) -> list[tuple[RestoreGroup, str]]:
        """Write the groups; return the groups that were refused twice, with the reasons."""
        self.planned = len(groups)
        failed: list[tuple[RestoreGroup, str]] = []
        for _ in range(2):
            failed = []
            for group in groups:
                if (why := self._write_group(group)) is None:
                    self.written.append(group.name)
                else:
                    failed.append((group, why))
                if self.progress is not None:
                    self.progress(len(self.written), self.planned)
            groups = [group for group, _ in failed]
        return failed

    def _write_group(self, group: RestoreGroup) -> str | None:
        """Write a group; return the reason for a refusal, or None. A PDO with a refused mapping stays disabled."""
        for write in group.writes:
            try:
                self.session.write(*write.address, write.data)
            except CanopenError as error:
                if not is_abort(error):
                    raise
                return reason_of(error)
        return None

    def _verify(self, failed: Mapping[str, str]) -> None:
        """Read all values back, and add values that the node refused or changed to `refused`."""
        self.step = RestoreStep.VERIFYING
        values, left_out = read_values(self.session, [self.od[address] for address in self.held])
        self.refused += [f"{name}: {why}" for name, why in failed.items()]
        self.refused += map(str, left_out)
        for address, value in values.items():
            entry, target = self.od[address], self.target[address]
            if same_value(entry, target, value):
                self.verified += 1
                continue
            name = entry_label(entry)
            if name not in failed:
                target_text, has = value_text(entry, target), value_text(entry, value)
                self.refused.append(f"{name}: {target_text} was written, but the drive reports {has}")

    def _undo(self) -> None:
        """Write the previous values back, and add values that the node refuses to `refused`."""
        self.step = RestoreStep.UNDOING
        now, _ = read_values(self.session, [self.od[address] for address in self.held])
        for group in restore_groups(self.od, self.held, now):
            self._write_group(group)
        after, _ = read_values(self.session, [self.od[address] for address in self.held])
        changed = [address for address, value in self.held.items()
                if address not in after or not same_value(self.od[address], value, after[address])]  # fmt: skip
        self.undone = not changed
        self.refused += [f"{entry_label(self.od[address])}: could not be restored" for address in changed]


def store(session: NodeSession) -> None:
    """Store all parameters in the drive (0x1010:01, "save"), and wait until the drive responds again.

    A drive that writes its flash may be silent for some time. Raise ConfigError if the drive has no such object, or
    DriveError if the drive stays silent.
    """
    if _STORE not in session.dictionary:
        raise ConfigError(
            f"{session} has no 0x1010:01, so it cannot store parameters; the values are lost at power-off"
        )
    try:
        session.write(*_STORE, SAVE)
    except SdoTimeout:
        _wait_for_answer(session)


def _wait_for_answer(session: NodeSession) -> None:
    for _ in range(round(_STORE_S / _POLL_S)):
        session.transfers.pause(_POLL_S)
        try:
            session.read(*_STORE)
        except SdoTimeout:
            continue
        return
    raise DriveError(f"{session}: no answer {_STORE_S:g} s after the store command; do not switch the drive off yet")


# Values of a drive before a change, as a DCF in the user's state folder, which survives the end of the process.
#
# A drive is identified by vendor, product and serial number; without a serial number, also by its bus or robot. The
# file is a backup like any other, so that `restore` accepts the file too.


class KeptParameters:
    """DCF file with previous values of a session's node, in a subfolder of the user's state folder."""

    def __init__(self, folder: str, session: NodeSession, identity: DeviceIdentity, channel: str = "") -> None:
        self._session, self._identity = session, identity
        numbers = (identity.vendor_id, identity.product_code, identity.serial_number)
        device = "-".join("none" if number is None else f"{number:08X}" for number in numbers)
        place = "" if identity.serial_number else f"-{re.sub(r'[^A-Za-z0-9_.]+', '_', session.robot or channel)}"
        self.path = state_dir(folder) / f"node{session.node_id}-{device}{place}.dcf"

    @property
    def parameters(self) -> ParameterSet | None:
        """Previous values in the file, or None without a file."""
        return read_backup(self.path, self._session.node_id) if self.path.is_file() else None

    def read(self) -> Mapping[Address, Value]:
        """Return the values in the file, by address; empty without a file."""
        parameters = self.parameters
        return {} if parameters is None else parameters.values

    def keep(self, od: ObjectDictionary, values: Mapping[Address, Value]) -> None:
        """Replace the content of the file; raise ConfigError or DiskFull on failure."""
        session = self._session
        listed = {address: value for address, value in values.items() if address in od}
        text = kept_text(ParameterSet(od, session.node_id, self._identity, listed, str(session)))
        try:
            self.path.parent.mkdir(parents=True, exist_ok=True)
            write_whole(self.path, text.encode())
            with self.path.open("rb") as file:
                os.fsync(file.fileno())
        except (OSError, CanopenError) as error:
            title = f"{session}: its values cannot be saved in {self.path}, so nothing was written to the node"
            cause = error if isinstance(error, OSError) else error.__cause__
            if isinstance(cause, OSError) and (advice := space_advice(self.path, cause)):
                raise DiskFull(title, cause.strerror or str(cause), advice.removeprefix("; ")) from None
            reason = (cause.strerror if isinstance(cause, OSError) else None) or error
            raise ConfigError(f"{title}: {reason}; set XDG_STATE_HOME to a writable folder") from None

    def forget(self) -> None:
        self.path.unlink(missing_ok=True)


# Journal of a restore: the previous values of the node as a DCF on disk, for undoing a restore that was killed.
#
# The journal is written before the first value, and removed when all values are verified or undone. A remaining journal
# means that SIGKILL or a power failure of the computer interrupted a restore: the same command then continues, since
# only differences are written; restoring the journal itself undoes the restore. If an earlier journal exists, its
# values are older than the present ones of the node, and are kept.


_FOLDER: Final = "restores"


class RestoreJournal:
    """Journal of a restore to a session's node; `reached` has the options for suggested commands."""

    def __init__(self, session: NodeSession, identity: DeviceIdentity, reached: Reached) -> None:
        self._session, self._reached = session, reached
        self._stored = KeptParameters(_FOLDER, session, identity, reached.channel)
        self.path = self._stored.path
        self._old = self._stored.parameters

    @property
    def unfinished(self) -> str:
        """Sentence about an interrupted earlier restore and the possible next commands, or ""."""
        if self._old is None:
            return ""
        return (
            f"{self._session}: a restore of {self._old.date} was interrupted: repeat the command to continue it; "
            f"{self.undo_words} the previous values"
        )

    @property
    def undo_words(self) -> str:
        """Start of a sentence, with the command that restores the previous values."""
        return f"`canopen-control restore {shlex.join([str(self.path), *self._words()])}` restores"

    def begin(self, od: ObjectDictionary, current: Mapping[Address, Value]) -> None:
        """Store the previous values before the first write; raise ConfigError if they cannot be stored."""
        old = {} if self._old is None else self._old.values
        self._stored.keep(od, {**current, **old})

    def end(self, restore: Restore) -> None:
        """Delete the journal, except for values of an earlier, interrupted restore that have not been restored yet."""
        if restore.refused and restore.undone:
            remaining: Mapping[Address, Value] = {} if self._old is None else self._old.values
        else:
            old = {} if self._old is None else self._old.values
            remaining = {address: value for address, value in old.items() if address not in restore.target}
        if remaining:
            self._stored.keep(restore.od, remaining)
        else:
            self._stored.forget()
            self._old = None

    def _words(self) -> list[str]:
        how, node = self._reached, str(self._session.name or self._session.node_id)
        words = [node, *(["--can", how.channel] if how.channel else ["--name", how.robot] if how.robot else [])]
        return [*words, *(["--include-protected"] if how.include_protected else [])]


def unfinished_words(session: NodeSession, reached: Reached) -> str:
    """Return a sentence about an interrupted restore of the same device, or ""."""
    if not any(state_dir(_FOLDER).glob(f"node{session.node_id}-*.dcf")):
        return ""
    return RestoreJournal(session, session.identity(), reached).unfinished


# Restore of a parameter set as `restore` and `clone` do it: checks before, PRE-OPERATIONAL meanwhile, a report after.
#
# Nothing is written to another product, by mistake to another drive of the same product, to an axis with torque, or to
# a node that a running robot controls. The node is PRE-OPERATIONAL meanwhile, so that no PDO is processed with a half
# written configuration.


_SHOWN: Final = 8  # maximum number of names in a message


@dataclass(frozen=True, slots=True)
class RestoreReport:
    """Result of a restore; `refused` and `protected` are texts with the name of an object and the reason.

    `foreign` are objects of the file that no restore writes: read-only objects, commands, process values.
    """

    source: str
    node_id: int
    written: int
    verified: int
    protected: list[str]
    foreign: list[str]
    refused: list[str]
    undone: bool
    stored: bool

    def words(self, session: NodeSession) -> str:
        if self.refused:
            end = "the drive is unchanged" if self.undone else "the accepted values are kept, but not stored"
            return f"{session}: {len(self.refused)} parameters refused; {end}"
        end = "stored" if self.stored else "not stored: a power cycle undoes it"
        return f"{session}: {self.verified} parameters as in {self.source}, {self.written} written; {end}"


def refuse_other_drive(file: ParameterSet, session: NodeSession) -> None:
    """Raise ConfigError if neither the node-ID nor the serial number of a backup matches the node."""
    if file.node_id == session.node_id:
        return
    serial = session.identity().serial_number
    if serial is None or serial != file.identity.serial_number:
        raise ConfigError(
            f"{file.where} belongs to node {file.node_id}, and {session} is another drive; nothing was written: "
            f"give node {file.node_id}, or --any-node to write these parameters to another drive"
        )


def protected(
    od: ObjectDictionary, addresses: Iterator[Address], globs: Sequence[str], *, same_device: bool
) -> dict[Address, str]:
    """Return the protected parameters with the reasons; raise ConfigError for a glob that matches no parameter."""
    reasons: dict[Address, str] = {}
    used: set[str] = set()
    for address in addresses:
        entry = od[address]
        fitting = [glob for glob in globs if _fits(od, entry, glob)]
        used.update(fitting)
        reason = protection_of(od, entry, same_device=same_device) or (f"--protect {fitting[0]}" if fitting else "")
        if reason:
            reasons[address] = reason
    if unused := [glob for glob in globs if glob not in used]:
        raise ConfigError(f"--protect {unused[0]} matches no parameter; write an address as in '0x2*', or a name")
    return reasons


def _fits(od: ObjectDictionary, entry: Entry, glob: str) -> bool:
    info = od.objects.get(entry.index)
    address = f"0x{entry.index:04x}"
    names = (address, f"{address}:{entry.subindex:02x}", entry.name, "" if info is None else info.name)
    return any(fnmatch.fnmatchcase(name.lower(), glob.lower()) for name in names)


@contextlib.contextmanager
def quiet_node(session: NodeSession, *, starts_again: bool = True) -> Iterator[None]:
    """Context with the node in PRE-OPERATIONAL and without torque; raise DriveError if this is impossible.

    On exit a node that was OPERATIONAL is started again, if `starts_again`. Through a robot, the node must be taken
    out.
    """
    refuse_moving(session)
    state = session.nmt_state()
    again = state if starts_again else None
    if session.robot:
        if state is not NmtState.PRE_OPERATIONAL or not session.transfers.taken_out():
            raise DriveError(
                f"{session} is controlled by the running robot {session.robot}; nothing was written: end the robot "
                f"with `shutdown` and use --can, or take the node out: `nmt preop {session.name or session.node_id}`"
            )
        yield
        return
    session.transfers.command(NmtCommand.ENTER_PRE_OPERATIONAL)
    try:
        yield
    except BaseException:
        with contextlib.suppress(CanopenError):  # the error is reported, not its consequences
            _start_again(session, again)
        raise
    _start_again(session, again)


def _start_again(session: NodeSession, state: NmtState | None) -> None:
    if state is NmtState.OPERATIONAL:
        session.transfers.command(NmtCommand.START)


def guarded_restore(
    session: NodeSession,
    source: ParameterSet,
    options: RestoreOptions,
    *,
    note: Callable[[str], None],
    progress: Callable[[int, int], None] | None = None,
) -> RestoreReport:
    """Write the parameters of `source` to the node and verify them, with all checks.

    `note` receives remarks before the first write; `progress` receives the number of written groups and the total.
    Raise ConfigError or DriveError if a check refuses, or DriveError with the written parameters after an interruption.
    """
    identity = session.identity()
    for line in check_device(source, identity, session):
        note(line)
    same_device = source.identity.serial_number is not None and source.identity.serial_number == identity.serial_number
    target = source.for_node(session.node_id)
    od = source.od.for_node(session.node_id)
    reasons = protected(od, iter(target), options.protect, same_device=same_device or options.include_protected)
    journal = RestoreJournal(session, identity, options.reached)
    if journal.unfinished and Path(source.where) != journal.path:
        note(journal.unfinished)
    restore = Restore(
        session, od, {address: value for address, value in target.items() if address not in reasons}, progress
    )
    restore.keep_held = partial(journal.begin, od)
    stored = False
    with quiet_node(session), _with_partial_report(restore, journal):
        good = restore.run(keep=options.keep)
        journal.end(restore)
        if good and options.store:
            store(session)
            stored = True
    lines = [f"{entry_label(od[address])}: {why}" for address, why in reasons.items()]
    written = len(restore.written)
    foreign = [entry_label(od[address]) for address in source.foreign]
    refused, undone = restore.refused, restore.undone
    return RestoreReport(
        source.where, session.node_id, written, restore.verified, lines, foreign, refused, undone, stored
    )


@contextlib.contextmanager
def _with_partial_report(restore: Restore, journal: RestoreJournal) -> Iterator[None]:
    """Context that converts an interruption after reading into a DriveError with the parameters already written."""
    try:
        yield
    except (CanopenError, KeyboardInterrupt) as error:
        if restore.step in (RestoreStep.READING, RestoreStep.DONE):
            raise
        raise DriveError(_interrupted(restore, journal, error)) from error


def _interrupted(restore: Restore, journal: RestoreJournal, error: BaseException) -> str:
    names = first_of(restore.written)
    summary = f"{len(restore.written)} of {restore.planned} were written{f' ({names})' if names else ''}"
    reason = str(error) or "interrupted"
    return (
        f"{restore.session}: the restore ended while {restore.step.value}: {reason}; {summary}, nothing was stored; "
        f"repeat the command to write the rest; {journal.undo_words} the previous values"
    )


def first_of(names: Sequence[str]) -> str:
    """Join the first `_SHOWN` names of a list, with "..." if there are more."""
    return ", ".join(names[:_SHOWN]) + (", ..." if len(names) > _SHOWN else "")
