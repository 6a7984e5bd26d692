"""Requests that the boot generator (`boot.boot`) yields and `boot.BootTask` answers.

A request is plain data; the docstring of its class says what the answer is. Instead of an answer, `SdoAbort`,
`SdoTimeout` or `SdoLengthError` may be thrown into the generator.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from canopen_control.errors import BootError, SdoAbort, SdoLengthError, SdoStopped, SdoTimeout

if TYPE_CHECKING:
    from collections.abc import Generator

    from canopen_control.cia301.nmt import NmtCommand, NmtState
    from canopen_control.cia402.motors import MotorMap
    from canopen_control.master.plan import NodePlan
    from canopen_control.master.plan_builder import PlannedPdo
    from canopen_control.od.model import Value


#: error status of CiA 302-2, table 14; T is an addition of this package
LETTERS = {
    "A": "not in the list of nodes",
    "B": "no answer",
    "C": "another device type",
    "D": "another vendor",
    "E": "kept alive, but no heartbeat shows its state",
    "F": "kept alive, but guarding is not answered",
    "G": "its software version cannot be read",
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
    """Beginning of the boot step `name`, for timing; the answer is None."""

    name: str


@dataclass(frozen=True, slots=True)
class Read:
    """SDO upload of an object; the answer is its bytes."""

    index: int
    subindex: int = 0


@dataclass(frozen=True, slots=True)
class WriteObject:
    """SDO download of an object, with `timeout_ns` for slow objects (None: default); the answer is None."""

    index: int
    subindex: int
    data: bytes
    timeout_ns: int | None = None


@dataclass(frozen=True, slots=True)
class SendNmt:
    """NMT command for the node; the answer is None."""

    command: NmtCommand


@dataclass(frozen=True, slots=True)
class AwaitBootUp:
    """Wait for the boot-up message; the answer is True if it was received in time."""

    timeout_ns: int


@dataclass(frozen=True, slots=True)
class AwaitState:
    """Wait for a heartbeat, with `state` if given; the answer is True if it was received in time.

    A TPDO proves OPERATIONAL too, because TPDOs are sent in no other state.
    """

    timeout_ns: int
    state: NmtState | None = None


@dataclass(frozen=True, slots=True)
class AwaitHeartbeat:
    """Wait for a heartbeat; the answer is its NMT state, or None after the timeout."""

    timeout_ns: int


Request = NextStep | Read | WriteObject | SendNmt | AwaitBootUp | AwaitState | AwaitHeartbeat
Answer = bytes | bool | int | None


class BootTransfers:
    """SDO transfers of one boot, with counters and collected results.

    `adopted` are the PDOs that keep the node's own configuration, `presets` the initial values of process data.
    `motors` maps the objects of the axes of a device with several motors in one object set.
    """

    def __init__(self, motors: MotorMap | None = None) -> None:
        self.reads = 0
        self.writes = 0
        self._places = {} if motors is None else motors.places
        self.warnings: list[str] = []
        self.adopted: list[tuple[str, PlannedPdo]] = []
        self.presets: dict[tuple[int, int], Value] = {}
        self._before = 0

    @property
    def changed(self) -> bool:
        """Whether an object was written since `begin_configuration`."""
        return self.writes > self._before

    def begin_configuration(self) -> None:
        """Count later writes as changes of the configuration."""
        self._before = self.writes

    def read(self, index: int, subindex: int = 0) -> Generator[Request, Answer, bytes]:
        """Upload an object; raise SdoAbort, SdoTimeout or SdoLengthError if the transfer fails."""
        self.reads += 1
        place = self._places.get((index, subindex))
        data = yield Read(index, subindex) if place is None else Read(place.index, place.subindex)
        content = data if isinstance(data, bytes) else b""
        return content if place is None else place.part_of(content)

    def try_read(self, index: int, subindex: int = 0) -> Generator[Request, Answer, bytes | None]:
        """Upload an optional object; return None if the node refuses, raise SdoTimeout or SdoLengthError."""
        try:
            return (yield from self.read(index, subindex))
        except SdoAbort:
            return None

    def read_optional(self, index: int, subindex: int = 0) -> Generator[Request, Answer, bytes | None]:
        """Upload an object for comparison; return None if it is refused or (with a warning) has a wrong length.

        Raise SdoTimeout if the node does not answer.
        """
        try:
            return (yield from self.try_read(index, subindex))
        except SdoLengthError as error:
            self.warnings.append(
                f"0x{index:04X}:{subindex:02X}: {error.answered} by its EDS; treated as a different value"
            )
            return None

    def number(self, index: int, subindex: int = 0, *, signed: bool = False) -> Generator[Request, Answer, int | None]:
        """Upload an optional object as a number; return None and raise errors as `try_read` does."""
        data = yield from self.try_read(index, subindex)
        return None if data is None else int.from_bytes(data, "little", signed=signed)

    def write(
        self, index: int, subindex: int, data: bytes, timeout_ns: int | None = None
    ) -> Generator[Request, Answer, None]:
        """Download an object and count the write if it is accepted; raise SdoAbort or SdoTimeout if not."""
        place = self._places.get((index, subindex))
        address = (index, subindex) if place is None else place.address
        yield WriteObject(*address, data, timeout_ns)
        self.writes += 1


def boot_error(plan: NodePlan, letter: str, detail: str) -> BootError:
    """Return a BootError with the text for `letter`, followed by `detail`, the object or reason."""
    return BootError(plan.node_id, letter, f"{LETTERS[letter]}: {detail}", plan.name)


def reason_of(error: SdoAbort | SdoTimeout | SdoLengthError) -> str:
    """Return a text that says why an SDO request failed, without naming the node or object."""
    if isinstance(error, SdoAbort):
        return f"abort 0x{error.code:08X} ({error.text})"
    if isinstance(error, SdoLengthError):
        return error.answered
    if isinstance(error, SdoStopped):
        return f"no answer within {error.seconds:g} s; {error.hint}"
    return f"no answer within {error.seconds:g} s; is the node powered, on this bus and its node-ID right?"
