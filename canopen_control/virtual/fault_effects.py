"""Effects of faults: on a device through the injection points of its services, and on its frames.

The function of a fault in the device is called when the fault is switched; with `on` False it exactly reverts the
effect. The names of the faults are in `fault_table` and in the modules of quirks.
"""

from __future__ import annotations

import struct
from typing import TYPE_CHECKING, TypeVar

from canopen_control.cia301.abort import AbortCode
from canopen_control.cia301.emcy import EmcyMessage, ErrorRegister
from canopen_control.cia301.nmt import NmtCommand, NmtState
from canopen_control.cia402 import objects as o
from canopen_control.frame import CanFrame, Service, cob_id

if TYPE_CHECKING:
    from collections.abc import Callable

    from canopen_control.virtual.communication_objects import ProgramArea
    from canopen_control.virtual.injection_point import InjectionPoint
    from canopen_control.virtual.virtual_drive import VirtualDrive
    from canopen_control.virtual.virtual_node import VirtualNode

    Switch = Callable[[VirtualNode, bool, int], None]
    Outgoing = Callable[[VirtualNode, CanFrame, int], list[tuple[int, CanFrame]]]  # (delay in ns, frame)
    Incoming = Callable[[VirtualNode, CanFrame, int], CanFrame | None]


T = TypeVar("T")
_MS = 1_000_000
_S = 1_000_000_000


def _each(action: Callable[[VirtualDrive, bool, int], None]) -> Switch:
    """Return a switch that applies `action` to every axis of the node."""

    def turn(node: VirtualNode, on: bool, now: int) -> None:
        for drive in node.drives.values():
            drive.advance(now)
            action(drive, on, now)
        node.outbox.values_changed()

    return turn


def _injects(point: Callable[[VirtualDrive], InjectionPoint[T]], value: T) -> Switch:
    """Return a switch that sets an injection point of every axis to `value`."""

    def action(drive: VirtualDrive, on: bool, _now: int) -> None:
        point(drive).switch(on, value)

    return _each(action)


def boot_after(delay_ns: int | None) -> Switch:
    """Return a switch that sets the time in ns from a reset to the boot-up message (None: the node never boots)."""

    def turn(node: VirtualNode, on: bool, now: int) -> None:
        node.set_reset_delay(delay_ns if on else 0, now)

    return turn


def brown_out(node: VirtualNode, _on: bool, now: int) -> None:
    """Switch the power of the node off and on again."""
    node.power_on(now)


def drop_out(node: VirtualNode, _on: bool, now: int) -> None:
    """Enter PRE-OPERATIONAL without an NMT command."""
    node.command(NmtCommand.ENTER_PRE_OPERATIONAL, now)


def start_by_itself(node: VirtualNode, on: bool, now: int) -> None:
    """Enter OPERATIONAL without an NMT command, now and after every boot."""
    node.self_starting.switch(on, True)
    if on and node.nmt.state is NmtState.PRE_OPERATIONAL:
        node.command(NmtCommand.START, now)


def short_emcy(node: VirtualNode, _on: bool, _now: int) -> None:
    """Send a four-byte EMCY with an unknown code."""
    node.outbox.send(CanFrame(node.emcy.cob_id, bytes.fromhex("CDAB8107")))


def partial_reset(node: VirtualNode, _on: bool, _now: int) -> None:
    """Send EMCY 0x0000 (error reset) with an error register that still shows a temperature error."""
    register = ErrorRegister.GENERIC | ErrorRegister.TEMPERATURE
    node.outbox.send(EmcyMessage(node.node_id, 0, register).encode(node.emcy.cob_id))


