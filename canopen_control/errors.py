"""Exceptions of this package, and suggestions for misspelled names.

CanopenError
  ConfigError            an error in a file, option or argument of the user
    NoRobotError           no robot is running
    EdsError               an EDS or DCF file: path, line, reason
    BusConfigError         a bus.yml: path, line, key, reason
    RobotConfigError       controllers, description, or their combination with the bus
  DiskFull               a file was not written completely: path, reason, kept
  BusError               the bus or the driver of its adapter
    BusClosed              the channel is gone or was closed
    BusOff                 the CAN controller left the bus
    InterfaceNotFound      no such channel
      BusNotOpen             a local: bus is not open
    InterfaceDown          the interface exists but is down
  ProtocolError          a violation of the CANopen protocol (never raised itself)
    LocalProtocolError     by the caller, whose request is invalid
    RemoteProtocolError    by the other side: node_id
      SdoAbort               the transfer was aborted: node_id, index, subindex, code
      SdoTimeout             no answer: node_id, index, subindex
        SdoStopped             because the node is in NMT STOPPED
      SdoRestarted           the node has booted during a transfer: node_id, index, subindex
      SdoCancelled           the transfer was cancelled by its client: node_id, index, subindex
      SdoLengthError         an answer whose length does not fit the object: node_id, index, subindex, data
      BootError              the boot of a node failed (CiA 302-2): node_id, letter, step
      HeartbeatLost          a node was silent for longer than its heartbeat time: node_id, age
  DriveError             an error of a drive
    UnsupportedMode        the drive lacks the mode of operation: mode, supported
  ControlError           an error of controllers
    InterfaceConflict      a command interface already has an owner: interface, owner
    NotEnabled             a command to a drive that is not enabled, which is discarded
      NotYetEnabled          the drive is being enabled: a later command may be accepted
    TrajectoryRefused      a trajectory violates a rule: code
    UnknownInterface       no component exports the interface: name
    UnknownName            the robot has no node, joint, controller, component or mode with this name
    WrongValueCount        a command has another number of values than its controller
  RemoteError            a running robot refused a request: kind
    UnreadableMessage      a pushed message cannot be read

Most classes have the fields listed here; the message states the error, its place and advice. ``OSError`` and
``can.CanError`` of a bus are converted to these classes in `bus`, and nowhere else.
"""

from __future__ import annotations

TYPE_CHECKING = False  # the module typing takes longer to import than this one
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
    "NoRobotError",
    "NotEnabled",
    "NotYetEnabled",
    "ProtocolError",
    "RemoteError",
    "RemoteProtocolError",
    "RobotConfigError",
    "SdoAbort",
    "SdoCancelled",
    "SdoLengthError",
    "SdoRestarted",
    "SdoStopped",
    "SdoTimeout",
    "TrajectoryRefused",
    "UnknownInterface",
    "UnknownName",
    "UnreadableMessage",
    "UnsupportedMode",
    "WrongValueCount",
    "closest",
    "nearest",
    "without_node",
]


def _node(node_id: int, name: str = "") -> str:
    return f"node {node_id} ({name})" if name else f"node {node_id}"


def without_node(text: str, node_id: int, name: str = "") -> str:
    """Return the text of an error without the node at its start, for a sentence that already names the node."""
    for node in (_node(node_id, name), _node(node_id)):
        rest = text.removeprefix(node)
        if rest != text and rest[:1] in (":", " ") and not rest.startswith(" ("):
            return rest.removeprefix(":").strip() if rest.startswith(":") else f"it{rest}"
    return text


class CanopenError(Exception):
    """Base class of all errors raised by this package."""

    @property
    def of_usage(self) -> bool:
        """Whether the error is in the user's input: nothing was done, and the command line exits with code 2."""
        return isinstance(self, _OF_USAGE)


class ConfigError(CanopenError):
    """Error in a user's file, option or argument."""


class NoRobotError(ConfigError):
    """Error of a verb that needs a running robot, while none is running."""


class EdsError(ConfigError):
    """Error that makes an EDS or DCF file unusable."""

    def __init__(self, path: str, line: int, reason: str) -> None:
        self.path, self.line, self.reason = path, line, reason
        super().__init__(f"{path}:{line}: {reason}" if line else f"{path}: {reason}")


class BusConfigError(ConfigError):
    """Errors in a bus.yml; `reason` contains all errors of the file, one per paragraph."""

    def __init__(self, path: str, line: int, key: str, reason: str) -> None:
        self.path, self.line, self.key, self.reason = path, line, key, reason
        super().__init__(reason)


class RobotConfigError(ConfigError):
    """Error in the controllers or the description, in their combination with the bus, or a missing file."""


class DiskFull(CanopenError):
    """Failure to write a file because of a full disk or a disk error; `kept` says what remains of the file."""

    def __init__(self, path: str, reason: str, remains: str) -> None:
        self.path, self.reason, self.kept = path, reason, remains
        super().__init__(f"{path}: {reason}; {remains}")


class BusError(CanopenError):
    """Error of a CAN bus or of an adapter's driver."""


