"""Network management (NMT), master and slave (CiA 301, 7.2.8.2 and 7.3.2).

`TRANSITIONS` is the slave's state machine: state and command give the next state, and a missing pair is ignored. A
slave ignores all commands while INITIALISING and leaves this state only through `NmtSlave.boot`, which sends the
boot-up frame. `SERVICES_BY_STATE` lists the services of each state (7.3.2.2.5).

NMT commands are unconfirmed. `NmtMaster` treats the next heartbeat with the requested state as the confirmation and
repeats an unconfirmed command. A reset is never repeated, because that would reset a node that is still booting.
"""

from __future__ import annotations

import enum
from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

from canopen_control.cia301.abort import AbortCode
from canopen_control.cia301.outbox import Outbox
from canopen_control.errors import LocalProtocolError
from canopen_control.frame import BROADCAST, MAX_NODE_ID, CanFrame, Service, cob_id

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping


NMT_COB_ID: Final = cob_id(Service.NMT)
ERROR_CONTROL_COB_ID: Final = cob_id(Service.HEARTBEAT)  # plus node-ID


class NmtState(enum.IntEnum):
    """NMT states, with their values in boot-up, heartbeat and guarding frames."""

    INITIALISING = 0
    STOPPED = 4
    OPERATIONAL = 5
    PRE_OPERATIONAL = 0x7F

    @property
    def text(self) -> str:
        """Name as spelled in CiA 301, such as PRE-OPERATIONAL."""
        return self.name.replace("_", "-")


class NmtCommand(enum.IntEnum):
    """NMT command specifiers (CiA 301, 7.2.8.3.1)."""

    START = 1
    STOP = 2
    ENTER_PRE_OPERATIONAL = 0x80
    RESET_NODE = 0x81
    RESET_COMMUNICATION = 0x82


COMMAND_NAMES: Final[Mapping[str, NmtCommand]] = {
    "start": NmtCommand.START,
    "stop": NmtCommand.STOP,
    "preop": NmtCommand.ENTER_PRE_OPERATIONAL,
    "reset-node": NmtCommand.RESET_NODE,
    "reset-comm": NmtCommand.RESET_COMMUNICATION,
}
"""Names of the commands for users and clients of the API."""


class CommunicationService(enum.Enum):
    """Communication services whose permission depends on the NMT state (CiA 301, 7.3.2.2.5)."""

    BOOT_UP = "boot-up"
    NMT = "NMT"
    ERROR_CONTROL = "error control"
    SDO = "SDO"
    SYNC = "SYNC"
    TIME = "TIME"
    EMCY = "EMCY"
    PDO = "PDO"
    LSS = "LSS"


_ALWAYS = {CommunicationService.NMT, CommunicationService.ERROR_CONTROL, CommunicationService.LSS}
_CONFIGURABLE = _ALWAYS | {
    CommunicationService.SDO,
    CommunicationService.SYNC,
    CommunicationService.TIME,
    CommunicationService.EMCY,
}

SERVICES_BY_STATE: dict[NmtState, frozenset[CommunicationService]] = {
    # A node without a node-ID stays here until LSS assigns one (CiA 305).
    NmtState.INITIALISING: frozenset({CommunicationService.BOOT_UP, CommunicationService.LSS}),
    NmtState.PRE_OPERATIONAL: frozenset(_CONFIGURABLE),
    NmtState.OPERATIONAL: frozenset(_CONFIGURABLE | {CommunicationService.PDO}),
    NmtState.STOPPED: frozenset(_ALWAYS),
}

EXPECTED_STATE: dict[NmtCommand, NmtState] = {
    NmtCommand.START: NmtState.OPERATIONAL,
    NmtCommand.STOP: NmtState.STOPPED,
    NmtCommand.ENTER_PRE_OPERATIONAL: NmtState.PRE_OPERATIONAL,
    NmtCommand.RESET_NODE: NmtState.INITIALISING,
    NmtCommand.RESET_COMMUNICATION: NmtState.INITIALISING,
}
RESETS = frozenset({NmtCommand.RESET_NODE, NmtCommand.RESET_COMMUNICATION})

# CiA 301, 7.3.2: the three communicating states have the same five exits.
TRANSITIONS: dict[tuple[NmtState, NmtCommand], NmtState] = {
    (state, command): target
    for state in (NmtState.PRE_OPERATIONAL, NmtState.OPERATIONAL, NmtState.STOPPED)
    for command, target in EXPECTED_STATE.items()
}

_STATES = {int(state): state for state in NmtState}
_COMMANDS = {int(command): command for command in NmtCommand}


def state_of_byte(value: int) -> NmtState | None:
    """Return the state in the low seven bits of an error control byte, or None if they are not a state."""
    return _STATES.get(value & 0x7F)


