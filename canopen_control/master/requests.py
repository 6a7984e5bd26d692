"""The requests that a boot (`boot.boot`) yields and that its runner (`boot_task.BootTask`) answers.

A request is data, answered by what its docstring says, or by `SdoAbort`, `SdoTimeout` or
`SdoLengthError` thrown into the generator.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from canopen_control.errors import BootError, SdoAbort, SdoLengthError, SdoStopped, SdoTimeout

if TYPE_CHECKING:
    from collections.abc import Generator

    from canopen_control.cia301.nmt import NmtCommand, NmtState
    from canopen_control.master.plan import NodePlan
    from canopen_control.master.plan_builder import PlannedPdo
    from canopen_control.od.model import Value


#: the error status of CiA 302-2, table 14; T is ours
LETTERS = {
    "A": "not in the list of nodes",
    "B": "no answer",
    "C": "another device type",
    "D": "another vendor",
    "E": "kept alive, but no heartbeat shows its state",
    "F": "kept alive, but guarding is not answered",
    "G": "its software version cannot be told",
    "H": "another software version",
    "I": "another software version, and firmware is not downloaded",
    "J": "configuration failed",
    "K": "no heartbeat after the configuration",
    "L": "was operational already",
    "M": "another product",
    "N": "another revision",
    "O": "another serial number",
    "T": "never became operational",
}


@dataclass(frozen=True, slots=True)
class NextStep:
    """From here on the boot does what `name` says; answered with None."""

    name: str


@dataclass(frozen=True, slots=True)
class Read:
    """Upload an object; answered with its bytes."""

    index: int
    subindex: int = 0


@dataclass(frozen=True, slots=True)
class WriteObject:
    """Download an object; answered with None. `timeout_ns` is for objects that take their time."""

    index: int
    subindex: int
    data: bytes
    timeout_ns: int | None = None


@dataclass(frozen=True, slots=True)
class SendNmt:
    """Send an NMT command to the node; answered with None."""

    command: NmtCommand


@dataclass(frozen=True, slots=True)
class AwaitBootUp:
    """Wait for the boot-up message; answered with whether it came."""

    timeout_ns: int


@dataclass(frozen=True, slots=True)
class AwaitState:
    """Wait for a heartbeat, of a certain state if one is given; answered with whether it came.

    A TPDO says OPERATIONAL as well as a heartbeat does: no other state sends any.
    """

    timeout_ns: int
    state: NmtState | None = None


@dataclass(frozen=True, slots=True)
class AwaitHeartbeat:
    """Wait for a heartbeat; answered with the state it shows, or None."""

    timeout_ns: int


Request = NextStep | Read | WriteObject | SendNmt | AwaitBootUp | AwaitState | AwaitHeartbeat
Answer = bytes | bool | int | None


class BootTransfers:
    """The SDO requests of one boot, counted, and what it has to tell besides.

    `adopted` are the PDOs that are used as the node has them, `presets` the values that process data begin with.
    """

    def __init__(self) -> None:
        self.reads = 0
        self.writes = 0
        self.warnings: list[str] = []
        self.adopted: list[tuple[str, PlannedPdo]] = []
        self.presets: dict[tuple[int, int], Value] = {}
        self._before = 0

    @property
    def changed(self) -> bool:
        """Whether the configuration of the node was changed by this boot."""
        return self.writes > self._before

    def begin_configuration(self) -> None:
        """Count what is written from here on as changes of the configuration."""
        self._before = self.writes

    def read(self, index: int, subindex: int = 0) -> Generator[Request, Answer, bytes]:
        """Upload; raises SdoAbort, SdoTimeout, SdoLengthError."""
        self.reads += 1
        data = yield Read(index, subindex)
        return data if isinstance(data, bytes) else b""

    def try_read(self, index: int, subindex: int = 0) -> Generator[Request, Answer, bytes | None]:
        """Upload what a node need not have, or need not show: None where it refuses.

        Raises SdoTimeout, SdoLengthError.
        """
        try:
            return (yield from self.read(index, subindex))
        except SdoAbort:
            return None

    def held(self, index: int, subindex: int = 0) -> Generator[Request, Answer, bytes | None]:
        """Upload what is to be compared: None, and a warning, for what has another length than the EDS says.

        Raises SdoTimeout.
        """
        try:
            return (yield from self.try_read(index, subindex))
        except SdoLengthError as error:
            self.warnings.append(f"0x{index:04X}:{subindex:02X}: {error.answered} by its EDS; taken as another value")
            return None

    def number(self, index: int, subindex: int = 0, *, signed: bool = False) -> Generator[Request, Answer, int | None]:
        """Upload a number that a node need not have."""
        data = yield from self.try_read(index, subindex)
        return None if data is None else int.from_bytes(data, "little", signed=signed)

    def write(
        self, index: int, subindex: int, data: bytes, timeout_ns: int | None = None
    ) -> Generator[Request, Answer, None]:
        """Download; raises SdoAbort, SdoTimeout. Only what the node took is counted."""
        yield WriteObject(index, subindex, data, timeout_ns)
        self.writes += 1


def boot_error(plan: NodePlan, letter: str, detail: str) -> BootError:
    """Return the error of a boot, with the standard's words and the object or reason."""
    return BootError(plan.node_id, letter, f"{LETTERS[letter]}: {detail}", plan.name)


def reason_of(error: SdoAbort | SdoTimeout | SdoLengthError) -> str:
    """Return why an SDO request failed, without the node and object that the caller names itself."""
    if isinstance(error, SdoAbort):
        return f"abort 0x{error.code:08X} ({error.text})"
    if isinstance(error, SdoLengthError):
        return error.answered
    if isinstance(error, SdoStopped):
        return f"no answer within {error.seconds:g} s; {error.hint}"
    return f"no answer within {error.seconds:g} s; is the node powered, on this bus and its node id right?"
