"""The boot of one node (CiA 302-2, boot slave), as a generator that asks and is answered.

The law of this file: it decides, it does nothing. `boot` yields requests (`Read`, `Write`, `Command`, the waits) and is
sent their results, or has `SdoAbort` and `SdoTimeout` thrown into it; whoever runs it (`node.RemoteNode`) never waits.
A failure is a `BootError` with the standard's letter: B no answer, C device type, D vendor, M product, N revision,
O serial number, J configuration, K no heartbeat, T (ours) not operational. `Step` marks where the time goes.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from canopen_control.cia301.nmt import NmtCommand, NmtState
from canopen_control.errors import BootError, SdoAbort, SdoTimeout

if TYPE_CHECKING:
    from collections.abc import Generator

    from canopen_control.master.plan import NodePlan, PlannedWrite

__all__ = ["AwaitBootUp", "AwaitState", "BootResult", "Command", "Read", "Request", "Step", "Write", "boot"]

_MILLISECOND = 1_000_000
BOOT_UP_NS = 1000 * _MILLISECOND  # CiA 302: how long a reset node may take to send its boot-up
STATE_NS = 500 * _MILLISECOND  # for the heartbeat that confirms an NMT command, beside its own period
NMT_TRIES = 3  # NMT commands are unconfirmed: send again when no heartbeat shows the state
DEVICE_TYPE, IDENTITY, SUPPORTED_MODES, STATUSWORD, CONTROLWORD = 0x1000, 0x1018, 0x6502, 0x6041, 0x6040
_OPERATION_ENABLED_BIT = 0x04
_SHUTDOWN = 0x0006


@dataclass(frozen=True, slots=True)
class Step:
    """From here on the boot does what `name` says; answered with None."""

    name: str


@dataclass(frozen=True, slots=True)
class Read:
    """Upload an object; answered with its bytes."""

    index: int
    subindex: int = 0


@dataclass(frozen=True, slots=True)
class Write:
    """Download an object; answered with None."""

    index: int
    subindex: int
    data: bytes


@dataclass(frozen=True, slots=True)
class Command:
    """Send an NMT command to the node; answered with None."""

    command: NmtCommand


@dataclass(frozen=True, slots=True)
class AwaitBootUp:
    """Wait for the boot-up message; answered with whether it came."""

    timeout_ns: int


@dataclass(frozen=True, slots=True)
class AwaitState:
    """Wait for a heartbeat, of a certain state if one is given; answered with whether it came."""

    timeout_ns: int
    state: NmtState | None = None


Request = Step | Read | Write | Command | AwaitBootUp | AwaitState
_Answer = bytes | bool | None


@dataclass(frozen=True, slots=True)
class BootResult:
    """What the boot learnt of the node; -1 or None where it does not say."""

    vendor_id: int
    product_code: int
    revision_number: int
    serial_number: int
    supported_modes: int | None
    writes: int
    warnings: tuple[str, ...]


def boot(plan: NodePlan, *, reset: bool) -> Generator[Request, _Answer, BootResult]:
    """Bring one node from wherever it is to OPERATIONAL.

    `reset` sends NMT reset communication first, so that a node left over from an earlier run forgets its
    configuration; a node that has just sent its boot-up needs none.
    """
    if reset:
        yield Step("reset")
        yield Command(NmtCommand.RESET_COMMUNICATION)
        yield AwaitBootUp(BOOT_UP_NS)  # not all nodes send one; who is not there is found by the next step
    yield Step("identify")
    identity, warnings = yield from _identify(plan)
    modes = yield from _prepare_drive(plan)
    yield Step("configure")
    for write in plan.writes:
        yield from _configure(plan, write)
    yield Step("heartbeat")
    if plan.heartbeat_timeout_ns and not (yield AwaitState(plan.heartbeat_timeout_ns)):
        raise BootError(
            plan.node_id,
            "K",
            f"no heartbeat within {plan.heartbeat_timeout_ns / 1e9:g} s of its configuration",
            plan.name,
        )
    yield Step("start")
    yield from _start(plan)
    return BootResult(*identity, modes, len(plan.writes), tuple(warnings))


def _identify(plan: NodePlan) -> Generator[Request, _Answer, tuple[tuple[int, int, int, int], list[str]]]:
    """Compare device type and identity with the EDS: CiA 302-2, steps 3 to 8."""
    try:
        device_type = yield from _unsigned(DEVICE_TYPE, 0)
    except (SdoTimeout, SdoAbort) as error:
        raise BootError(plan.node_id, "B", f"no device type: {_reason(error)}", plan.name) from error
    expected = plan.identity
    if expected.device_type and device_type != expected.device_type:
        raise _mismatch(plan, "C", "device type 0x1000:00", device_type, expected.device_type)
    found = []
    for subindex, letter, what, wanted in (
        (1, "D", "vendor id", expected.vendor_id),
        (2, "M", "product code", expected.product_code),
        (3, "N", "revision number", expected.revision_number),
        (4, "O", "serial number", expected.serial_number),
    ):
        value = yield from _optional(IDENTITY, subindex)
        found.append(value)
        if wanted and value != wanted:
            raise _mismatch(plan, letter, f"{what} 0x1018:{subindex:02X}", value, wanted)
    warnings = []
    if expected.eds_revision and found[2] != expected.eds_revision:
        warnings.append(
            f"revision number 0x{found[2]:08X}, the EDS was written for 0x{expected.eds_revision:08X}; "
            "give revision_number in bus.yml to insist on one"
        )
    return (found[0], found[1], found[2], found[3]), warnings


def _prepare_drive(plan: NodePlan) -> Generator[Request, _Answer, int | None]:
    """Read the modes of a drive, and take its power away if it was left enabled; None if it is no drive."""
    if not plan.axes:
        return None
    modes = 0
    for offset in plan.axes:
        modes = yield from _optional(SUPPORTED_MODES + offset, 0)
        statusword = yield from _optional(STATUSWORD + offset, 0)
        if statusword >= 0 and statusword & _OPERATION_ENABLED_BIT:
            yield Write(CONTROLWORD + offset, 0, _SHUTDOWN.to_bytes(2, "little"))
    return modes if modes >= 0 else None


def _configure(plan: NodePlan, write: PlannedWrite) -> Generator[Request, _Answer, None]:
    try:
        yield Write(write.index, write.subindex, write.data)
    except (SdoAbort, SdoTimeout) as error:
        if write.optional and isinstance(error, SdoAbort):
            return
        raise BootError(
            plan.node_id,
            "J",
            f"writing {write.name} 0x{write.index:04X}:{write.subindex:02X}: {_reason(error)}",
            plan.name,
        ) from error


def _start(plan: NodePlan) -> Generator[Request, _Answer, None]:
    """Start the node, and again if no heartbeat shows it (a command may be lost)."""
    if not plan.heartbeat_timeout_ns:
        yield Command(NmtCommand.START)  # nothing would confirm it
        return
    for _ in range(NMT_TRIES):
        yield Command(NmtCommand.START)
        if (yield AwaitState(STATE_NS + plan.heartbeat_timeout_ns, NmtState.OPERATIONAL)):
            return
    raise BootError(
        plan.node_id, "T", f"NMT start sent {NMT_TRIES} times, its heartbeat never said OPERATIONAL", plan.name
    )


def _unsigned(index: int, subindex: int) -> Generator[Request, _Answer, int]:
    data = yield Read(index, subindex)
    return int.from_bytes(data, "little") if isinstance(data, bytes) else -1


def _optional(index: int, subindex: int) -> Generator[Request, _Answer, int]:
    """Read an object that a node need not have: -1 if it has none."""
    try:
        return (yield from _unsigned(index, subindex))
    except SdoAbort:
        return -1


def _mismatch(plan: NodePlan, letter: str, what: str, found: int, wanted: int) -> BootError:
    seen = f"0x{found:08X}" if found >= 0 else "missing"
    return BootError(
        plan.node_id,
        letter,
        f"{what} is {seen}, expected 0x{wanted:08X} (from {plan.source}); wrong device at this node id, or wrong EDS?",
        plan.name,
    )


def _reason(error: SdoAbort | SdoTimeout) -> str:
    if isinstance(error, SdoAbort):
        return f"abort 0x{error.code:08X} ({error.text})"
    return f"no answer within {error.seconds:g} s; is the node powered, on this bus and its node id right?"
