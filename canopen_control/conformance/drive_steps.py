"""Steps of drive checks: reading, commands of the power state machine, modes, option codes (CiA 402-2)."""

from __future__ import annotations

from contextlib import contextmanager, suppress
from typing import TYPE_CHECKING

from canopen_control.cia402 import objects as o
from canopen_control.cia402.modes import OperationMode
from canopen_control.cia402.state import State, decode_statusword
from canopen_control.conformance.check import expect
from canopen_control.conformance.checked_node import CheckFailed, NotApplicable
from canopen_control.errors import RemoteProtocolError, SdoAbort

if TYPE_CHECKING:
    from collections.abc import Iterator

    from canopen_control.conformance.checked_node import CheckedNode


DRIVES = 402  # low word of 0x1000
STEP_S = 0.005  # interval of repeated uploads
LIMIT_S = 10.0  # longest time of a transition, or of a change of mode
_STANDING = (OperationMode.PV, OperationMode.PP, OperationMode.CSV, OperationMode.CSP)
SOD, RTSO, ON, OE = State.SWITCH_ON_DISABLED, State.READY_TO_SWITCH_ON, State.SWITCHED_ON, State.OPERATION_ENABLED
QSA, FAULT = State.QUICK_STOP_ACTIVE, State.FAULT
_UP, _UP_WORDS = (SOD, RTSO, ON, OE), (0x06, 0x07, 0x0F)  # transitions 2, 3 and 4 (CiA 402-2, 6.3)


def is_drive(node: CheckedNode) -> None:
    """Raise NotApplicable unless the device is a drive."""
    if int.from_bytes(node.read(0x1000)[:2], "little") != DRIVES:
        raise NotApplicable("the low word of 0x1000 is not 402: no drive")


def signed(node: CheckedNode, index: int, subindex: int = 0) -> int:
    """Read a signed number; raise NotApplicable if the device does not have the object."""
    return int.from_bytes(node.optional(index, subindex), "little", signed=True)


def statusword(node: CheckedNode) -> int:
    """Read 0x6041."""
    return int.from_bytes(node.read(o.STATUSWORD), "little")


def expect_bits(node: CheckedNode, mask: int, value: int, expected: str) -> None:
    """Check that the statusword has `value` in the bits of `mask`; `expected` is the text for the report."""
    word = statusword(node)
    expect(word & mask == value, f"statusword 0x{word:04X}", expected)


def control(node: CheckedNode, word: int) -> None:
    """Write 0x6040."""
    node.put(o.CONTROLWORD, 0, word, 2)


def reset_fault(node: CheckedNode) -> None:
    """Command a fault reset, which needs a rising edge of bit 7 (CiA 402-2, transition 15)."""
    control(node, 0x00)
    control(node, 0x80)


def reaches(node: CheckedNode, state: State, seconds: float = LIMIT_S) -> float:
    """Wait until the drive reaches a state; return the time in s, or raise CheckFailed after the timeout."""
    begin = node.reactor.now()
    while True:
        word = statusword(node)
        elapsed = (node.reactor.now() - begin) / 1e9
        if decode_statusword(word) is state:
            return elapsed
        if elapsed >= seconds:
            shown = decode_statusword(word)
            name = "no state" if shown is None else shown.name
            raise CheckFailed(f"statusword 0x{word:04X} ({name}) after {seconds:g} s", state.name)
        node.listen(STEP_S if elapsed < 1.0 else 10 * STEP_S)


def stays(node: CheckedNode, state: State, seconds: float) -> None:
    """Check that the drive stays in a state for `seconds`."""
    for _ in range(10):
        word = statusword(node)
        shown = decode_statusword(word)
        expect(shown is state, "no state" if shown is None else shown.name, f"{state.name} for {seconds:g} s")
        node.listen(seconds / 10)


def go(node: CheckedNode, goal: State) -> None:
    """Bring the drive to the state `goal`, with one controlword per transition."""
    for _ in range(8):
        state = decode_statusword(statusword(node))
        if state is goal:
            return
        if state in (FAULT, State.FAULT_REACTION_ACTIVE):
            reaches(node, FAULT)
            reset_fault(node)
            reaches(node, SOD)
            continue
        control(node, _word_to(state, goal))
        _wait_until_left(node, state)
    reaches(node, goal, 0.1)


def _word_to(state: State | None, goal: State) -> int:
    """Return the controlword of the next transition from `state` towards `goal`, one of `_UP`."""
    if state not in _UP or goal is _UP[0]:
        return 0x00
    place, target = _UP.index(state), _UP.index(goal)
    return _UP_WORDS[place] if place < target else _UP_WORDS[target - 1]


def _wait_until_left(node: CheckedNode, state: State | None) -> None:
    for _ in range(round(LIMIT_S / 0.02)):
        if decode_statusword(statusword(node)) is not state:
            return
        node.listen(0.02 if state is not OE else STEP_S)


def set_mode(node: CheckedNode, mode: int) -> None:
    """Select a mode of operation and wait for it in 0x6061; raise NotApplicable if 0x6502 does not list the mode."""
    if not node.number(o.SUPPORTED_DRIVE_MODES) >> (mode - 1) & 1:
        raise NotApplicable(f"0x6502 does not list mode {mode}")
    node.put(o.MODES_OF_OPERATION, 0, mode, 1)
    for _ in range(round(LIMIT_S / 0.02)):
        if signed(node, o.MODES_OF_OPERATION_DISPLAY) == mode:
            return
        node.listen(0.02)


def select_standstill_mode(node: CheckedNode) -> None:
    """Select a mode in which an enabled drive does not move; raise NotApplicable if the drive has none."""
    modes = node.number(o.SUPPORTED_DRIVE_MODES)
    mode = next((mode for mode in _STANDING if modes >> (mode - 1) & 1), None)
    if mode is None:
        raise NotApplicable("0x6502 lists neither PV, PP, CSV nor CSP")
    if mode in (OperationMode.PV, OperationMode.CSV):
        node.put(o.TARGET_VELOCITY, 0, 0, 4)
    else:
        node.write(o.TARGET_POSITION, 0, node.read(o.POSITION_ACTUAL))
    node.put(o.MODES_OF_OPERATION, 0, mode, 1)


@contextmanager
def drive_at(node: CheckedNode, goal: State, mode: int | None = None) -> Iterator[None]:
    """Context with the drive in the state `goal`; on exit the drive is switched off and its mode restored."""
    is_drive(node)
    with node.operational():
        before = node.read(o.MODES_OF_OPERATION)
        try:
            if mode is None:
                select_standstill_mode(node)
            else:
                set_mode(node, mode)
            go(node, goal)
            yield
        finally:
            with suppress(RemoteProtocolError):
                control(node, 0)
                for _ in range(100):
                    if decode_statusword(statusword(node)) in (SOD, FAULT):
                        break
                    node.listen(0.05)
                if decode_statusword(statusword(node)) is FAULT:
                    control(node, 0x80)
                    node.listen(0.05)
                    control(node, 0)
                node.write(o.MODES_OF_OPERATION, 0, before)


@contextmanager
def option(node: CheckedNode, index: int, value: int) -> Iterator[None]:
    """Context with an option code set to `value`; raise NotApplicable if the drive refuses the value."""
    with node.kept(index):
        try:
            node.put(index, 0, value, 2)
        except SdoAbort as error:
            raise NotApplicable(f"0x{index:04X} refuses {value}: 0x{error.code:08X}") from None
        yield
