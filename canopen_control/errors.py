"""Every exception that this package raises on purpose, and the hint that names what was meant.

CanopenError
  ConfigError            what the user wrote
    EdsError               an EDS or DCF file: path, line, reason
    BusConfigError         a bus.yml: path, line, key, reason
    RobotConfigError       controllers, description, or how the three fit together
  DiskFull               a file could not be written to its end: path, reason, kept
  BusError               the wire or its driver
    BusClosed              the channel is gone or was closed
    BusOff                 the CAN controller left the bus
    InterfaceNotFound      no such channel
      BusNotOpen             a local: bus that nobody has open: others
    InterfaceDown          the interface exists but is down
  ProtocolError          the rules of CANopen (never raised itself)
    LocalProtocolError     this side broke them: a defect of the caller
    RemoteProtocolError    the other side broke them: node_id
      SdoAbort               the transfer was aborted: node_id, index, subindex, code
      SdoTimeout             no answer: node_id, index, subindex
        SdoStopped             because the node is in NMT STOPPED
      SdoRestarted           the node has booted in the middle of a transfer: node_id, index, subindex
      SdoLengthError         an answer of another length than the object has: node_id, index, subindex, data
      BootError              CiA 302 boot failed: node_id, letter, step
      HeartbeatLost          silent for longer than its heartbeat time: node_id, age
  DriveError             the drive
    UnsupportedMode        it lacks the mode of operation: mode, supported
  ControlError           the controllers
    InterfaceConflict      a command interface has an owner already: interface, owner
    NotEnabled             a command to a drive that is not enabled, which is refused and never kept
      NotYetEnabled          the same while it is on its way up: the next command may be taken
    TrajectoryRefused      a trajectory breaks a rule: code
    UnknownInterface       nobody exports it: name
    UnknownName            the robot has no node, joint, controller, component or mode of that name
  RemoteError            a running robot refused a request: kind
    UnreadableMessage      one message that was sent unasked cannot be read

Each has fields, and a message made from them that says what, where and what to do next. ``OSError`` and
``can.CanError`` become one of these in `bus`, and nowhere else.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence

__all__ = [
    "BootError",
    "BusClosed",
    "BusConfigError",
    "BusError",
    "BusNotOpen",
    "BusOff",
    "CanopenError",
    "ConfigError",
    "ControlError",
    "DiskFull",
    "DriveError",
    "EdsError",
    "HeartbeatLost",
    "InterfaceConflict",
    "InterfaceDown",
    "InterfaceNotFound",
    "LocalProtocolError",
    "NotEnabled",
    "NotYetEnabled",
    "ProtocolError",
    "RemoteError",
    "RemoteProtocolError",
    "RobotConfigError",
    "SdoAbort",
    "SdoLengthError",
    "SdoRestarted",
    "SdoStopped",
    "SdoTimeout",
    "TrajectoryRefused",
    "UnknownInterface",
    "UnknownName",
    "UnreadableMessage",
    "UnsupportedMode",
    "nearest",
]


def _node(node_id: int, name: str = "") -> str:
    return f"node {node_id} ({name})" if name else f"node {node_id}"


class CanopenError(Exception):
    """Nothing else is raised on purpose."""

    @property
    def of_usage(self) -> bool:
        """Whether what the user typed or wrote is wrong, and nothing was done; the command line exits with 2."""
        return isinstance(self, _OF_USAGE)


class ConfigError(CanopenError):
    """What the user wrote cannot be used."""


class EdsError(ConfigError):
    """A file is no usable EDS or DCF."""

    def __init__(self, path: str, line: int, reason: str) -> None:
        self.path, self.line, self.reason = path, line, reason
        super().__init__(f"{path}:{line}: {reason}" if line else f"{path}: {reason}")


class BusConfigError(ConfigError):
    """A bus.yml holds mistakes; `reason` names all of them at once, a paragraph each."""

    def __init__(self, path: str, line: int, key: str, reason: str) -> None:
        self.path, self.line, self.key, self.reason = path, line, key, reason
        super().__init__(reason)


class RobotConfigError(ConfigError):
    """Controllers, description and bus do not fit together, or one of the files is missing."""


class DiskFull(CanopenError):
    """A file could not be written to its end, for want of room or a broken disk; `kept` says what is left of it."""

    def __init__(self, path: str, reason: str, kept: str) -> None:
        self.path, self.reason, self.kept = path, reason, kept
        super().__init__(f"{path}: {reason}; {kept}")


class BusError(CanopenError):
    """The wire, or the driver of its adapter."""


class BusClosed(BusError):
    """The channel is gone, or was closed on this side."""

    def __init__(self, channel: str, reason: str = "closed") -> None:
        self.channel, self.reason = channel, reason
        super().__init__(f"bus {channel}: {reason}")


class BusOff(BusError):
    """The CAN controller left the bus after too many errors."""

    def __init__(self, channel: str) -> None:
        self.channel = channel
        super().__init__(f"bus {channel}: bus-off; check the cable, the terminators and the bit rate")


class InterfaceNotFound(BusError):
    """No such channel; `hint` says what to do."""

    def __init__(self, name: str, hint: str = "") -> None:
        self.name, self.hint = name, hint
        super().__init__(f"no CAN interface {name!r}" + (f"; {hint}" if hint else ""))


class BusNotOpen(InterfaceNotFound):
    """Nobody has this ``local:`` bus open, and who only listens or asks does not make one; `others` are open."""

    def __init__(self, name: str, others: Sequence[str] = ()) -> None:
        there = f"open now: {', '.join(others)}" if others else "no local bus is open now"
        super().__init__(name, f"{there}; canopen-control run and drive make one")
        self.args = (f"bus {name}: nobody has it open; {self.hint}",)


class InterfaceDown(BusError):
    """The interface exists and is down."""

    def __init__(self, name: str, hint: str = "") -> None:
        self.name = name
        super().__init__(f"CAN interface {name} is down; {hint or f'bring it up: ip link set {name} up'}")


class ProtocolError(CanopenError):
    """The rules of CANopen were broken; see the two children."""


class LocalProtocolError(ProtocolError):
    """The caller asked for what the protocol forbids; the state is unchanged."""


class RemoteProtocolError(ProtocolError):
    """The other side did not do what the protocol demands."""

    def __init__(self, node_id: int, reason: str) -> None:
        self.node_id = node_id
        super().__init__(reason)


class SdoAbort(RemoteProtocolError):
    """An SDO transfer ended with an abort code (CiA 301, table 22).

    `code` is the 32-bit abort code, `text` its meaning; `name` is the node's, where known.
    """

    def __init__(self, node_id: int, index: int, subindex: int, code: int, text: str = "", name: str = "") -> None:
        self.index, self.subindex, self.code, self.text = index, subindex, code, text
        super().__init__(
            node_id,
            f"{_node(node_id, name)}: 0x{index:04X}:{subindex:02X}: abort 0x{code:08X} ({text or 'unknown code'})",
        )


class SdoTimeout(RemoteProtocolError):
    """A server did not answer in time; `seconds` is what it was given, all tries together."""

    hint = "is the node powered and its node id right?"

    def __init__(self, node_id: int, index: int, subindex: int, seconds: float, name: str = "") -> None:
        self.index, self.subindex, self.seconds, self.name = index, subindex, seconds, name
        super().__init__(
            node_id,
            f"{_node(node_id, name)}: 0x{index:04X}:{subindex:02X}: no answer within {seconds:g} s; {self.hint}",
        )


class SdoStopped(SdoTimeout):
    """A server did not answer because its node is in NMT STOPPED, where there is no SDO (CiA 301, table 38)."""

    hint = "its heartbeat says NMT STOPPED, where a node answers no SDO; `nmt preop` or `nmt start` ends that"

    def __init__(self, silence: SdoTimeout) -> None:
        super().__init__(silence.node_id, silence.index, silence.subindex, silence.seconds, silence.name)


class SdoRestarted(RemoteProtocolError):
    """A node has booted in the middle of a transfer, and has lost its data."""

    def __init__(self, node_id: int, index: int, subindex: int, name: str = "") -> None:
        self.index, self.subindex = index, subindex
        super().__init__(
            node_id,
            f"{_node(node_id, name)}: 0x{index:04X}:{subindex:02X}: the node has restarted in the middle of the "
            "transfer; is its supply stable?",
        )


class SdoLengthError(RemoteProtocolError):
    """The bytes that an upload brought are no value of the object: `data`; `wanted` names type and length."""

    def __init__(
        self, node_id: int, index: int, subindex: int, data: bytes, wanted: str, entry: str = "", name: str = ""
    ) -> None:
        self.index, self.subindex, self.data = index, subindex, data
        count = "1 byte" if len(data) == 1 else f"{len(data)} bytes"
        self.answered = f"answered {count}{f' ({data.hex(chr(32))})' if data else ''}, {wanted}"
        label = f"0x{index:04X}:{subindex:02X}{f' {entry}' if entry else ''}"
        super().__init__(
            node_id,
            f"{_node(node_id, name)}: {label}: {self.answered}; is this the EDS of the device, and its firmware?",
        )


class BootError(RemoteProtocolError):
    """The boot of a node failed (CiA 302-2); `letter` is its error status A to O, `step` what was being done."""

    def __init__(self, node_id: int, letter: str, step: str, name: str = "") -> None:
        self.letter, self.step = letter, step
        super().__init__(node_id, f"{_node(node_id, name)}: boot error {letter}: {step}")


class HeartbeatLost(RemoteProtocolError):
    """A node was silent for longer than its heartbeat time; `age` in seconds."""

    def __init__(self, node_id: int, age: float, name: str = "") -> None:
        self.age = age
        super().__init__(node_id, f"{_node(node_id, name)}: no heartbeat for {age:.3f} s; is it powered and connected?")


class DriveError(CanopenError):
    """A drive does not do what it was told."""


class UnsupportedMode(DriveError):
    """The drive's 0x6502 does not list the mode of operation."""

    def __init__(self, mode: str, supported: tuple[str, ...]) -> None:
        self.mode, self.supported = mode, supported
        super().__init__(f"mode {mode} is not supported; 0x6502 lists {', '.join(supported) or 'none'}")


