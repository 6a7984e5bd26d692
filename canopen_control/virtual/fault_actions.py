"""What the faults do: to frames that leave a node, to frames that reach it, to the node itself.

The law of this file: a function on frames returns what goes on, and changes nothing else; a function on the node does
with `on` False exactly what makes it healthy again. None of them knows its name or its row: those are in `faults`.
"""

from __future__ import annotations

import struct
from typing import TYPE_CHECKING

from canopen_control.cia301.abort import AbortCode
from canopen_control.cia301.emcy import EmcyMessage
from canopen_control.cia301.emcy_codes import ErrorRegister
from canopen_control.cia301.nmt import NmtCommand, NmtState
from canopen_control.cia402 import objects as o
from canopen_control.frame import CanFrame

if TYPE_CHECKING:
    from collections.abc import Callable

    from canopen_control.virtual.drive import VirtualDrive
    from canopen_control.virtual.node import VirtualNode

    Outgoing = Callable[[VirtualNode, CanFrame, int], list[tuple[int, CanFrame]]]  # (delay in ns, frame)
    Incoming = Callable[[VirtualNode, CanFrame, int], CanFrame | None]
    Turn = Callable[[VirtualNode, bool, int], None]

_MS = 1_000_000
_S = 1_000_000_000
_MUX = struct.Struct("<BHB")
_ABORT, _SEGMENTS = 0x80, (0x00, 0x10)


# -- which frame is it


def is_heartbeat(node: VirtualNode, frame: CanFrame) -> bool:
    """Whether it is the node's heartbeat or boot-up."""
    return frame.can_id == 0x700 + node.node_id


def is_sdo_answer(node: VirtualNode, frame: CanFrame) -> bool:
    """Whether the node's SDO server sent it."""
    return frame.can_id == node.sdo.answer_cob_id and len(frame.data) == 8


def is_sdo_request(node: VirtualNode, frame: CanFrame) -> bool:
    """Whether it is for the node's SDO server."""
    return frame.can_id == node.sdo.request_cob_id and len(frame.data) == 8


def is_tpdo(node: VirtualNode, frame: CanFrame) -> bool:
    """Whether it is one of the node's TPDOs."""
    ids = {tpdo.producer.parameters.cob_id for tpdo in node.pdos.tpdos.values() if tpdo.producer.parameters.enabled}
    return frame.can_id in ids


# -- frames that leave


def drop_all(_node: VirtualNode, _frame: CanFrame, _now: int) -> list[tuple[int, CanFrame]]:
    """Lose everything."""
    return []


def _on(
    matches: Callable[[VirtualNode, CanFrame], bool], change: Callable[[CanFrame], list[tuple[int, CanFrame]]]
) -> Outgoing:
    def outgoing(node: VirtualNode, frame: CanFrame, _now: int) -> list[tuple[int, CanFrame]]:
        return change(frame) if matches(node, frame) else [(0, frame)]

    return outgoing


def _data(frame: CanFrame, data: bytes) -> list[tuple[int, CanFrame]]:
    return [(0, CanFrame(frame.can_id, data))]


def _shortened(frame: CanFrame) -> list[tuple[int, CanFrame]]:
    return _data(frame, frame.data[:-1])


def _lengthened(frame: CanFrame) -> list[tuple[int, CanFrame]]:
    return _data(frame, (frame.data + b"\xa5")[:8])


def _wrong_mux(frame: CanFrame) -> list[tuple[int, CanFrame]]:
    command, index, subindex = _MUX.unpack_from(frame.data)
    return _data(frame, _MUX.pack(command, index + 1 & 0xFFFF, subindex) + frame.data[4:])


def _toggled(frame: CanFrame) -> list[tuple[int, CanFrame]]:
    """Turn the toggle bit of segment answers, 0x and 1x (upload) and 2x and 3x (download)."""
    if frame.data[0] >> 5 in (0, 1):
        return _data(frame, bytes((frame.data[0] ^ 0x10,)) + frame.data[1:])
    return [(0, frame)]


