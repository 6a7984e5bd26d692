"""Effects of quirks on a node, as hooks that can be undone.

An act is called once when its quirk is switched on, with the strength; what it hooked is undone when the quirk is
switched off. None of them has its name or its source: those are in `quirks`. Without a quirk nothing of this file runs.
"""

from __future__ import annotations

from functools import partial
from typing import TYPE_CHECKING, Any

from canopen_control.cia301.abort import AbortCode
from canopen_control.cia301.nmt import NmtCommand, NmtState
from canopen_control.cia301.sdo_server import SdoServerAbort
from canopen_control.cia402 import objects as o
from canopen_control.cia402.modes import OperationMode
from canopen_control.cia402.state import (
    HALT_BIT,
    INTERNAL_LIMIT,
    REMOTE,
    TARGET_REACHED,
    VOLTAGE_ENABLED,
    Command,
    State,
    transition_of,
)
from canopen_control.frame import CanFrame
from canopen_control.virtual.device_faults import served_in_preop, start_by_itself
from canopen_control.virtual.device_model import MissingSetPoint
from canopen_control.virtual.fault_frames import (
    is_heartbeat,
    is_sdo_answer,
    is_sdo_request,
    lacks_optional,
    refuses_blocks,
    refuses_mapping,
    refusing,
)
from canopen_control.virtual.mode_base import BIT_12, NEW_SET_POINT
from canopen_control.virtual.node_pdos import TPDO
from canopen_control.virtual.profile_modes import IMMEDIATELY
from canopen_control.virtual.quirk_hooks import QuirkHooks, pdo_mappings, pdo_records

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable

    from canopen_control.cia402.state import Transition
    from canopen_control.od.model import Entry, Value
    from canopen_control.virtual.device_faults import Switch
    from canopen_control.virtual.fault_frames import Incoming
    from canopen_control.virtual.injection_point import InjectionPoint
    from canopen_control.virtual.object_store import Guard
    from canopen_control.virtual.quirk_hooks import Plain
    from canopen_control.virtual.virtual_drive import VirtualDrive
    from canopen_control.virtual.virtual_node import VirtualNode

    Sent = list[tuple[int, CanFrame]]
    AxisAct = Callable[["QuirkHooks", VirtualDrive, float], None]
    NodeAct = Callable[["QuirkHooks", float], None]

_MS, _S = 1_000_000, 1_000_000_000
_CYCLIC = (OperationMode.IP, OperationMode.CSP, OperationMode.CSV, OperationMode.CST)


# -- functions that make acts


def _refuses(
    code: AbortCode,
    when: Callable[[VirtualNode, Entry, int, float], bool],
    indices: Callable[[VirtualNode], Iterable[int]],
) -> NodeAct:
    """Return an act that refuses writes of values to objects of the node."""

    def act(hooks: QuirkHooks, strength: float) -> None:
        def judge(entry: Entry, value: Value, before: Guard) -> Value:
            if when(hooks.node, entry, int(value), strength):
                raise SdoServerAbort(code)
            return before(entry, value)

        hooks.guard(indices(hooks.node), judge)

    return act


def _axis_refuses(code: AbortCode, index: int, when: Callable[[VirtualDrive, int, float], bool]) -> AxisAct:
    """Return an act that refuses values of an object of the axis."""

    def act(hooks: QuirkHooks, drive: VirtualDrive, strength: float) -> None:
        def judge(entry: Entry, value: Value, before: Guard) -> Value:
            if when(drive, int(value), strength):
                raise SdoServerAbort(code)
            return before(entry, value)

        hooks.guard([index + drive.objects.offset], judge)

    return act


def _word(change: Callable[[VirtualDrive, int], int]) -> AxisAct:
    """Return an act that changes the statusword."""
    return lambda hooks, drive, _strength: hooks.word(drive, lambda word: change(drive, word))


def _delays(number: int) -> AxisAct:
    """Return an act that delays a transition by the strength in s."""
    return lambda hooks, drive, strength: hooks.delay(drive, number, strength)


def _point(seam: Callable[[VirtualDrive], InjectionPoint[Any]], value: Callable[[float], Any]) -> AxisAct:
    """Return an act that changes the normal behaviour at an injection point."""
    return lambda hooks, drive, strength: hooks.healthy(seam(drive), value(strength))


def _model(change: Callable[[float], dict[str, Any]]) -> AxisAct:
    """Return an act that changes the device model."""
    return lambda hooks, drive, strength: hooks.model(drive, **change(strength))


def _attribute(locate: Callable[[VirtualDrive], tuple[Any, str]]) -> AxisAct:
    """Return an act that sets an attribute to the strength, an integer."""
    return lambda hooks, drive, strength: hooks.attribute(*locate(drive), int(strength))


def _condition(holds: Callable[[VirtualDrive], bool]) -> AxisAct:
    """Return an act that allows a change of mode only under a condition."""

    def act(hooks: QuirkHooks, drive: VirtualDrive, _strength: float) -> None:
        modes = drive.modes
        hooks.attribute(modes, "conditions", (*modes.conditions, lambda: holds(drive)))

    return act