class ControlError(CanopenError):
    """The controllers, and what they may claim."""


class InterfaceConflict(ControlError):
    """A command interface has one owner at a time."""

    def __init__(self, interface: str, owner: str) -> None:
        self.interface, self.owner = interface, owner
        super().__init__(f"command interface {interface} is claimed by {owner}; deactivate that controller first")


class TrajectoryRefused(ControlError):
    """A trajectory that breaks a rule; `code` is the one that the result of FollowJointTrajectory has for it."""

    def __init__(self, message: str, code: int) -> None:
        self.code = code
        super().__init__(message)


class NotEnabled(ControlError):
    """Drives that are not enabled take no command, and none is kept for when they are."""


class NotYetEnabled(NotEnabled):
    """They are being enabled: a later command may be taken."""


class UnknownInterface(ControlError):
    """Nobody exports an interface of this name; `known` helps to find the right one."""

    def __init__(self, name: str, known: tuple[str, ...] = ()) -> None:
        self.name, self.known = name, known
        super().__init__(f"no interface {name!r}" + (f"; there are: {', '.join(known)}" if known else ""))


class UnknownName(ControlError):
    """The robot has nothing of the name that was asked for; nothing was done. The command line exits with 2."""


class RemoteError(CanopenError):
    """A request to a running robot was refused; `kind` is the class name of the error over there."""

    def __init__(self, kind: str, message: str) -> None:
        self.kind = kind
        super().__init__(message)

    @property
    def of_usage(self) -> bool:
        """Whether the error over there is one of usage."""
        kind = globals().get(self.kind)
        return isinstance(kind, type) and issubclass(kind, _OF_USAGE)


