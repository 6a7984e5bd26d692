"""Every exception that this package raises on purpose.

CanopenError
  ConfigError            what the user wrote
    EdsError               an EDS or DCF file: path, line, reason
    BusConfigError         a bus.yml: path, line, key, reason
    RobotConfigError       controllers, description, or how the three fit together
  BusError               the wire or its driver
    BusClosed              the channel is gone or was closed
    BusOff                 the CAN controller left the bus
    InterfaceNotFound      no such channel
    InterfaceDown          the interface exists but is down
  ProtocolError          the rules of CANopen (never raised itself)
    LocalProtocolError     this side broke them: a defect of the caller
    RemoteProtocolError    the other side broke them: node_id
      SdoAbort               the transfer was aborted: node_id, index, subindex, code
      SdoTimeout             no answer: node_id, index, subindex
      BootError              CiA 302 boot failed: node_id, letter, step
      HeartbeatLost          silent for longer than its heartbeat time: node_id, age
  DriveError             the drive
    DriveFault             it reports a fault: node_id, error_code, emcy
    TransitionTimeout      it does not reach the wanted state: node_id, wanted, statusword
    UnsupportedMode        it lacks the mode of operation: mode, supported
  ControlError           the controllers
    InterfaceConflict      a command interface has an owner already: interface, owner
    UnknownInterface       nobody exports it: name
    UnknownName            the robot has no node, joint, controller, component or mode of that name

Each has fields, and a message made from them that says what, where and what to do next. ``OSError`` and
``can.CanError`` become one of these in `bus`, and nowhere else.
"""

from __future__ import annotations

__all__ = [
    "BootError",
    "BusClosed",
    "BusConfigError",
    "BusError",
    "BusOff",
    "CanopenError",
    "ConfigError",
    "ControlError",
    "DriveError",
    "DriveFault",
    "EdsError",
    "HeartbeatLost",
    "InterfaceConflict",
    "InterfaceDown",
    "InterfaceNotFound",
    "LocalProtocolError",
    "ProtocolError",
    "RemoteError",
    "RemoteProtocolError",
    "RobotConfigError",
    "SdoAbort",
    "SdoTimeout",
    "TransitionTimeout",
    "UnknownInterface",
    "UnknownName",
    "UnsupportedMode",
]


def _node(node_id: int, name: str = "") -> str:
    return f"node {node_id} ({name})" if name else f"node {node_id}"


class CanopenError(Exception):
    """Nothing else is raised on purpose."""


class ConfigError(CanopenError):
    """What the user wrote cannot be used; the command line exits with 2."""


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

    def __init__(self, node_id: int, index: int, subindex: int, seconds: float, name: str = "") -> None:
        self.index, self.subindex, self.seconds = index, subindex, seconds
        super().__init__(
            node_id,
            f"{_node(node_id, name)}: 0x{index:04X}:{subindex:02X}: no answer within {seconds:g} s; "
            "is the node powered and its node id right?",
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


class DriveFault(DriveError):
    """The drive reports a fault; `error_code` is 0x603F or the last EMCY code, `emcy` its text."""

    def __init__(self, node_id: int, error_code: int, emcy: str = "", name: str = "") -> None:
        self.node_id, self.error_code, self.emcy = node_id, error_code, emcy
        super().__init__(
            f"{_node(node_id, name)}: fault 0x{error_code:04X}"
            + (f" ({emcy})" if emcy else "")
            + "; remove the cause, then: axis fault-reset, axis enable"
        )


class TransitionTimeout(DriveError):
    """The drive did not reach the state `wanted` in time; `statusword` is the last one seen."""

    def __init__(self, node_id: int, wanted: str, statusword: int | None, name: str = "") -> None:
        self.node_id, self.wanted, self.statusword = node_id, wanted, statusword
        seen = "none seen" if statusword is None else f"0x{statusword:04X}"
        super().__init__(f"{_node(node_id, name)}: did not reach {wanted} in time, statusword {seen}")


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
        """Whether the words of the request were wrong, and nothing was done."""
        return self.kind == UnknownName.__name__