class BusClosed(BusError):
    """Use of a closed or lost channel."""

    def __init__(self, channel: str, reason: str = "closed") -> None:
        self.channel, self.reason = channel, reason
        super().__init__(f"bus {channel}: {reason}")


class BusOff(BusError):
    """CAN controller in the bus-off state, after too many transmission errors."""

    def __init__(self, channel: str) -> None:
        self.channel = channel
        super().__init__(f"bus {channel}: bus-off; check the cable, the terminators and the bit rate")


class InterfaceNotFound(BusError):
    """CAN channel that does not exist; `hint` is the advice to the user."""

    def __init__(self, name: str, hint: str = "") -> None:
        self.name, self.hint = name, hint
        super().__init__(f"no CAN interface {name!r}" + (f"; {hint}" if hint else ""))


class BusNotOpen(InterfaceNotFound):
    """Access to a ``local:`` bus that no program has open; `others` contains the local buses that are open."""

    def __init__(self, name: str, others: Sequence[str] = ()) -> None:
        names = f"open now: {', '.join(others)}" if others else "no local bus is open now"
        super().__init__(name, f"{names}; start one with canopen-control run or canopen-control drive")
        self.args = (f"bus {name}: no program has it open; {self.hint}",)


class InterfaceDown(BusError):
    """Use of a CAN interface that exists but is down."""

    def __init__(self, name: str, hint: str = "") -> None:
        self.name = name
        super().__init__(f"CAN interface {name} is down; {hint or f'bring it up: ip link set {name} up'}")


class ProtocolError(CanopenError):
    """Base class of violations of the CANopen protocol, by the caller or by the other side."""


class LocalProtocolError(ProtocolError):
    """Invalid request by the caller; nothing was changed."""


class RemoteProtocolError(ProtocolError):
    """Violation of the protocol by the other side, or a missing response."""

    def __init__(self, node_id: int, reason: str) -> None:
        self.node_id = node_id
        super().__init__(reason)


class SdoAbort(RemoteProtocolError):
    """SDO transfer that was aborted (CiA 301, table 22).

    `code` is the 32-bit abort code, `text` its meaning; `name` is the name of the node, if known.
    """

    def __init__(self, node_id: int, index: int, subindex: int, code: int, text: str = "", name: str = "") -> None:
        self.index, self.subindex, self.code, self.text = index, subindex, code, text
        super().__init__(
            node_id,
            f"{_node(node_id, name)}: 0x{index:04X}:{subindex:02X}: abort 0x{code:08X} ({text or 'unknown code'})",
        )


class SdoTimeout(RemoteProtocolError):
    """SDO request without a response; `seconds` is the total timeout of all attempts."""

    hint = "is the node powered and its node-ID right?"

    def __init__(self, node_id: int, index: int, subindex: int, seconds: float, name: str = "") -> None:
        self.index, self.subindex, self.seconds, self.name = index, subindex, seconds, name
        super().__init__(
            node_id,
            f"{_node(node_id, name)}: 0x{index:04X}:{subindex:02X}: no answer within {seconds:g} s; {self.hint}",
        )


class SdoStopped(SdoTimeout):
    """SDO request to a node in NMT state STOPPED, in which it does not answer SDO (CiA 301, 7.3.2.2.5)."""

    hint = "its heartbeat reports NMT STOPPED, in which a node answers no SDO; use `nmt preop` or `nmt start`"

    def __init__(self, silence: SdoTimeout) -> None:
        super().__init__(silence.node_id, silence.index, silence.subindex, silence.seconds, silence.name)


class SdoRestarted(RemoteProtocolError):
    """SDO transfer that failed because the node booted during the transfer."""

    def __init__(self, node_id: int, index: int, subindex: int, name: str = "") -> None:
        self.index, self.subindex = index, subindex
        super().__init__(
            node_id,
            f"{_node(node_id, name)}: 0x{index:04X}:{subindex:02X}: the node restarted during the "
            "transfer; is its supply stable?",
        )


class SdoCancelled(RemoteProtocolError):
    """SDO transfer that its client has cancelled."""

    def __init__(self, node_id: int, index: int, subindex: int, name: str = "") -> None:
        self.index, self.subindex = index, subindex
        super().__init__(node_id, f"{_node(node_id, name)}: 0x{index:04X}:{subindex:02X}: the transfer was cancelled")


class SdoLengthError(RemoteProtocolError):
    """SDO upload whose `data` has the wrong length; `expected` is the correct type and length."""

    def __init__(
        self, node_id: int, index: int, subindex: int, data: bytes, expected: str, entry: str = "", name: str = ""
    ) -> None:
        self.index, self.subindex, self.data = index, subindex, data
        count = "1 byte" if len(data) == 1 else f"{len(data)} bytes"
        self.answered = f"answered {count}{f' ({data.hex(chr(32))})' if data else ''}, {expected}"
        label = f"0x{index:04X}:{subindex:02X}{f' {entry}' if entry else ''}"
        super().__init__(
            node_id,
            f"{_node(node_id, name)}: {label}: {self.answered}; is this the EDS of the device and its firmware?",
        )