def flood(node: VirtualNode, now: int) -> None:
    """Send one message of an EMCY flood, with the time in ms as data."""
    data = (now // _MS & 0xFFFFFFFF).to_bytes(4, "little")
    node.outbox.send(EmcyMessage(node.node_id, 0xFF80, ErrorRegister.GENERIC, data).encode(node.emcy.cob_id))


def lasting_fault(code: int, register: int) -> Switch:
    """Return a switch that raises a fault on every axis; the cause persists while the switch is on."""
    return _each(lambda drive, on, now: _last(drive, on, now, code, register))


def _last(drive: VirtualDrive, on: bool, now: int, code: int, register: int, *, stubborn: bool = False) -> None:
    """Raise a fault on an axis with a persistent cause, or remove the cause if `on` is False."""
    if on:
        drive.power.hold_cause(code, until_communication_reset=stubborn)
        drive.fault(code, now, register=register)
    else:
        drive.power.drop_cause(code)


def stubborn_fault(node: VirtualNode, on: bool, now: int) -> None:
    """Raise a communication fault that can be cleared only after a reset of communication."""
    for drive in node.drives.values():
        _last(drive, on, now, 0x8120, ErrorRegister.COMMUNICATION, stubborn=True)


@_each
def power_stage_off(drive: VirtualDrive, on: bool, now: int) -> None:
    """Switch the supply of an axis's power stage off, or on again."""
    if on:
        drive.power.lose_voltage(now)
    else:
        drive.power.restore_voltage(now)


@_each
def supply_low(drive: VirtualDrive, on: bool, now: int) -> None:
    """Switch the supply of the power stage off with an undervoltage fault, or on again."""
    drive.power.voltage.switch(on, False)
    _last(drive, on, now, 0x3220, ErrorRegister.VOLTAGE)


@_each
def shaft_moved(drive: VirtualDrive, _on: bool, now: int) -> None:
    """Displace the shaft and the demand by 500 counts, as if moved by hand."""
    drive.mover.displace(500.0, now)


@_each
def count_lost(drive: VirtualDrive, _on: bool, _now: int) -> None:
    """Shift the encoder count by a million."""
    drive.objects.units.lose_counts(1_000_000.0)


@_each
def count_wraps(drive: VirtualDrive, _on: bool, _now: int) -> None:
    """Shift the encoder count to 1000 below the end of the 32-bit range."""
    units = drive.objects.units
    units.lose_counts(units.zero - drive.mover.plant.position + 0x7FFFFC17)


@_each
def limit_switch(drive: VirtualDrive, on: bool, now: int) -> None:
    """Activate or deactivate the positive limit switch at the current position."""
    if on:
        drive.mover.switches.close_positive(drive.mover.plant.position)
        drive.limit_switch_hit(1, now)
    else:
        drive.mover.switches.open_positive()


@_each
def homing_endless(drive: VirtualDrive, on: bool, _now: int) -> None:
    """Move limit and home switches out of reach of homing, or back; homing that begins meanwhile does not end."""
    drive.mover.switches.place(reachable=not on)
    drive.modes.homing.endless.switch(on, True)


def clock_off_by(ppm: float) -> Switch:
    """Return a switch that makes the node's clock fast by `ppm`, or slow if `ppm` is negative."""
    return lambda node, on, _now: node.set_clock_drift(ppm if on else 0.0)


def rpdos_lost(one_of: int) -> Switch:
    """Return a switch that makes the node lose every n-th RPDO (n: `one_of`)."""
    return lambda node, on, _now: node.pdos.input.lost.switch(on, one_of)


def wrong_entry(index: int, subindex: int, off: int) -> Switch:
    """Return a switch that adds `off` to an identity object."""

    def turn(node: VirtualNode, on: bool, _now: int) -> None:
        step = off if on else -off
        node.store.preset(index, subindex, node.store.number(index, subindex) + step)

    return turn


def _undefined(_word: int) -> int:
    return 0x0001


@_each
def status_undefined(drive: VirtualDrive, on: bool, _now: int) -> None:
    """Show the undefined statusword 0x0001 while the fault is on."""
    statusword = drive.readings.statusword
    changes = tuple(change for change in statusword.changes if change is not _undefined)
    statusword.changes = (*changes, _undefined) if on else changes


def inputs(kind: str) -> Switch:
    """Return a switch for the fault `kind` of the inputs of a device other than a drive."""

    def turn(node: VirtualNode, on: bool, now: int) -> None:
        if node.function is not None:
            node.function.break_inputs(kind, on=on, now=now)

    return turn


def hardware_error(node: VirtualNode, on: bool, _now: int) -> None:
    """Report a hardware error of the device (0x5000) while the fault is on."""
    if on:
        node.outbox.emergency(0x5000, ErrorRegister.GENERIC)
    else:
        node.outbox.clear_error(0x5000)


def output_overload(node: VirtualNode, on: bool, _now: int) -> None:
    """Switch the outputs off at the terminals, like an overload protection, and send EMCY 0x2310."""
    if node.function is not None:
        node.function.overloaded = on
    if on:
        node.outbox.emergency(0x2310, ErrorRegister.GENERIC | ErrorRegister.CURRENT)
    else:
        node.outbox.clear_error(0x2310)


def program_lost(node: VirtualNode, on: bool, now: int) -> None:
    """Erase the program in the flash and start the boot-loader, or restore the manufacturer's program."""
    if node.program is None:
        return
    if on:
        node.program.erase()
    else:
        node.program.restore_factory()
    node.power_on(now)


def _injects_in_program(point: Callable[[ProgramArea], InjectionPoint[T]], value: T) -> Switch:
    """Return a switch that sets an injection point of the program area to `value`."""

    def turn(node: VirtualNode, on: bool, _now: int) -> None:
        if node.program is not None:
            point(node.program).switch(on, value)

    return turn


program_damaged: Switch = _injects_in_program(lambda area: area.damages, True)
flash_failing: Switch = _injects_in_program(lambda area: area.fails_at, 1024)
flash_slow: Switch = _injects_in_program(lambda area: area.erase_ns, 12 * _S)
served_in_preop: Switch = _injects(lambda drive: drive.power.serves_preop, True)
mode_frozen: Switch = _injects(lambda drive: drive.modes.stuck, True)
local_control: Switch = _injects(lambda drive: drive.readings.statusword.remote, False)
warning: Switch = _injects(lambda drive: drive.readings.statusword.warning, True)
ack_missing: Switch = _injects(lambda drive: drive.readings.statusword.suppressed, 1 << 12)
ack_stuck: Switch = _injects(lambda drive: drive.readings.statusword.forced, 1 << 12)
reached_stuck: Switch = _injects(lambda drive: drive.readings.statusword.forced, 1 << 10)
fault_on_enable: Switch = _injects(lambda drive: drive.power.fault_on_enable, 0x5441)
reset_deaf: Switch = _injects(lambda drive: drive.power.reset_deaf, True)
inverted: Switch = _injects(lambda drive: drive.readings.inverted, True)
homing_failing: Switch = _injects(lambda drive: drive.modes.homing.fails, True)
over_temperature: Switch = lasting_fault(0x4310, ErrorRegister.TEMPERATURE)
short_circuit: Switch = lasting_fault(0x2320, ErrorRegister.CURRENT)
following_error: Switch = lasting_fault(0x8611, ErrorRegister.DEVICE_PROFILE)


def error_passive(node: VirtualNode, on: bool, _now: int) -> None:
    """Report that the CAN controller is error passive (EMCY 0x8120), or clear that error."""
    if on:
        node.outbox.emergency(0x8120, ErrorRegister.COMMUNICATION)
    else:
        node.outbox.clear_error(0x8120)


def recovered_from_bus_off(node: VirtualNode, on: bool, _now: int) -> None:
    """Report recovery from bus-off when the fault is switched off."""
    if not on:
        node.error_control.report_recovery()


# Effects on the frames that a node sends and receives: a function returns the resulting frames and changes nothing
# else.


_MUX = struct.Struct("<BHB")
_ABORT = 0x80


# -- kinds of frames


def is_heartbeat(node: VirtualNode, frame: CanFrame) -> bool:
    """Whether a frame is a heartbeat or boot-up message of the node."""
    return frame.can_id == cob_id(Service.HEARTBEAT, node.node_id)


def is_sdo_answer(node: VirtualNode, frame: CanFrame) -> bool:
    """Whether a frame is a response of the node's SDO server."""
    return frame.can_id == node.sdo.answer_cob_id and len(frame.data) == 8


def is_sdo_request(node: VirtualNode, frame: CanFrame) -> bool:
    """Whether a frame is a request to the node's SDO server."""
    return frame.can_id == node.sdo.request_cob_id and len(frame.data) == 8


def is_tpdo(node: VirtualNode, frame: CanFrame) -> bool:
    """Whether a frame is a TPDO of the node."""
    ids = {tpdo.producer.parameters.cob_id for tpdo in node.pdos.tpdos.values() if tpdo.producer.parameters.enabled}
    return frame.can_id in ids


# -- frames that leave


def drop_all(_node: VirtualNode, _frame: CanFrame, _now: int) -> list[tuple[int, CanFrame]]:
    """Drop all frames that leave the node."""
    return []


def _on(
    matches: Callable[[VirtualNode, CanFrame], bool], change: Callable[[CanFrame], list[tuple[int, CanFrame]]]
) -> Outgoing:
    def outgoing(node: VirtualNode, frame: CanFrame, _now: int) -> list[tuple[int, CanFrame]]:
        return change(frame) if matches(node, frame) else [(0, frame)]

    return outgoing


def _data(frame: CanFrame, data: bytes) -> list[tuple[int, CanFrame]]:
    return [(0, CanFrame(frame.can_id, data))]


def _wrong_mux(frame: CanFrame) -> list[tuple[int, CanFrame]]:
    command, index, subindex = _MUX.unpack_from(frame.data)
    return _data(frame, _MUX.pack(command, index + 1 & 0xFFFF, subindex) + frame.data[4:])


def _toggled(frame: CanFrame) -> list[tuple[int, CanFrame]]:
    if frame.data[0] >> 5 in (0, 1):
        return _data(frame, bytes((frame.data[0] ^ 0x10,)) + frame.data[1:])
    return [(0, frame)]


def _one_byte(frame: CanFrame) -> list[tuple[int, CanFrame]]:
    """Change the size in an expedited upload response of 2, 3 or 4 bytes to 1 byte."""
    if frame.data[0] in (0x43, 0x47, 0x4B):
        return _data(frame, b"\x4f" + frame.data[1:5] + b"\0\0\0")
    return [(0, frame)]


def _pre_operational(frame: CanFrame) -> list[tuple[int, CanFrame]]:
    return _data(frame, b"\x7f") if frame.data != b"\0" else [(0, frame)]


def jittered(node: VirtualNode, frame: CanFrame, now: int) -> list[tuple[int, CanFrame]]:
    """Delay each heartbeat by a different time, up to 60 % of the heartbeat period."""
    if not is_heartbeat(node, frame) or frame.data == b"\0":
        return [(0, frame)]
    period = node.heartbeat.period_ns
    step = now // period if period else 0
    return [(period * ((step * step * 7 + step * 13) % 61) // 100, frame)]


heartbeat_dropped: Outgoing = _on(is_heartbeat, lambda _frame: [])
heartbeat_wrong: Outgoing = _on(is_heartbeat, _pre_operational)
heartbeat_twice: Outgoing = _on(is_heartbeat, lambda frame: [(0, frame), (0, frame)])
tpdo_dropped: Outgoing = _on(is_tpdo, lambda _frame: [])
tpdo_shortened: Outgoing = _on(is_tpdo, lambda frame: _data(frame, frame.data[:-1]))
tpdo_lengthened: Outgoing = _on(is_tpdo, lambda frame: _data(frame, (frame.data + b"\xa5")[:8]))
tpdo_delayed: Outgoing = _on(is_tpdo, lambda frame: [(70 * _MS, frame)])
sdo_wrong_mux: Outgoing = _on(is_sdo_answer, _wrong_mux)
sdo_toggled: Outgoing = _on(is_sdo_answer, _toggled)
sdo_segment_lost: Outgoing = _on(is_sdo_answer, lambda frame: [] if frame.data[0] >> 5 == 0 else [(0, frame)])
sdo_one_byte: Outgoing = _on(is_sdo_answer, _one_byte)


# -- frames that reach the node


def deaf(_node: VirtualNode, _frame: CanFrame, _now: int) -> CanFrame | None:
    """Drop all frames that reach the node."""
    return None


def deaf_to_sdo(node: VirtualNode, frame: CanFrame, _now: int) -> CanFrame | None:
    """Drop SDO requests to the node."""
    return None if is_sdo_request(node, frame) else frame


def deaf_to_start(_node: VirtualNode, frame: CanFrame, _now: int) -> CanFrame | None:
    """Drop NMT start commands."""
    return None if frame.can_id == 0 and frame.data[:1] == bytes((NmtCommand.START,)) else frame


def deaf_to_sync(node: VirtualNode, frame: CanFrame, _now: int) -> CanFrame | None:
    """Drop SYNC messages."""
    return None if frame.can_id == node.sync.cob_id else frame


def refusing(code: AbortCode, matches: Callable[[int, int], bool]) -> Incoming:
    """Return a filter that aborts SDO requests with `code` if `matches(command, index)` is true."""

    def incoming(node: VirtualNode, frame: CanFrame, _now: int) -> CanFrame | None:
        if not is_sdo_request(node, frame):
            return frame
        command, index, subindex = _MUX.unpack_from(frame.data)
        if command >> 5 not in (1, 2, 5, 6) or not matches(command, index):
            return frame
        answer = _MUX.pack(_ABORT, index, subindex) + int(code).to_bytes(4, "little")
        node.outbox.send(CanFrame(node.sdo.answer_cob_id, answer))
        return None

    return incoming


_OPTIONAL = frozenset((o.ERROR_CODE, o.ABORT_CONNECTION_OPTION, o.INTERPOLATION_TIME_PERIOD))
refuses_writes: Incoming = refusing(AbortCode.DEVICE_STATE, lambda command, _index: command >> 5 in (1, 6))
lacks_optional: Incoming = refusing(AbortCode.NO_OBJECT, lambda _command, index: index in _OPTIONAL)
refuses_mapping: Incoming = refusing(
    AbortCode.READ_ONLY,
    lambda command, index: command >> 5 in (1, 6) and (0x1600 <= index < 0x1800 or 0x1A00 <= index < 0x1C00),
)
refuses_blocks: Incoming = refusing(AbortCode.UNKNOWN_COMMAND, lambda command, _index: command >> 5 in (5, 6))