def _answers(change: Callable[[CanFrame], CanFrame]) -> NodeAct:
    """Return an act that changes the answers of the SDO server."""

    def outgoing(node: VirtualNode, frame: CanFrame, _now: int) -> Sent:
        return [(0, change(frame) if is_sdo_answer(node, frame) else frame)]

    return lambda hooks, _strength: hooks.outgoing.append(outgoing)


def _emergencies(change: Callable[[CanFrame], CanFrame]) -> NodeAct:
    """Return an act that changes the EMCY messages."""

    def outgoing(node: VirtualNode, frame: CanFrame, _now: int) -> Sent:
        return [(0, change(frame) if frame.can_id == node.emcy.cob_id and len(frame.data) == 8 else frame)]

    return lambda hooks, _strength: hooks.outgoing.append(outgoing)


def _lacks(*indices: int) -> NodeAct:
    """Return an act that removes objects from the node."""
    return lambda hooks, _strength: hooks.absent(*indices)


def _hears(incoming: Incoming) -> NodeAct:
    """Make an act that changes the frames that reach the node."""
    return lambda hooks, _strength: hooks.incoming.append(incoming)


def _turns(switch: Switch) -> NodeAct:
    """Make an act that switches something of the node, until it is undone."""

    def act(hooks: QuirkHooks, _strength: float) -> None:
        node = hooks.node
        hooks.later(lambda: switch(node, False, node.clock.now))
        switch(node, True, node.clock.now)

    return act


def booted(hooks: QuirkHooks) -> Callable[[], int]:
    """Return a function for the time of the boot-up message in ns; long ago before it."""
    times = [-(1 << 62)]

    def outgoing(node: VirtualNode, frame: CanFrame, now: int) -> Sent:
        if is_heartbeat(node, frame) and frame.data == b"\0":
            times[0] = now
        return [(0, frame)]

    hooks.outgoing.append(outgoing)
    return lambda: times[0]


# -- modes of operation


def modes_listed_without(hooks: QuirkHooks, drive: VirtualDrive, mode: float) -> None:
    """Leave a mode that works out of 0x6502."""
    bit = 1 << int(mode) - 1
    hooks.show(o.SUPPORTED_DRIVE_MODES + drive.objects.offset, 0, lambda shown: shown & ~bit)


def further_mode(like: OperationMode) -> AxisAct:
    """Return an act that adds a manufacturer-specific number to a mode."""

    def act(hooks: QuirkHooks, drive: VirtualDrive, number: float) -> None:
        own = int(number)
        drive.modes.add(own, like)
        hooks.later(lambda: drive.modes.remove(own))
        index = o.MODES_OF_OPERATION + drive.objects.offset
        beyond = hooks.node.store.beyond_limits
        beyond.add((index, own))
        hooks.later(partial(beyond.discard, (index, own)))
        hooks.guard([index], lambda entry, value, before: value if value == own else before(entry, value))

    return act


def mode_shown_late(hooks: QuirkHooks, drive: VirtualDrive, seconds: float) -> None:
    """Show -1 for a new cyclic mode until a time is over."""
    since = [float(drive.modes.number), 0]
    wait = round(seconds * _S)

    def view(shown: int) -> int:
        now = drive.mover.time
        if shown != since[0]:
            since[:] = shown, now
            drive.mover.at("mode shown", now + wait, lambda _now: hooks.node.outbox.values_changed())
        return -1 if shown in _CYCLIC and now - since[1] < wait else shown

    hooks.show(o.MODES_OF_OPERATION_DISPLAY + drive.objects.offset, 0, view)


def mode_shown_enabled(hooks: QuirkHooks, drive: VirtualDrive, _strength: float) -> None:
    """Show a mode in OPERATION ENABLED alone."""
    hooks.show(
        o.MODES_OF_OPERATION_DISPLAY + drive.objects.offset,
        0,
        lambda shown: shown if drive.state is State.OPERATION_ENABLED else 0,
    )


def mode_needed(hooks: QuirkHooks, drive: VirtualDrive, _strength: float) -> None:
    """Enable with a mode alone."""
    hooks.act(drive, 4, lambda transition, now, before: before(transition, now) if drive.modes.number else None)


def inputs_shifted(hooks: QuirkHooks, drive: VirtualDrive, bits: float) -> None:
    """Show the switches in other bits of 0x60FD."""

    def view(shown: int) -> int:
        return shown & ~0xF | (shown & 0xF) << int(bits)

    hooks.show(o.DIGITAL_INPUTS + drive.objects.offset, 0, view)


# -- the power state machine