class UnreadableMessage(RemoteError):
    """One message that was sent unasked cannot be read, as of a program of another version; the next one may be."""

    def __init__(self, message: str) -> None:
        super().__init__("RemoteProtocolError", message)


_OF_USAGE = (ConfigError, InterfaceDown, InterfaceNotFound, UnknownName)


_CLOSE = 0.6  # difflib's ratio of two names that may be meant for each other
_OPPOSITES = ({"left", "right"}, {"front", "rear"}, {"front", "back"}, {"upper", "lower"}, {"min", "max"})


def nearest(name: str, known: Iterable[str]) -> str:
    """Return `, did you mean 'x'?`, or the list of what there is, or nothing when there is nothing.

    The words of a name may stand in another order; a name that says the opposite (left, right) is not meant.
    """
    import difflib  # only a mistake needs it

    names = [str(each) for each in known]
    words = _words(name)

    def ratio(other: str) -> float:
        theirs = _words(other)
        if any(pair <= set(words) ^ set(theirs) for pair in _OPPOSITES):
            return 0.0
        orders = (name, other), (" ".join(sorted(words)), " ".join(sorted(theirs)))
        return max(difflib.SequenceMatcher(None, *order).ratio() for order in orders)

    best = max(names, key=ratio, default="")
    if best and ratio(best) >= _CLOSE:
        return f", did you mean {best!r}?"
    return f"; known: {', '.join(names)}" if names else ""


def _words(name: str) -> list[str]:
    return "".join(char if char.isalnum() else " " for char in name.lower()).split()