def _lost_segment(frame: CanFrame) -> list[tuple[int, CanFrame]]:
    return [] if frame.data[0] >> 5 == 0 else [(0, frame)]


def _one_byte(frame: CanFrame) -> list[tuple[int, CanFrame]]:
    """Claim that an expedited upload of 2 or 4 bytes has one."""
    if frame.data[0] in (0x43, 0x47, 0x4B):
        return _data(frame, b"\x4f" + frame.data[1:5] + b"\0\0\0")
    return [(0, frame)]


def _pre_operational(frame: CanFrame) -> list[tuple[int, CanFrame]]:
    return _data(frame, b"\x7f") if frame.data != b"\0" else [(0, frame)]


def _twice(frame: CanFrame) -> list[tuple[int, CanFrame]]:
    return [(0, frame), (0, frame)]


def jittered(node: VirtualNode, frame: CanFrame, now: int) -> list[tuple[int, CanFrame]]:
    """Send heartbeats up to 60 % of their period late, each by another amount."""
    if not is_heartbeat(node, frame) or frame.data == b"\0":
        return [(0, frame)]
    period = node.heartbeat.period_ns
    step = now // period if period else 0
    return [(period * ((step * step * 7 + step * 13) % 61) // 100, frame)]


heartbeat_dropped = _on(is_heartbeat, lambda _frame: [])
heartbeat_wrong = _on(is_heartbeat, _pre_operational)
heartbeat_twice = _on(is_heartbeat, _twice)
tpdo_dropped = _on(is_tpdo, lambda _frame: [])
tpdo_shortened = _on(is_tpdo, _shortened)
tpdo_lengthened = _on(is_tpdo, _lengthened)
tpdo_delayed = _on(is_tpdo, lambda frame: [(70 * _MS, frame)])
sdo_wrong_mux = _on(is_sdo_answer, _wrong_mux)
sdo_delayed = _on(is_sdo_answer, lambda frame: [(700 * _MS, frame)])
sdo_toggled = _on(is_sdo_answer, _toggled)
sdo_segment_lost = _on(is_sdo_answer, _lost_segment)
sdo_one_byte = _on(is_sdo_answer, _one_byte)


# -- frames that reach the node


def deaf(_node: VirtualNode, _frame: CanFrame, _now: int) -> CanFrame | None:
    """Hear nothing."""
    return None


def deaf_to_sdo(node: VirtualNode, frame: CanFrame, _now: int) -> CanFrame | None:
    """Hear no SDO request."""
    return None if is_sdo_request(node, frame) else frame


def deaf_to_start(_node: VirtualNode, frame: CanFrame, _now: int) -> CanFrame | None:
    """Hear no NMT start."""
    return None if frame.can_id == 0 and frame.data[:1] == bytes((NmtCommand.START,)) else frame


def deaf_to_sync(node: VirtualNode, frame: CanFrame, _now: int) -> CanFrame | None:
    """Hear no SYNC."""
    return None if frame.can_id == node.sync.cob_id else frame


def _refusing(code: AbortCode, concerns: Callable[[int, int], bool]) -> Incoming:
    """Answer SDO initiates that `concerns` (command, index) with an abort, before the server sees them."""

    def incoming(node: VirtualNode, frame: CanFrame, _now: int) -> CanFrame | None:
        if not is_sdo_request(node, frame):
            return frame
        command, index, subindex = _MUX.unpack_from(frame.data)
        if command >> 5 not in (1, 2, 5, 6) or not concerns(command, index):
            return frame
        answer = _MUX.pack(_ABORT, index, subindex) + int(code).to_bytes(4, "little")
        node.send(CanFrame(node.sdo.answer_cob_id, answer))
        return None

    return incoming


_OPTIONAL = frozenset((o.ERROR_CODE, o.ABORT_CONNECTION_OPTION, o.INTERPOLATION_TIME_PERIOD))
refuses_writes = _refusing(AbortCode.DEVICE_STATE, lambda command, _index: command >> 5 in (1, 6))
lacks_optional = _refusing(AbortCode.NO_OBJECT, lambda _command, index: index in _OPTIONAL)
refuses_mapping = _refusing(
    AbortCode.READ_ONLY,
    lambda command, index: command >> 5 in (1, 6) and (0x1600 <= index < 0x1800 or 0x1A00 <= index < 0x1C00),
)
refuses_blocks = _refusing(AbortCode.UNKNOWN_COMMAND, lambda command, _index: command >> 5 in (5, 6))


# -- the node itself


def _each(action: Callable[[VirtualDrive, bool, int], None]) -> Turn:
    """Make an action on every axis one on the node."""

    def turn(node: VirtualNode, on: bool, now: int) -> None:
        for drive in node.drives.values():
            drive.advance(now)
            action(drive, on, now)
        node.touch()

    return turn


def _attribute(name: str, on_value: object, off_value: object) -> Turn:
    """Make a turn that sets an attribute of every axis."""

    def action(drive: VirtualDrive, on: bool, _now: int) -> None:
        setattr(drive if hasattr(drive, name) else drive.power, name, on_value if on else off_value)

    return _each(action)


def boot_after(delay_ns: int | None) -> Turn:
    """Make a turn that sets the time from a reset to the boot-up; None: never."""

    def turn(node: VirtualNode, on: bool, now: int) -> None:
        node.set_reset_delay(delay_ns if on else 0, now)

    return turn


def brown_out(node: VirtualNode, _on: bool, now: int) -> None:
    """Switch off and on again."""
    node.power_on(now)


def drop_out(node: VirtualNode, _on: bool, now: int) -> None:
    """Leave OPERATIONAL without a command."""
    node.command(NmtCommand.ENTER_PRE_OPERATIONAL, now)


def start_by_itself(node: VirtualNode, on: bool, now: int) -> None:
    """Be OPERATIONAL without a command, now and after every boot."""
    node.self_starting = on
    if on and node.nmt.state is NmtState.PRE_OPERATIONAL:
        node.command(NmtCommand.START, now)


def short_emcy(node: VirtualNode, _on: bool, _now: int) -> None:
    """Send an EMCY of four bytes with a code nobody knows."""
    node.send(CanFrame(node.emcy.cob_id, bytes.fromhex("CDAB8107")))


def partial_reset(node: VirtualNode, _on: bool, _now: int) -> None:
    """Say error reset while the register still shows a temperature error."""
    register = ErrorRegister.GENERIC | ErrorRegister.TEMPERATURE
    node.send(EmcyMessage(node.node_id, 0, register).encode(node.emcy.cob_id))


def flood(node: VirtualNode, now: int) -> None:
    """Send one EMCY of a flood."""
    data = (now // _MS & 0xFFFFFFFF).to_bytes(4, "little")
    node.send(EmcyMessage(node.node_id, 0xFF80, ErrorRegister.GENERIC, data).encode(node.emcy.cob_id))


def lasting_fault(code: int, register: int) -> Turn:
    """Make a turn into FAULT whose cause lasts while it is on."""
    return _each(lambda drive, on, now: _last(drive, on, now, code, register))


def _last(drive: VirtualDrive, on: bool, now: int, code: int, register: int) -> None:
    """Fault, and keep its cause while it is on."""
    if on:
        drive.power.causes.add(code)
        drive.fault(code, now, register=register)
    else:
        drive.power.causes.discard(code)


def stubborn_fault(node: VirtualNode, on: bool, now: int) -> None:
    """Fault with a communication error that only a reset of the communication takes back."""
    for drive in node.drives.values():
        _last(drive, on, now, 0x8120, ErrorRegister.COMMUNICATION)
    node.clears_on_reset_communication = {0x8120} if on else set()


def power_stage(drive: VirtualDrive, on: bool, now: int) -> None:
    """Lose the supply of the power stage, or get it back."""
    if on:
        drive.power.lose_voltage(now)
    else:
        drive.power.voltage = True


def undervoltage(drive: VirtualDrive, on: bool, now: int) -> None:
    """Fault because of the supply."""
    drive.power.voltage = not on
    _last(drive, on, now, 0x3220, ErrorRegister.VOLTAGE)


def hand_moved(drive: VirtualDrive, _on: bool, now: int) -> None:
    """Turn the shaft by hand; a powered motor springs back, its demand goes on from there."""
    drive.mover.displace(500.0, now)


def position_jump(drive: VirtualDrive, _on: bool, _now: int) -> None:
    """Lose the encoder's count."""
    drive.zero -= 1_000_000.0


def position_near_wrap(drive: VirtualDrive, _on: bool, _now: int) -> None:
    """Count from a thousand before the 32-bit end."""
    drive.zero = drive.mover.plant.position - 0x7FFFFC17


def switch_hit(drive: VirtualDrive, on: bool, now: int) -> None:
    """Close the positive limit switch where the motor is."""
    switches = drive.mover.switches
    switches.wired = on
    switches.positive = drive.mover.plant.position if on else 50_000.0
    switches.negative = -1e12 if on else -50_000.0
    if on:
        drive.touched(1, now)


def no_switches(drive: VirtualDrive, on: bool, _now: int) -> None:
    """Take the switches out of homing's way."""
    switches = drive.mover.switches
    far = 1e12 if on else 0.0
    switches.negative, switches.positive = -50_000.0 - far, 50_000.0 + far
    switches.home_low, switches.home_high = 10_000.0 + far, 12_000.0 + far


def clock_off_by(ppm: float) -> Turn:
    """Make a turn that lets the node's clock run fast, or slow where `ppm` is negative."""

    def turn(node: VirtualNode, on: bool, _now: int) -> None:
        node.clock_ppm = ppm if on else 0.0
        node.communication.apply()

    return turn


def wrong_entry(index: int, subindex: int, off: int) -> Turn:
    """Make a turn that shows another value of an identity object."""

    def turn(node: VirtualNode, on: bool, _now: int) -> None:
        step = off if on else -off
        node.store.preset(index, subindex, node.store.number(index, subindex) + step)

    return turn


def clamped(node: VirtualNode, on: bool, _now: int) -> None:
    """Take at most 1000 for a profile acceleration, silently."""
    node.store.ceilings = {o.PROFILE_ACCELERATION: 1000} if on else {}


transition_slow = _attribute("extra_delay_ns", 2 * _S, 0)
status_undefined = _attribute("status_override", 0x0001, None)
mode_frozen = _attribute("mode_frozen", True, False)
mode_late = _attribute("mode_delay_ns", 200 * _MS, 0)
local_control = _attribute("remote", False, True)
warning = _attribute("warning", True, False)
ack_missing = _attribute("status_clear", 1 << 12, 0)
ack_stuck = _attribute("status_set", 1 << 12, 0)
reached_stuck = _attribute("status_set", 1 << 10, 0)
fault_on_enable = _attribute("fault_on_enable", 0x5441, 0)
reset_deaf = _attribute("reset_deaf", True, False)
inverted = _attribute("inverted", True, False)
homing_failing = _attribute("homing_fails", True, False)
power_stage_off = _each(power_stage)
supply_low = _each(undervoltage)
shaft_moved = _each(hand_moved)
count_lost = _each(position_jump)
count_wraps = _each(position_near_wrap)
limit_switch = _each(switch_hit)
switches_gone = _each(no_switches)
over_temperature = lasting_fault(0x4310, ErrorRegister.TEMPERATURE)
short_circuit = lasting_fault(0x2320, ErrorRegister.CURRENT)
following_error = lasting_fault(0x8611, ErrorRegister.DEVICE_PROFILE)


def error_passive(node: VirtualNode, on: bool, _now: int) -> None:
    """Report the CAN controller error passive, then recovered."""
    if on:
        node.emergency(0x8120, ErrorRegister.COMMUNICATION)
    else:
        node.clear_error(0x8120)


def recovered_from_bus_off(node: VirtualNode, on: bool, _now: int) -> None:
    """Be off the bus while on; back on it, say so."""
    if not on:
        node.report(0x8140, ErrorRegister.COMMUNICATION, node.personality.communication_data)