def set_points_after_brake(hooks: QuirkHooks, drive: VirtualDrive, seconds: float) -> None:
    """Enable at once, and follow set-points after a delay."""
    gate, wait = hooks.gate(drive), round(seconds * _S)
    gate.brake_ns = wait

    def opened(now: int) -> None:
        gate.closed_by.discard("brake")
        if drive.power.live:
            drive.start(now)

    def enable(transition: Transition, now: int, before: Plain) -> None:
        gate.closed_by.add("brake")
        drive.mover.at("brake", now + wait, opened)
        before(transition, now)

    hooks.act(drive, 4, enable)


def never_moves(hooks: QuirkHooks, drive: VirtualDrive, _strength: float) -> None:
    """Follow no set-point of the bus."""
    hooks.gate(drive).closed_by.add("source")


def mains_awaited(hooks: QuirkHooks, drive: VirtualDrive, seconds: float) -> None:
    """Leave SWITCHED ON after a time when there is no supply."""

    def fall(now: int) -> None:
        if drive.state is State.SWITCHED_ON and not drive.power.voltage.value:
            drive.power.enter(State.SWITCH_ON_DISABLED, now)

    def switch_on(transition: Transition, now: int, before: Plain) -> None:
        before(transition, now)
        drive.mover.at("mains", now + round(seconds * _S), fall)

    hooks.act(drive, 3, switch_on)


def link_empty_after_fault(hooks: QuirkHooks, drive: VirtualDrive, seconds: float) -> None:
    """Charge the DC link for a time after a fault reset: bit 4 is 0, commands do nothing."""
    until = [-(1 << 62)]

    def reset(transition: Transition, now: int, before: Plain) -> None:
        before(transition, now)
        if drive.state is not State.FAULT:
            until[0] = now + round(seconds * _S)

    def charged(transition: Transition, now: int, before: Plain) -> None:
        if now >= until[0]:
            before(transition, now)

    hooks.act(drive, 15, reset)
    for number in (2, 3, 4):
        hooks.act(drive, number, charged)
    hooks.word(drive, lambda word: word if drive.mover.time >= until[0] else word & ~VOLTAGE_ENABLED)


def ends_in(state: State, end: State | None) -> AxisAct:
    """Return an act that ends the stop of a state in another state than in CiA 402."""
    return lambda hooks, drive, _strength: hooks.entry(drive.power.ends, state, end)


def quick_stop_off(hooks: QuirkHooks, drive: VirtualDrive, _strength: float) -> None:
    """Ignore a quick stop."""
    hooks.act(drive, 11, lambda _transition, _now, _before: None)


def quick_stop_at_once(hooks: QuirkHooks, drive: VirtualDrive, _strength: float) -> None:
    """Remove the power on a quick stop, without the state QUICK STOP ACTIVE."""
    hooks.act(drive, 11, lambda _transition, now, _before: drive.power.enter(State.SWITCH_ON_DISABLED, now))


def quick_stop_resumes(hooks: QuirkHooks, drive: VirtualDrive, _strength: float) -> None:
    """Allow transition 16 from QUICK STOP ACTIVE with every value of 0x605A."""
    enabling = transition_of(State.SWITCHED_ON, Command.ENABLE_OPERATION)
    if enabling is not None:
        hooks.act(drive, 16, lambda _transition, now, _before: drive.power.act_of(4)(enabling, now))


def reset_by_second_edge(hooks: QuirkHooks, drive: VirtualDrive, _strength: float) -> None:
    """Reset a fault by every second edge."""
    edges = [0]

    def reset(transition: Transition, now: int, before: Plain) -> None:
        edges[0] += 1
        if edges[0] % 2 == 0:
            before(transition, now)

    hooks.act(drive, 15, reset)


def reset_takes(hooks: QuirkHooks, drive: VirtualDrive, seconds: float) -> None:
    """Leave FAULT a time after the edge."""

    def reset(transition: Transition, now: int, before: Plain) -> None:
        drive.mover.at("fault reset", now + round(seconds * _S), lambda then: before(transition, then))

    hooks.act(drive, 15, reset)


def reset_by_level(hooks: QuirkHooks, drive: VirtualDrive, seconds: float) -> None:
    """Leave FAULT when bit 7 has been high for a time."""

    def reset(transition: Transition, now: int, before: Plain) -> None:
        def look(then: int) -> None:
            if drive.power.controlword & 0x80 and drive.state is State.FAULT:
                before(transition, then)

        drive.mover.at("fault reset", now + round(seconds * _S), look)

    hooks.act(drive, 15, reset)


def faults_again(hooks: QuirkHooks, drive: VirtualDrive, _strength: float) -> None:
    """Leave FAULT by a reset although its cause lasts, and fault again."""
    power = drive.power

    def reset(transition: Transition, now: int, before: Plain) -> None:
        before(transition, now)
        if power.causes and drive.state is State.FAULT:
            code = min(power.causes)
            hooks.node.outbox.clear_errors()
            power.enter(State.SWITCH_ON_DISABLED, now)
            drive.mover.at("fault again", now + 5 * _MS, lambda then: drive.fault(code, then))

    hooks.act(drive, 15, reset)