class BootError(RemoteProtocolError):
    """Failed boot of a node; `letter` is the error status (A to O by CiA 302-2, or T), `step` describes the failure."""

    def __init__(self, node_id: int, letter: str, step: str, name: str = "") -> None:
        self.letter, self.step = letter, step
        super().__init__(node_id, f"{_node(node_id, name)}: boot error {letter}: {step}")


class HeartbeatLost(RemoteProtocolError):
    """Loss of a node's heartbeat; `age` is the time since its last heartbeat in s."""

    def __init__(self, node_id: int, age: float, name: str = "") -> None:
        self.age = age
        super().__init__(node_id, f"{_node(node_id, name)}: no heartbeat for {age:.3f} s; is it powered and connected?")


class DriveError(CanopenError):
    """Error of a drive, such as a command that the drive does not execute."""


class UnsupportedMode(DriveError):
    """Mode of operation that the drive does not list in 0x6502."""

    def __init__(self, mode: str, supported: tuple[str, ...]) -> None:
        self.mode, self.supported = mode, supported
        super().__init__(f"mode {mode} is not supported; 0x6502 lists {', '.join(supported) or 'none'}")


class ControlError(CanopenError):
    """Error of a controller, or a refused command, switch or claim."""


class InterfaceConflict(ControlError):
    """Claim of a command interface that already has an owner."""

    def __init__(self, interface: str, owner: str) -> None:
        self.interface, self.owner = interface, owner
        super().__init__(f"command interface {interface} is claimed by {owner}; deactivate that controller first")


class TrajectoryRefused(ControlError):
    """Refused trajectory; `code` is the result code of FollowJointTrajectory."""

    def __init__(self, message: str, code: int) -> None:
        self.code = code
        super().__init__(message)


class NotEnabled(ControlError):
    """Discarded command to drives that are not enabled."""


class NotYetEnabled(NotEnabled):
    """Command to drives that are being enabled; a later command may be accepted."""


class UnknownInterface(ControlError):
    """Unknown command or state interface; `known` contains the existing interfaces."""

    def __init__(self, name: str, known: tuple[str, ...] = ()) -> None:
        self.name, self.known = name, known
        super().__init__(f"no interface {name!r}" + (f"; available: {', '.join(known)}" if known else ""))


class UnknownName(ControlError):
    """Unknown name of a node, joint, controller, component or mode; nothing was done. The command line exits with 2."""


class WrongValueCount(ControlError):
    """Command with another number of values than its controller has, which was discarded (exit code 2)."""


class RemoteError(CanopenError):
    """Request refused by a running robot; `kind` is the class name of the error."""

    def __init__(self, kind: str, message: str) -> None:
        self.kind = kind
        super().__init__(message)

    @property
    def of_usage(self) -> bool:
        """Whether the robot's error is in the user's input."""
        kind = globals().get(self.kind)
        return isinstance(kind, type) and issubclass(kind, _OF_USAGE)


class UnreadableMessage(RemoteError):
    """Pushed message that cannot be read, for example from another version; later messages may be readable."""

    def __init__(self, message: str) -> None:
        super().__init__("RemoteProtocolError", message)


_OF_USAGE = (ConfigError, InterfaceDown, InterfaceNotFound, UnknownName, WrongValueCount)


_MIN_RATIO = 0.6  # minimum ratio of difflib for a suggestion
_OPPOSITES = (
    *({"left", "right"}, {"front", "rear"}, {"front", "back"}, {"upper", "lower"}, {"min", "max"}),
    *({"enabled", "disabled"}, {"enabled", "disable"}),
)


def nearest(name: str, known: Iterable[str], *, listed: bool = True) -> str:
    """Return ` (did you mean 'x'?)` for a similar known name, else a list of the known names if `listed`, else "".

    The words of a name may be in another order, and the letters of another case; a name with the opposite meaning
    (left, right) is not suggested.
    """
    names = [str(name_of_known) for name_of_known in known]
    if best := closest(name, names):
        return f" (did you mean {best!r}?)"
    return f"; known: {', '.join(names)}" if names and listed else ""


def closest(name: str, known: Iterable[str]) -> str:
    """Return the most similar known name, as `nearest` suggests it, or ""."""
    import difflib  # needed only for a mistake

    words = _words(name)

    def ratio(candidate: str) -> float:
        candidate_words = _words(candidate)
        if any(pair <= set(words) ^ set(candidate_words) for pair in _OPPOSITES):
            return 0.0
        orders = (name, candidate), (" ".join(sorted(words)), " ".join(sorted(candidate_words)))
        lowered = name.lower(), candidate.lower()
        return max(difflib.SequenceMatcher(None, *order).ratio() for order in (*orders, lowered))

    best = max(known, key=ratio, default="")
    return best if best and ratio(best) >= _MIN_RATIO else ""


def _words(name: str) -> list[str]:
    return "".join(char if char.isalnum() else " " for char in name.lower()).split()