def nmt_frame(command: NmtCommand, node_id: int = BROADCAST) -> CanFrame:
    """Return the command frame for `node_id` (0: all nodes).

    Raise LocalProtocolError for a node-ID outside 0 to 127.
    """
    if not 0 <= node_id <= MAX_NODE_ID:
        msg = f"NMT {command.name}: node-ID {node_id} is out of range, 0 to {MAX_NODE_ID}"
        raise LocalProtocolError(msg)
    return CanFrame(NMT_COB_ID, bytes((command, node_id)))


def parse_nmt(frame: CanFrame) -> tuple[NmtCommand, int] | None:
    """Return the command and node-ID (0: all nodes), or None if `frame` is not an NMT command of CiA 301."""
    # CiA 301, 7.2.8.3.1: two bytes, command specifier and node-ID
    if frame.can_id != NMT_COB_ID or len(frame.data) != 2 or frame.data[1] > MAX_NODE_ID:
        return None
    command = _COMMANDS.get(frame.data[0])
    return None if command is None else (command, frame.data[1])


def boot_up_frame(node_id: int) -> CanFrame:
    """Return the boot-up frame of `node_id`."""
    return CanFrame(ERROR_CONTROL_COB_ID + node_id, b"\0")


@dataclass(frozen=True, slots=True)
class NmtStateChanged:
    """Change of the slave's state from `previous` to `state`."""

    previous: NmtState
    state: NmtState


@dataclass(frozen=True, slots=True)
class NmtResetRequested:
    """Request to the owner for a reset: it must restore the power-on values and then call `NmtSlave.boot`."""

    command: NmtCommand  # RESET_NODE: all objects; RESET_COMMUNICATION: 0x1000 to 0x1FFF (CiA 301, 7.3.2.2.1)


class NmtSlave:
    """NMT state machine of one node; `node_id` may change while the node is INITIALISING (LSS).

    `malformed` counts frames with COB-ID 0 that are not commands, `ignored` commands without a transition.
    """

    def __init__(self, node_id: int, *, self_starting: bool = False) -> None:
        self.node_id = node_id
        self.self_starting = self_starting  # 0x1F80 bit 2 = 0: enters OPERATIONAL without a command (CiA 302-2)
        self.state = NmtState.INITIALISING
        self.malformed = 0
        self.ignored = 0
        self.outgoing: Outbox[CanFrame] = Outbox()
        self.event_queue: Outbox[NmtStateChanged | NmtResetRequested] = Outbox()

    def boot(self) -> None:
        """Leave INITIALISING: send the boot-up frame and enter PRE_OPERATIONAL, or OPERATIONAL if self-starting.

        No effect in other states.
        """
        # CiA 301, 7.3.2.2.1: the boot-up frame ends INITIALISING
        if self.state is not NmtState.INITIALISING:
            return
        self.outgoing.put(boot_up_frame(self.node_id))
        self._enter(NmtState.PRE_OPERATIONAL)
        if self.self_starting:
            self._enter(NmtState.OPERATIONAL)

    def command(self, command: NmtCommand) -> bool:
        """Execute a command from the bus or from the node itself; return whether a transition exists."""
        # CiA 301, 7.3.2: other commands are ignored
        target = TRANSITIONS.get((self.state, command))
        if target is None:
            self.ignored += 1
            return False
        self._enter(target)
        if command in RESETS:
            self.event_queue.put(NmtResetRequested(command))
        return True

    def allows(self, service: CommunicationService) -> bool:
        """Whether the current state permits `service`."""
        # CiA 301, 7.3.2.2.5
        return service in SERVICES_BY_STATE[self.state]

    def receive(self, frame: CanFrame, now: int) -> None:  # noqa: ARG002 - the verb of every core
        if frame.can_id != NMT_COB_ID:
            return
        parsed = parse_nmt(frame)
        if parsed is None:
            self.malformed += 1
        # CiA 301, 7.2.8.3.1: node-ID 0 addresses all nodes
        elif parsed[1] in (BROADCAST, self.node_id):
            self.command(parsed[0])

    def tick(self, now: int) -> None:
        """Do nothing; this core has no timers."""

    def next_deadline(self) -> None:
        """Return None; this core has no timers."""

    def frames(self) -> list[CanFrame]:
        return self.outgoing.drain()

    def events(self) -> list[NmtStateChanged | NmtResetRequested]:
        return self.event_queue.drain()

    def _enter(self, state: NmtState) -> None:
        if state is not self.state:
            self.event_queue.put(NmtStateChanged(self.state, state))
            self.state = state


@dataclass(frozen=True, slots=True)
class NmtConfirmed:
    """Confirmed NMT command: the node entered the requested state after `tries` transmissions and `elapsed_ns`."""

    node_id: int
    command: NmtCommand
    tries: int
    elapsed_ns: int


@dataclass(frozen=True, slots=True)
class NmtUnconfirmed:
    """Unconfirmed NMT command: `state` is the last known state of the node after `tries` transmissions."""

    node_id: int
    command: NmtCommand
    tries: int
    state: NmtState | None