def first_enable_faults(hooks: QuirkHooks, drive: VirtualDrive, code: float) -> None:
    """Fault by the first enable."""
    enabled = [False]

    def enable(transition: Transition, now: int, before: Plain) -> None:
        before(transition, now)
        if not enabled[0] and drive.state is State.OPERATION_ENABLED:
            enabled[0] = True
            drive.fault(int(code), now)

    hooks.act(drive, 4, enable)


def torque_to_position_faults(hooks: QuirkHooks, drive: VirtualDrive, _strength: float) -> None:
    """Fault by a change from a torque mode to a cyclic position mode in operation."""
    torque, modes, index = (
        (OperationMode.TQ, OperationMode.CST),
        drive.modes,
        o.MODES_OF_OPERATION + drive.objects.offset,
    )

    def judge(entry: Entry, value: Value, before: Guard) -> Value:
        result = before(entry, value)
        if drive.state is State.OPERATION_ENABLED and modes.number in torque and result == OperationMode.CSP:
            drive.fault(0x8A00, hooks.node.clock.now)
        return result

    hooks.guard([index], judge)


def supply_loss_switched_on(hooks: QuirkHooks, drive: VirtualDrive, _strength: float) -> None:
    """Fall to SWITCHED ON when the power stage is switched off."""
    hooks.attribute(drive.power, "unsupplied", State.SWITCHED_ON)


def sync_period_judged(hooks: QuirkHooks, drive: VirtualDrive, _strength: float) -> None:
    """Fault when enabled in a cyclic mode while 0x1006 is not the interpolation time."""

    def enable(transition: Transition, now: int, before: Plain) -> None:
        before(transition, now)
        period = round(drive.objects.interpolation_s * 1e6)
        if drive.power.running and drive.modes.number in _CYCLIC and hooks.node.store.number(0x1006) != period:
            drive.fault(0x8700, now)

    hooks.act(drive, 4, enable)


# -- the statusword, set-points, homing


def _flickers(period_ns: int, duty: int, bits: int) -> Callable[[VirtualDrive, int], int]:
    """Return a change that turns bits round in one of `duty` periods."""
    return lambda drive, word: word ^ bits if drive.mover.time // period_ns % duty == 0 else word


def _reached_flickers(drive: VirtualDrive, word: int) -> int:
    flickers = drive.state is State.OPERATION_ENABLED and drive.modes.number == OperationMode.PP
    return _flickers(7 * _MS, 5, TARGET_REACHED)(drive, word) if flickers else word


def _reached_inverted(drive: VirtualDrive, word: int) -> int:
    inverted = drive.state is State.OPERATION_ENABLED and drive.modes.number == OperationMode.PP
    return word ^ TARGET_REACHED if inverted else word


def _takes(passes: Callable[[VirtualDrive, int, int], bool]) -> AxisAct:
    """Return an act that accepts a PP set-point only under a condition."""

    def act(hooks: QuirkHooks, drive: VirtualDrive, _strength: float) -> None:
        def takes(word: int, previous: int, now: int) -> bool:
            new = word & ~previous & NEW_SET_POINT and drive.modes.number == OperationMode.PP
            return not new or passes(drive, word, now)

        hooks.gate(drive).takes.append(takes)

    return act


def homing_latched(hooks: QuirkHooks, drive: VirtualDrive, _strength: float) -> None:
    """Keep bit 12 of homing until operation is left."""
    latched = [False]

    def change(word: int) -> int:
        homing = drive.modes.number == OperationMode.HM
        enabled = drive.state is State.OPERATION_ENABLED
        latched[0] = enabled and (latched[0] or (homing and bool(word & BIT_12)))
        return word | BIT_12 if homing and latched[0] else word

    def enable(transition: Transition, now: int, before: Plain) -> None:
        latched[0] = False
        before(transition, now)

    hooks.act(drive, 4, enable)
    hooks.word(drive, change)


def homing_shown_for(hooks: QuirkHooks, drive: VirtualDrive, seconds: float) -> None:
    """Show bit 12 of homing for a time only."""
    since: list[int] = []

    def change(word: int) -> int:
        if drive.modes.number != OperationMode.HM or not word & BIT_12:
            since.clear()
            return word
        since.append(drive.mover.time) if not since else None
        return word if drive.mover.time - since[0] < seconds * _S else word & ~BIT_12

    hooks.word(drive, change)


def polarity_of_targets(hooks: QuirkHooks, drive: VirtualDrive, _strength: float) -> None:
    """Turn targets alone round by 0x607E, and not the feedback."""
    store, index, inverted = hooks.node.store, o.POLARITY + drive.objects.offset, drive.readings.inverted

    def turn(_entry: Entry | None = None, _value: Value = 0) -> None:
        inverted.healthy = bool(drive.objects.number(o.POLARITY) & 0xC0)
        inverted.clear()

    hooks.healthy(inverted, inverted.healthy)
    hooks.later(partial(store.unwatch, index, turn))
    store.on_write([index], turn)
    turn()