@dataclass(slots=True)
class _Pending:
    command: NmtCommand
    since_ns: int
    deadline_ns: int
    tries: int = 1
    state: NmtState | None = None


class NmtMaster:
    """Master that sends NMT commands and awaits their confirmation; at most one command per node is pending.

    `retry_ns` should be at least 1.5 heartbeat periods; `reset_timeout_ns` is the time allowed for a node to boot.
    """

    def __init__(self, *, retry_ns: int = 1_500_000_000, tries: int = 3, reset_timeout_ns: int = 5_000_000_000) -> None:
        self.retry_ns = retry_ns
        self.tries = tries
        self.reset_timeout_ns = reset_timeout_ns
        self._pending: dict[int, _Pending] = {}
        self._frames: Outbox[CanFrame] = Outbox()
        self._events: Outbox[NmtConfirmed | NmtUnconfirmed] = Outbox()

    def command(self, command: NmtCommand, node_id: int, now: int, *, confirm_by: Iterable[int] | None = None) -> None:
        """Send `command`; the nodes in `confirm_by` must confirm it (default: `node_id`; none for a broadcast)."""
        nodes = (node_id,) if confirm_by is None else confirm_by
        self._frames.put(nmt_frame(command, node_id))
        for node in nodes:
            if 1 <= node <= MAX_NODE_ID:
                self._pending[node] = _Pending(command, now, now + self._timeout(command))

    def pending(self, node_id: int) -> NmtCommand | None:
        """Return the command of `node_id` that awaits confirmation, or None."""
        entry = self._pending.get(node_id)
        return None if entry is None else entry.command

    def cancel(self, node_id: int) -> None:
        """Stop waiting for the confirmation of `node_id`."""
        self._pending.pop(node_id, None)

    def receive(self, frame: CanFrame, now: int) -> None:
        """Receive a boot-up, heartbeat or guarding response, which may confirm a pending command."""
        node_id = frame.can_id - ERROR_CONTROL_COB_ID
        entry = self._pending.get(node_id)
        if entry is None or len(frame.data) != 1:
            return
        entry.state = state_of_byte(frame.data[0])
        if entry.state is EXPECTED_STATE[entry.command]:
            del self._pending[node_id]
            self._events.put(NmtConfirmed(node_id, entry.command, entry.tries, now - entry.since_ns))

    def tick(self, now: int) -> None:
        """Repeat the commands that are due; report commands without confirmation after the last try."""
        for node_id, entry in list(self._pending.items()):
            if now < entry.deadline_ns:
                continue
            if entry.command in RESETS or entry.tries >= self.tries:
                del self._pending[node_id]
                self._events.put(NmtUnconfirmed(node_id, entry.command, entry.tries, entry.state))
            else:
                entry.tries += 1
                entry.deadline_ns = now + self.retry_ns
                self._frames.put(nmt_frame(entry.command, node_id))

    def next_deadline(self) -> int | None:
        return min((entry.deadline_ns for entry in self._pending.values()), default=None)

    def frames(self) -> list[CanFrame]:
        return self._frames.drain()

    def events(self) -> list[NmtConfirmed | NmtUnconfirmed]:
        return self._events.drain()

    def _timeout(self, command: NmtCommand) -> int:
        return self.reset_timeout_ns if command in RESETS else self.retry_ns


# Error behaviour object 0x1029 (CiA 301, 7.5.2.32). Subindex 1 is for communication errors: bus-off, life guarding,
# heartbeat, RPDO timeout. The device profile defines the others.


class ErrorReaction(enum.IntEnum):
    """Values of the error behaviour object 0x1029."""

    PRE_OPERATIONAL = 0  # only if the node is OPERATIONAL
    NO_CHANGE = 1
    STOPPED = 2


# Command that a node executes itself; no command for a missing pair.
REACTIONS: dict[tuple[ErrorReaction, NmtState], NmtCommand] = {
    (ErrorReaction.PRE_OPERATIONAL, NmtState.OPERATIONAL): NmtCommand.ENTER_PRE_OPERATIONAL,
    (ErrorReaction.STOPPED, NmtState.PRE_OPERATIONAL): NmtCommand.STOP,
    (ErrorReaction.STOPPED, NmtState.OPERATIONAL): NmtCommand.STOP,
}

_REACTIONS = {int(value): value for value in ErrorReaction}


def reaction(value: int, state: NmtState) -> NmtCommand | None:
    """Return the NMT command that a node executes after an error; None for no command or an unknown `value`."""
    kind = _REACTIONS.get(value)
    return None if kind is None else REACTIONS.get((kind, state))


def check_reaction(value: int) -> AbortCode | None:
    """Return the abort code for a write to 0x1029, or None if the value is valid."""
    # CiA 301, 7.5.2.32: 0, 1 and 2 are defined
    return None if value in _REACTIONS else AbortCode.INVALID_VALUE