def velocity_unit(hooks: QuirkHooks, drive: VirtualDrive, counts: float) -> None:
    """Use a velocity unit in counts/s that no object shows."""
    units, objects = drive.objects.units, drive.objects
    hooks.later(lambda: units.update(objects))
    hooks.attribute(units, "own_speed", counts)
    units.update(objects)


# -- process data


def cob_ids_fixed(hooks: QuirkHooks, _strength: float) -> None:
    """Refuse other COB-IDs of PDOs; the mapping is changed while they are valid."""
    hooks.attribute(hooks.node.pdos.records, "remaps_valid", True)
    refuses = _refuses(AbortCode.READ_ONLY, lambda _node, entry, _value, _n: entry.subindex == 1, pdo_records)
    refuses(hooks, 0.0)


def consumer_rounded(hooks: QuirkHooks, seconds: float) -> None:
    """Round the times of 0x1016 up."""
    step = round(seconds * 1000)

    def judge(entry: Entry, value: Value, before: Guard) -> Value:
        number = int(value)
        if entry.subindex:
            number = number & ~0xFFFF | min(0xFFFF, -(-(number & 0xFFFF) // step) * step)
        return before(entry, number)

    hooks.guard([0x1016], judge)


def inhibit_at_least(hooks: QuirkHooks, seconds: float) -> None:
    """Use a minimum inhibit time of TPDOs."""
    least = round(seconds * 10_000)
    for number in hooks.node.pdos.tpdos:
        if hooks.node.store.number(TPDO + number, 3) < least:
            hooks.preset(TPDO + number, 3, least)

    def judge(entry: Entry, value: Value, before: Guard) -> Value:
        return before(entry, max(least, int(value)) if entry.subindex == 3 else value)

    hooks.guard([TPDO + number for number in hooks.node.pdos.tpdos], judge)


def mapping_swapped(hooks: QuirkHooks, _strength: float) -> None:
    """Start with the mappings of the first two TPDOs exchanged."""
    store = hooks.node.store
    first, second = TPDO + 0x200, TPDO + 0x201
    values = [
        (index, sub, store.number(swapped, sub))
        for index, swapped in ((first, second), (second, first))
        for sub in store.od.subindices(index)
    ]
    for index, sub, value in values:
        hooks.preset(index, sub, value)


def cob_ids_of(hooks: QuirkHooks, node_id: float) -> None:
    """Start with the COB-IDs of another node."""
    store, own = hooks.node.store, hooks.node.node_id
    for record in pdo_records(hooks.node):
        value = store.number(record, 1)
        if value & 0x7F == own:
            hooks.preset(record, 1, value & ~0x7F | int(node_id))


def period_rounded(hooks: QuirkHooks, drive: VirtualDrive, ms: float) -> None:
    """Round 0x60C2 down to a multiple of some ms."""
    step = int(ms)

    def judge(entry: Entry, value: Value, before: Guard) -> Value:
        return before(entry, max(1, int(value) // step * step) if entry.subindex == 1 else value)

    hooks.guard([o.INTERPOLATION_TIME_PERIOD + drive.objects.offset], judge)


def ceiling(hooks: QuirkHooks, most: float) -> None:
    """Clamp a profile acceleration without an error."""
    hooks.healthy(hooks.node.store.ceilings, {o.PROFILE_ACCELERATION: int(most)})


# -- SDO, NMT, boot


def _sized(command: int) -> int:
    """Return the size in an expedited upload below 4 bytes, 0 for other answers."""
    return {0x4F: 1, 0x4B: 2, 0x47: 3}.get(command, 0)


def _four_bytes(frame: CanFrame) -> CanFrame:
    return CanFrame(frame.can_id, b"\x43" + frame.data[1:]) if _sized(frame.data[0]) else frame


def _size_unsaid(frame: CanFrame) -> CanFrame:
    expedited = _sized(frame.data[0]) or frame.data[0] == 0x43
    return CanFrame(frame.can_id, b"\x42" + frame.data[1:]) if expedited else frame


def _garbage_behind(frame: CanFrame) -> CanFrame:
    size = _sized(frame.data[0])
    return CanFrame(frame.can_id, frame.data[: 4 + size] + b"\xa5\x8f\xaf"[: 4 - size]) if size else frame


def _more_bytes(frame: CanFrame) -> CanFrame:
    last = frame.data[0] & 0xE1 == 0x01
    return CanFrame(frame.can_id, bytes((frame.data[0] & 0xF1,)) + frame.data[1:]) if last else frame


def _acknowledged_with_data(frame: CanFrame) -> CanFrame:
    return CanFrame(frame.can_id, frame.data[:4] + b"\xde\xad\xbe\xef") if frame.data[0] == 0x60 else frame


def _short(frame: CanFrame) -> CanFrame:
    size = 4 if frame.data[0] == 0x60 else 4 + _sized(frame.data[0]) if _sized(frame.data[0]) else 8
    return CanFrame(frame.can_id, frame.data[:size])


def _aborted_with(code: int) -> Callable[[CanFrame], CanFrame]:
    abort = code.to_bytes(4, "little")
    return lambda frame: CanFrame(frame.can_id, frame.data[:4] + abort) if frame.data[0] == 0x80 else frame


def sdo_after_boot(hooks: QuirkHooks, seconds: float) -> None:
    """Answer SDO requests a time after the boot-up message."""
    boot = booted(hooks)

    def incoming(node: VirtualNode, frame: CanFrame, now: int) -> CanFrame | None:
        return None if is_sdo_request(node, frame) and now - boot() < seconds * _S else frame

    hooks.incoming.append(incoming)


def sdo_takes(hooks: QuirkHooks, seconds: float) -> None:
    """Answer SDO requests late."""
    hooks.outgoing.append(lambda node, frame, _now: [(round(seconds * _S) if is_sdo_answer(node, frame) else 0, frame)])


def stale_answers(hooks: QuirkHooks, _strength: float) -> None:
    """Answer requests from before the boot-up after it, and report an overrun."""

    def outgoing(node: VirtualNode, frame: CanFrame, _now: int) -> Sent:
        if not is_heartbeat(node, frame) or frame.data != b"\0":
            return [(0, frame)]
        answer = CanFrame(node.sdo.answer_cob_id, bytes.fromhex("4300100092010200"))
        stale = [((20 + 3 * count) * _MS, answer) for count in range(3)]
        return [(0, frame), *stale, (25 * _MS, CanFrame(node.emcy.cob_id, bytes.fromhex("1081110000000000")))]

    hooks.outgoing.append(outgoing)


def first_request_lost(hooks: QuirkHooks, _strength: float) -> None:
    """Answer no SDO request before the second one after the boot-up."""
    boot, last_request = booted(hooks), [-(1 << 62)]

    def incoming(node: VirtualNode, frame: CanFrame, now: int) -> CanFrame | None:
        if not is_sdo_request(node, frame) or last_request[0] >= boot():
            return frame
        last_request[0] = now
        return None

    hooks.incoming.append(incoming)


def mapped_not_written(hooks: QuirkHooks, _strength: float) -> None:
    """Refuse SDO downloads to objects that an RPDO brings while the node is OPERATIONAL."""
    pdos = hooks.node.pdos

    def concerns(command: int, index: int) -> bool:
        brought = (rpdo for rpdo in pdos.rpdos.values() if rpdo.consumer.running)
        return command >> 5 in (1, 6) and any(
            entry.index == index for rpdo in brought for entry in rpdo.entries if entry
        )

    hooks.incoming.append(refusing(AbortCode.DEVICE_STATE, concerns))


def cob_ids_not_stored(hooks: QuirkHooks, _strength: float) -> None:
    """Store everything but the COB-IDs of PDOs."""
    store = hooks.node.store

    def judge(entry: Entry, value: Value, before: Guard) -> Value:
        cob_ids = {record: store.power_on.get((record, 1)) for record in pdo_records(hooks.node)}
        answer = before(entry, value)
        for record, cob_id in cob_ids.items():
            store.power_on.pop((record, 1), None)
            if cob_id is not None:
                store.power_on[record, 1] = cob_id
        return answer

    hooks.guard([0x1010], judge)


def _after_boot(frames: Callable[[VirtualNode], list[tuple[int, CanFrame]]]) -> NodeAct:
    """Return an act that sends frames after the boot-up message."""

    def outgoing(node: VirtualNode, frame: CanFrame, _now: int) -> Sent:
        boots = is_heartbeat(node, frame) and frame.data == b"\0"
        return [(0, frame), *frames(node)] if boots else [(0, frame)]

    return lambda hooks, _strength: hooks.outgoing.append(outgoing)


heartbeats_at_boot: NodeAct = _after_boot(
    lambda node: [(count * _MS, CanFrame(0x700 + node.node_id, b"\x7f")) for count in range(1, 5)]
)
error_at_boot: NodeAct = _after_boot(
    lambda node: [
        (0, CanFrame(node.emcy.cob_id, bytes.fromhex("0010810000000000"))),
        (_MS, CanFrame(node.emcy.cob_id, bytes(8))),
    ]
)
zeros_at_boot: NodeAct = _after_boot(lambda node: [(0, CanFrame(node.emcy.cob_id, bytes(8)))])


def boot_unsaid(hooks: QuirkHooks, _strength: float) -> None:
    """Send no boot-up message."""

    def outgoing(node: VirtualNode, frame: CanFrame, _now: int) -> Sent:
        return [] if is_heartbeat(node, frame) and frame.data == b"\0" else [(0, frame)]

    hooks.outgoing.append(outgoing)


def _is_start(frame: CanFrame) -> bool:
    return frame.can_id == 0 and frame.data[:1] == bytes((NmtCommand.START,))


def start_without_errors(hooks: QuirkHooks, _strength: float) -> None:
    """Start only while the error register is 0."""
    hooks.incoming.append(lambda node, frame, _now: None if _is_start(frame) and node.emcy.error_register else frame)


def start_after_boot(hooks: QuirkHooks, seconds: float) -> None:
    """Start a time after the boot-up message at the earliest."""
    boot = booted(hooks)
    hooks.incoming.append(lambda _node, frame, now: None if _is_start(frame) and now - boot() < seconds * _S else frame)


def boots_after(hooks: QuirkHooks, seconds: float) -> None:
    """Delay the boot-up message after a reset."""
    node = hooks.node
    hooks.later(lambda: node.set_reset_delay(0, node.clock.now))
    node.set_reset_delay(round(seconds * _S), node.clock.now)


def drifts_by(hooks: QuirkHooks, ppm: float) -> None:
    """Use a fast or slow clock."""
    hooks.later(lambda: hooks.node.set_clock_drift(0.0))
    hooks.node.set_clock_drift(ppm)


def storing_takes(hooks: QuirkHooks, seconds: float) -> None:
    """Hear and send nothing while parameters are stored (0x1010)."""
    until = [-(1 << 62)]
    wait = round(seconds * _S)

    def incoming(node: VirtualNode, frame: CanFrame, now: int) -> CanFrame | None:
        if now < until[0] and frame.can_id:
            return None
        if is_sdo_request(node, frame) and frame.data[0] >> 5 == 1 and frame.data[1:3] == b"\x10\x10":
            until[0] = now + wait
        return frame

    def outgoing(node: VirtualNode, frame: CanFrame, now: int) -> Sent:
        if now >= until[0]:
            return [(0, frame)]
        return [(until[0] - now, frame)] if is_sdo_answer(node, frame) else []

    hooks.incoming.append(incoming)
    hooks.outgoing.append(outgoing)


# -- acts without a function of their own: what the table of `quirks` names

supported_modes_absent: NodeAct = _lacks(o.SUPPORTED_DRIVE_MODES)
sync_counter_absent: NodeAct = _lacks(0x1019)
heartbeat_absent: NodeAct = _lacks(0x1016, 0x1017)
error_code_absent: NodeAct = _lacks(o.ERROR_CODE)
mapping_fixed: NodeAct = _hears(refuses_mapping)
optional_missing: NodeAct = _hears(lacks_optional)
no_block: NodeAct = _hears(refuses_blocks)
enabled_in_preop: NodeAct = _turns(served_in_preop)
operational_by_itself: NodeAct = _turns(start_by_itself)
velocity_absent: NodeAct = _lacks(o.VELOCITY_ACTUAL)
mode_fixed_while_halted: AxisAct = _condition(lambda drive: not drive.power.controlword & HALT_BIT)
mode_fixed_while_enabled: AxisAct = _condition(
    lambda drive: drive.state not in (State.SWITCHED_ON, State.OPERATION_ENABLED) or not drive.modes.number
)
mode_fixed_while_moving: AxisAct = _condition(lambda drive: drive.mover.at_standstill)
mode_delay: AxisAct = _point(lambda drive: drive.modes.delay_ns, lambda seconds: round(seconds * _S))
only_mode: AxisAct = _axis_refuses(
    AbortCode.INVALID_VALUE, o.MODES_OF_OPERATION, lambda _drive, value, mode: value not in (0, mode)
)
transition_delay: AxisAct = _point(lambda drive: drive.power.transition_delay_ns, lambda seconds: round(seconds * _S))
enable_faults: AxisAct = _point(lambda drive: drive.power.fault_on_enable, int)
enable_delay: AxisAct = _delays(4)
switch_on_delay: AxisAct = _delays(3)
not_ready: AxisAct = _delays(1)
quick_stop_ends_on: AxisAct = ends_in(State.QUICK_STOP_ACTIVE, State.SWITCHED_ON)
fault_reaction_endless: AxisAct = ends_in(State.FAULT_REACTION_ACTIVE, None)
remote_enabled_only: AxisAct = _word(
    lambda drive, word: word if drive.state is State.OPERATION_ENABLED else word & ~REMOTE
)
remote_never: AxisAct = _word(lambda _drive, word: word & ~REMOTE)
voltage_never: AxisAct = _word(lambda _drive, word: word & ~VOLTAGE_ENABLED)
warning_always: AxisAct = _word(lambda _drive, word: word | 0x80)
limit_always: AxisAct = _word(lambda _drive, word: word | INTERNAL_LIMIT)
own_bits_flicker: AxisAct = _word(_flickers(13 * _MS, 2, 0x8100))
reached_flickers: AxisAct = _word(_reached_flickers)
reached_inverted: AxisAct = _word(_reached_inverted)
record_position: AxisAct = _attribute(lambda drive: (drive.modes.interpolated, "position_subindex"))
homing_without_bit_10: AxisAct = _word(
    lambda drive, word: word & ~TARGET_REACHED if drive.modes.number == OperationMode.HM else word
)
homing_without_bit_12: AxisAct = _word(
    lambda drive, word: word & ~BIT_12 if drive.modes.number == OperationMode.HM else word
)
set_point_alone: AxisAct = _takes(
    lambda drive, _word, now: drive.mover.at_standstill and now >= drive.mover.demand.end_ns
)
set_point_needs_bit_5: AxisAct = _takes(lambda _drive, word, _now: bool(word & IMMEDIATELY))
homing_zero_refused: AxisAct = _axis_refuses(
    AbortCode.INVALID_VALUE, o.HOMING_METHOD, lambda _drive, value, _n: value == 0
)
homing_method_fixed: AxisAct = _axis_refuses(
    AbortCode.DEVICE_STATE, o.HOMING_METHOD, lambda drive, _value, _n: drive.state is State.OPERATION_ENABLED
)
period_refused: AxisAct = _axis_refuses(
    AbortCode.READ_ONLY, o.INTERPOLATION_TIME_PERIOD, lambda _drive, _value, _n: True
)
one_set_point: AxisAct = _model(lambda _strength: {"single_set_point": True})
stands_without_phase_lock: AxisAct = _model(lambda _strength: {"recovers_sync": False, "missing": MissingSetPoint()})
goes_on: AxisAct = _model(lambda cycles: {"missing": MissingSetPoint(cycles=int(cycles))})
faults_without_set_points: AxisAct = _model(
    lambda cycles: {"missing": MissingSetPoint(cycles=int(cycles), fault=0xFF02)}
)
homes_without_power: AxisAct = _model(lambda _strength: {"homes_without_power": True})
homing_goes_on_halted: AxisAct = _model(lambda _strength: {"homing_halts": False})
one_ramp: AxisAct = _model(lambda _strength: {"velocity_ramp_both_ways": True})
mapping_count_first: NodeAct = _refuses(
    AbortCode.UNSUPPORTED_ACCESS,
    lambda node, entry, _value, _n: bool(entry.subindex and node.store.number(entry.index)),
    pdo_mappings,
)
mapping_in_preop: NodeAct = _refuses(
    AbortCode.DEVICE_STATE,
    lambda node, _entry, _value, _n: node.nmt.state is not NmtState.PRE_OPERATIONAL,
    lambda node: [*pdo_records(node), *pdo_mappings(node)],
)
mapping_short: NodeAct = _refuses(
    AbortCode.MAPPING_TOO_LONG, lambda _node, entry, value, most: entry.subindex == 0 and value > most, pdo_mappings
)
tpdo_by_event: NodeAct = _refuses(
    AbortCode.INVALID_VALUE,
    lambda _node, entry, value, _n: entry.subindex == 2 and value < 254,
    lambda node: [TPDO + number for number in node.pdos.tpdos],
)
foreign_pdo_unmappable: NodeAct = _refuses(
    AbortCode.NOT_MAPPABLE,
    lambda node, entry, _value, _n: node.store.number(entry.index - 0x200, 1) & 0x7F != node.node_id,
    pdo_mappings,
)
consumer_refused: NodeAct = _refuses(
    AbortCode.READ_ONLY, lambda _node, entry, _value, _n: entry.subindex > 0, lambda _node: [0x1016]
)
four_bytes: NodeAct = _answers(_four_bytes)
size_unsaid: NodeAct = _answers(_size_unsaid)
garbage_behind: NodeAct = _answers(_garbage_behind)
more_bytes: NodeAct = _answers(_more_bytes)
acknowledged_with_data: NodeAct = _answers(_acknowledged_with_data)
short_answers: NodeAct = _answers(_short)
aborts_general: NodeAct = _answers(_aborted_with(0x08000000))
aborts_zero: NodeAct = _answers(_aborted_with(0))
emcy_own_register: NodeAct = _emergencies(
    lambda frame: CanFrame(frame.can_id, frame.data[:3] + b"\x02\x00\x00\x00\x00")
)
emcy_own_data: NodeAct = _emergencies(
    lambda frame: CanFrame(frame.can_id, frame.data[:3] + bytes.fromhex("0000007008"))
)
length_error_8220: NodeAct = _emergencies(
    lambda frame: CanFrame(frame.can_id, b"\x20\x82" + frame.data[2:]) if frame.data[:2] == b"\x10\x82" else frame
)


def control_unreadable(hooks: QuirkHooks, drive: VirtualDrive, _strength: float) -> None:
    """Refuse to read 0x6040."""
    own = o.CONTROLWORD + drive.objects.offset
    hooks.incoming.append(
        refusing(AbortCode.WRITE_ONLY, lambda command, index: command >> 5 in (2, 5) and index == own)
    )


def heartbeat_default(hooks: QuirkHooks, seconds: float) -> None:
    """Send heartbeats from the start."""
    hooks.preset(0x1017, 0, round(seconds * 1000))


def rpdos_late(hooks: QuirkHooks, seconds: float) -> None:
    """Process RPDOs late."""
    hooks.healthy(hooks.node.pdos.input.delay_ns, round(seconds * _S))
