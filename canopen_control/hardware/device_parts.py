"""<gpio> and <sensor> elements whose interfaces are signals of CANopen devices.

The device is the node that `device_name` or `node_id` names, else the node with the name of the element. Interfaces
have the names of the device's signals (`di0`, `ao1`, `position`, or `signals` in bus.yml), or are objects by address
with raw numbers (`0x6401:01`). The state interface of an output is the value in the device.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Final

from canopen_control.cia402.objects import MOTION
from canopen_control.errors import RobotConfigError, nearest
from canopen_control.hardware.interfaces import CommandInterface, StateInterface
from canopen_control.od.codec import decode
from canopen_control.od.model import DataType
from canopen_control.profiles import Profile, object_signal, retyped

if TYPE_CHECKING:
    from collections.abc import Collection, Mapping, Sequence

    from canopen_control.cia301.sdo_exchange import SdoRequest
    from canopen_control.master.cycle import Input, Output, ProcessImage
    from canopen_control.master.remote_node import RemoteNode
    from canopen_control.od.model import Address, Entry, Value
    from canopen_control.profiles import Signal
    from canopen_control.urdf.ros2_control import ControlJoint


# Outputs of devices that are not drives: from command interfaces to RPDOs.
#
# An output is never restored: after its node was lost or has restarted, the old command is void, and the output keeps
# the value of the device (error value or default) until another value is commanded. An output is sent with its first
# command and after every change. On release it is set to the value that its controller chooses, else to its safe value,
# unless the value is to be kept.


_HALF: Final = 0.5


class OutputSignal:
    """Device output in an RPDO, commanded by a command interface."""

    def __init__(
        self,
        signal: Signal,
        command: CommandInterface,
        output: Output,
        node: RemoteNode,
        *,
        keeps: bool = False,
    ) -> None:
        self.signal, self.command = signal, command
        self._output, self._node = output, node
        entry = node.od[signal.address]
        self._whole = entry.data_type.is_integer
        self._lowest, self._highest = _bounds(entry)
        self._boots = -1
        self._gain = signal.gain({})
        self._void = math.nan  # command that was present while the node was absent
        self._commanded = math.nan  # last command that was sent
        self.void = False  # the node was lost while the output was commanded, and no new command followed
        command.enabled = False
        command.safe = math.nan if keeps or signal.safe is None else signal.safe
        command.lowest, command.highest = self._span()

    @property
    def commanded(self) -> bool:
        """Whether a command was sent since the node became ready."""
        return not math.isnan(self._commanded)

    def write(self) -> None:
        """Send a new, finite command; clear the command while the node is absent."""
        command, node = self.command, self._node
        value = command.value
        if not node.ready or node.boots != self._boots:
            self._node_absent(value)
            return
        if math.isnan(value):
            self._void = math.nan  # any further command is new
        elif value != self._commanded and value != self._void and not math.isinf(value):
            first = math.isnan(self._commanded)
            self._void, self._commanded, self.void = math.nan, value, False
            self._send(value, always=first)

    def release(self) -> None:
        """Send the controller's release value, else the safe value, and clear the command."""
        self.command.value = math.nan
        commanded, self._commanded, self.void = self._commanded, math.nan, False
        value, self.command.release_value = self.command.release_value, None
        safe = self.command.safe if value is None else value
        if not math.isnan(commanded) and safe is not None and not math.isnan(safe) and self._node.ready:
            self._send(safe, always=False)

    def _node_absent(self, value: float) -> None:
        """Clear the command after a node loss or reboot; update the scale once the node is ready."""
        self.void |= self.commanded
        self._commanded, self._void = math.nan, value
        self.command.value = math.nan  # a controller that continues writes the old command again, which is void
        self.command.enabled = self._node.ready
        if self._node.ready:
            identity = self._node.identity
            self._boots = self._node.boots
            self._gain = self.signal.gain({} if identity is None else identity.presets)
            self.command.lowest, self.command.highest = self._span()

    def _span(self) -> tuple[float, float]:
        """Return the smallest and largest value of the output in its unit."""
        if self.signal.bit is not None:
            return 0.0, 1.0
        ends = [self.signal.value(raw, self._gain) for raw in (self._lowest, self._highest)]
        return min(ends), max(ends)

    def _send(self, value: float, *, always: bool) -> None:
        output, signal = self._output, self.signal
        if signal.bit is not None:
            mask = 1 << signal.bit
            raw: float = int(output.value) | mask if value > _HALF else int(output.value) & ~mask
        else:
            raw = min(max(signal.raw(value, self._gain, whole=self._whole), self._lowest), self._highest)
        if always or raw != output.value:
            output.write(raw)


def _bounds(entry: Entry) -> tuple[float, float]:
    """Return the smallest and largest raw value of an object's data type."""
    if entry.data_type.is_integer:
        return entry.data_type.minimum, entry.data_type.maximum
    return (-3.4e38, 3.4e38) if entry.data_type is DataType.REAL32 else (-1.7e308, 1.7e308)


# Inputs of devices that are not drives: from a TPDO or by SDO to a state interface in units, nan while unknown.
#
# A value is valid from the boot on, which reads it, until the node is lost, its TPDO is overdue (three event timers, or
# the SYNCs that bus.yml allows), or the device reports it as invalid. The age of an input that is sent only on change
# is not limited: the heartbeat monitors the node. Signals without a TPDO are read by SDO, each object at most once per
# second.


POLL_NS: Final = 1_000_000_000
_POLLED_AGE_NS: Final = 5 * POLL_NS
_SHORTEST_NS: Final = 50_000_000  # frames that are received together may have been sent one after the other
_STANDSTILL_NS: Final = 500_000_000  # for an input that is sent on change only


class RawInput:
    """Raw value of one device object, valid while `known` is True."""

    __slots__ = ("_began_with", "_input", "_node", "_polled_at", "address", "data_type", "known", "read_at", "value")

    def __init__(self, node: RemoteNode, address: Address, data_type: DataType, mapped: Input | None) -> None:
        self.address, self.data_type = address, data_type
        self.value: Value = 0
        self.known = False
        self.read_at = -1  # time of the last SDO answer, -1: none since the boot
        self._node, self._input = node, mapped
        self._began_with = False
        self._polled_at = -POLL_NS

    @property
    def polled(self) -> bool:
        """Whether the object is in no TPDO and must be read by SDO."""
        return self._input is None

    @property
    def comes_by_change(self) -> bool:
        """Whether the TPDO is sent only on change, so that a missing frame means an unchanged value."""
        return self._input is not None and self._input.pdo.age_limit_ns == 0

    def begin(self, now: int) -> None:
        """Start with the value read during boot, if any."""
        presets = {} if self._node.identity is None else self._node.identity.presets
        self._began_with = self.address in presets
        self.read_at = -1
        if self._began_with:
            self.value, self.read_at = presets[self.address], now

    def read(self, now: int) -> None:
        """Update the value and its validity at `now` in ns; call only while the node is ready."""
        source = self._input
        if source is None:
            self.known = self.read_at >= 0 and now - self.read_at <= _POLLED_AGE_NS
            return
        pdo = source.pdo
        since = pdo.stamp if pdo.stamp >= 0 else self.read_at
        self.known = since >= 0 and not pdo.overdue and not 0 < pdo.age_limit_ns < now - since
        if pdo.stamp >= 0:
            self.value = source.value

    @property
    def stamp(self) -> int:
        return self.read_at if self._input is None or self._input.pdo.stamp < 0 else self._input.pdo.stamp

    def poll(self, now: int) -> bool:
        """Request the object by SDO if due; return whether a request was sent."""
        if self._input is not None or now - self._polled_at < POLL_NS:
            return False
        self._polled_at = now
        self._node.read(*self.address, lambda request: self._answered(request, now))
        return True

    def _answered(self, request: SdoRequest, now: int) -> None:
        if request.error is None:
            try:
                self.value, self.read_at = decode(request.data, self.data_type), now
            except ValueError:
                return


class NodeInputs:
    """Inputs of one node; interfaces of the same object share one input."""

    def __init__(self, node: RemoteNode, image: ProcessImage) -> None:
        self.node, self._image = node, image
        self._inputs: dict[Address, RawInput] = {}
        self.boots = -1
        self.ready = self.lost = False  # lost: the node was lost, not reported yet
        self.jumps: list[str] = []  # texts that are not reported yet
        self._jumped: dict[str, int] = {}  # by signal: boot count at the last report

    def of(self, address: Address) -> RawInput:
        """Return the input of an object, created on first use."""
        device_input = self._inputs.get(address)
        if device_input is None:
            entry = self.node.od[address]
            mapped = self._image.input(self.node.node_id, *address)
            device_input = self._inputs[address] = RawInput(self.node, address, entry.data_type, mapped)
        return device_input

    def read(self, now: int) -> None:
        """Update all inputs; after a boot, start with the values read during the boot."""
        node = self.node
        self.lost |= self.ready and not node.ready
        self.ready = node.ready
        if not node.ready:
            return
        if node.boots != self.boots:
            self.boots = node.boots
            for device_input in self._inputs.values():
                device_input.begin(now)
        for device_input in self._inputs.values():
            device_input.read(now)

    def report_jump(self, signal: str, text: str) -> None:
        """Record a jump of a signal for `take_news`, at most once per signal and boot."""
        if self._jumped.get(signal) != self.boots:
            self._jumped[signal] = self.boots
            self.jumps.append(text)

    def poll(self, now: int) -> None:
        """Request at most one due input by SDO."""
        if self.ready:
            for device_input in self._inputs.values():
                if device_input.polled and device_input.poll(now):
                    return


class InputSignal:
    """Device input that updates a state interface."""

    def __init__(self, signal: Signal, state: StateInterface, inputs: NodeInputs) -> None:
        self.signal, self.state = signal, state
        self._inputs = inputs
        self._raw = inputs.of(signal.address)
        self._status = None if signal.status is None else inputs.of(signal.status)
        self._boots = -1
        self._type = None if signal.data_type is self._raw.data_type else signal.data_type
        self._retyped: tuple[Value | None, Value] = (None, 0)
        self._gain = signal.gain({})
        self._range = 0
        self._turned = 0.0
        self._last: float | None = None
        self._before, self._stamp = math.nan, 0  # last value, and time at which it was received
        self._jumped = False

    def read(self, now: int) -> None:
        """Update the state interface; nan for an unknown or invalid value, and after a jump."""
        del now
        inputs, raw = self._inputs, self._raw
        if not inputs.ready or not raw.known or not self._valid():
            self.state.value = math.nan
            self._last = None
            return
        if self._boots != inputs.boots:
            self._renew()
        number = raw.value
        if self._type is not None:
            if number != self._retyped[0]:
                self._retyped = (number, retyped(number, raw.data_type, self._type))
            number = self._retyped[1]
        if isinstance(number, int | float):
            value = self.signal.value(self._unwrapped(number), self._gain)
            self.state.value = math.nan if self.signal.max_rate is not None and self._jumps(value) else value

    def _valid(self) -> bool:
        status = self._status
        return status is None or (status.known and status.value == 0)

    def _renew(self) -> None:
        """Update the scale and the wrap-around range from the objects that were read during the boot."""
        identity = self._inputs.node.identity
        numbers = {} if identity is None else identity.presets
        self._boots, self._gain = self._inputs.boots, self.signal.gain(numbers)
        wraps = numbers.get(self.signal.unwrap, 0) if self.signal.unwrap is not None else 0
        self._range = wraps if isinstance(wraps, int) and wraps > 1 else 0
        self._last = None
        self._before, self._jumped = math.nan, False

    def _jumps(self, value: float) -> bool:
        """Whether the value has exceeded its maximum rate of change since the node's boot."""
        stamp, signal = self._raw.stamp, self.signal
        if self._jumped or stamp == self._stamp:
            return self._jumped
        passed = max(stamp - self._stamp, _SHORTEST_NS)
        if passed > _STANDSTILL_NS and self._raw.comes_by_change:
            passed = _SHORTEST_NS  # no motion until now: the change took less than the whole interval
        limit = (signal.max_rate or 0.0) * passed / 1e9
        if abs(value - self._before) > limit:  # False for the first value, which is compared with nan
            self._jumped = True
            text = f"{self.state.name} jumped from {self._before:g} to {value:g} {signal.unit}".rstrip()
            self._inputs.report_jump(signal.name, f"{text}; its value is nan until the node has booted again")
        self._before, self._stamp = value, stamp
        return self._jumped

    def _unwrapped(self, raw: float) -> float:
        """Return a raw position that continues beyond the device's total range."""
        if not self._range:
            return raw
        if self._last is None:
            self._turned = 0.0
        else:
            step = raw - self._last
            self._turned -= self._range * round(step / self._range)
        self._last = raw
        return raw + self._turned


# State interfaces that are computed from values of a device: velocity of an encoder, orientation of an inclinometer.
#
# The velocity is the distance between the two newest positions divided by the time between them, and 0 if no new
# position arrives for a while. Two angles define no heading: the orientation is roll (`lateral`) and pitch
# (`longitudinal`) with yaw 0, as a quaternion; angular velocity and acceleration, which an IMU has, are nan.


_ORIENTATION: Final = ("orientation.x", "orientation.y", "orientation.z", "orientation.w")
_ABSENT: Final = tuple(f"{what}.{axis}" for what in ("angular_velocity", "linear_acceleration") for axis in "xyz")
DERIVED: Final = {Profile.ENCODER: ("velocity",), Profile.INCLINOMETER: (*_ORIENTATION, *_ABSENT)}
"""Names of the computed state interfaces, by device profile."""

_STANDING_NS: Final = 50_000_000


class EncoderVelocity:
    """State interface with the velocity computed from an encoder's position, in position units per s."""

    def __init__(self, state: StateInterface, signals: Mapping[str, Signal], inputs: NodeInputs) -> None:
        signal = signals["position"]
        self._state, self._raw = state, inputs.of(signal.address)
        self._position = InputSignal(signal, StateInterface(state.joint, "position of the velocity"), inputs)
        self._last = math.nan
        self._at = -1
        self._interval = 0

    def read(self, now: int) -> None:
        """Update the velocity: nan if the position is unknown, 0 if no new positions arrive."""
        self._position.read(now)
        position, raw = self._position.state.value, self._raw
        if math.isnan(position):
            self._state.value = self._last = math.nan
            return
        if raw.stamp != self._at:
            self._update(position, raw)
        elif now - self._at > max(_STANDING_NS, 2 * self._interval):
            self._state.value = 0.0

    def _update(self, position: float, raw: RawInput) -> None:
        self._interval = raw.stamp - self._at
        has_period = not math.isnan(self._last) and self._interval > 0
        self._state.value = (position - self._last) * 1e9 / self._interval if has_period else math.nan
        self._last, self._at = position, raw.stamp


class TiltOrientation:
    """State interface with one quaternion component computed from an inclinometer's angles."""

    def __init__(self, state: StateInterface, signals: Mapping[str, Signal], inputs: NodeInputs) -> None:
        self._state = state
        self._angles = [
            InputSignal(signals[name], StateInterface(state.joint, f"{name} of {state.interface}"), inputs)
            for name in ("lateral", "longitudinal")
        ]

    def read(self, now: int) -> None:
        """Update the quaternion component; nan if an angle is unknown."""
        for angle in self._angles:
            angle.read(now)
        roll, pitch = (angle.state.value / 2 for angle in self._angles)
        name = self._state.interface
        if name == "orientation.x":
            self._state.value = math.sin(roll) * math.cos(pitch)
        elif name == "orientation.y":
            self._state.value = math.cos(roll) * math.sin(pitch)
        elif name == "orientation.z":
            self._state.value = -math.sin(roll) * math.sin(pitch)
        elif name == "orientation.w":
            self._state.value = math.cos(roll) * math.cos(pitch)


_FEW: Final = 6  # maximum number of names in a sentence


def _is(names: Sequence[str]) -> str:
    return "is" if len(names) == 1 else "are"


def _them(names: Sequence[str]) -> str:
    return "it" if len(names) == 1 else "them"


def device_of(part: ControlJoint, nodes: Mapping[str, int]) -> str | None:
    """Return the name of a part's node: "" if the part names an unknown node, None if it has no device."""
    name, node_id = part.parameters.get("device_name"), part.parameters.get("node_id")
    if name is not None:
        return name if name in nodes else ""
    if node_id is not None:
        return next((name for name, number in nodes.items() if str(number) == node_id.strip()), "")
    return part.name if part.name in nodes else None


def is_measured(joint: ControlJoint, nodes: Mapping[str, tuple[RemoteNode, ProcessImage]]) -> bool:
    """Whether a joint is only measured, by a device other than a drive, such as an encoder."""
    name = device_of(joint, {name: node.node_id for name, (node, _) in nodes.items()})
    return bool(name) and not joint.command_interfaces and not nodes[name or ""][0].plan.axes


def signal_of(node: RemoteNode, name: str) -> Signal | None:
    """Return the signal for an interface name or an object address, or None."""
    return node.plan.signals.get(name) or object_signal(node.od, name)


def _derived(node: RemoteNode, name: str) -> bool:
    """Whether an interface is computed from other values of the device.

    A signal of the same name in bus.yml takes precedence.
    """
    plan = node.plan
    if name in plan.signals or name not in DERIVED.get(plan.profile, ()):
        return False
    return {"lateral", "longitudinal"} <= plan.signals.keys() or "position" in plan.signals


def part_problems(part: ControlJoint, node: RemoteNode) -> list[str]:
    """Return the configuration errors of a part's interfaces, one sentence each."""
    problems, unsent, possible = list[str](), dict[str, list[str]](), set[str]()
    sent = {(mapped.index, mapped.subindex) for layout in node.plan.rpdos for mapped in layout.objects}
    device = f"{node.plan.profile.words} {node.name}"
    for name in dict.fromkeys((*part.command_interfaces, *part.state_interfaces)):
        signal = signal_of(node, name)
        if _derived(node, name) and name not in part.command_interfaces:
            continue
        if signal is None:
            hint = nearest(name, node.plan.signals) or "; define the signal in bus.yml"
            problems.append(f"{part.name}: no signal {name!r} of {device}{hint}")
        elif name not in part.command_interfaces:
            continue
        elif not signal.output:
            problems.append(f"{part.name}: {name!r} of {device} is an input; make it a state_interface")
        elif signal.index in {index + offset for index in MOTION for offset in node.plan.axes}:
            problems.append(f"{part.name}: {name!r} of {device} moves an axis; command it through a joint")
        elif signal.address not in sent:
            place, entry = signal.where.partition(".")[0], node.od.get(*signal.address)
            unsent.setdefault(place, []).append(repr(name))
            if entry is not None and entry.rpdo_mappable:
                possible.add(place)
    for place, names in unsent.items():  # outputs in one object, such as the bits of a byte, share a sentence
        few = names if len(names) <= _FEW else [*names[: _FEW - 1], f"{len(names) - _FEW + 1} more"]
        text = f"{', '.join(few)} of {device} {_is(names)} in no RPDO"
        remedy = f"map {place} in bus.yml" if place in possible else f"{place} cannot be mapped: remove {_them(names)}"
        problems.append(f"{part.name}: {text}; {remedy}")
    return problems


class DevicePart:
    """Interfaces of a part without configuration errors (see `part_problems`)."""

    def __init__(self, part: ControlJoint, node: RemoteNode, image: ProcessImage, inputs: NodeInputs) -> None:
        self.name, self.node = part.name, node
        self.states = [StateInterface(part.name, name) for name in part.state_interfaces]
        self.commands = [
            CommandInterface(part.name, name, minimum=interface.minimum, maximum=interface.maximum)
            for name, interface in part.command_interfaces.items()
        ]
        self._inputs: list[InputSignal | EncoderVelocity | TiltOrientation] = []
        self._held: list[_HeldOutput] = []
        keeps = part.parameters.get("on_release", "safe").strip() == "keep"
        self._outputs = {
            command.name: OutputSignal(signal, command, output, node, keeps=keeps)
            for command in self.commands
            for signal, output in [_output(node, image, command.interface)]
            if output is not None
        }
        for state in self.states:
            signal = signal_of(node, state.interface)
            if _derived(node, state.interface):
                quantity = EncoderVelocity if node.plan.profile is Profile.ENCODER else TiltOrientation
                self._inputs.append(quantity(state, node.plan.signals, inputs))
                continue
            output = None if signal is None else image.output(node.node_id, *signal.address)
            if signal is not None and signal.output and output is not None:
                self._held.append(_HeldOutput(signal, state, output, node))
            elif signal is not None:
                self._inputs.append(InputSignal(signal, state, inputs))

    def read(self, now: int) -> None:
        for signal in self._inputs:
            signal.read(now)
        for output in self._held:
            output.read()

    def write(self) -> None:
        for output in self._outputs.values():
            output.write()

    @property
    def commanded(self) -> list[str]:
        """Names of the outputs with an active command."""
        return [output.signal.name for output in self._outputs.values() if output.commanded]

    @property
    def void(self) -> list[str]:
        """Names of the outputs whose command was lost with the node and has not been replaced."""
        return [output.signal.name for output in self._outputs.values() if output.void]

    def release(self, interface: str) -> None:
        """Release the output of a command interface that is no longer claimed."""
        if (output := self._outputs.get(interface)) is not None:
            output.release()


def _output(node: RemoteNode, image: ProcessImage, name: str) -> tuple[Signal, Output | None]:
    signal = signal_of(node, name)
    assert signal is not None  # checked by `part_problems`
    return signal, image.output(node.node_id, *signal.address)


class _HeldOutput:
    """State interface of an output with the last known value in the device; nan while the node is lost."""

    def __init__(self, signal: Signal, state: StateInterface, output: Output, node: RemoteNode) -> None:
        self._signal, self._state, self._output, self._node = signal, state, output, node
        self._boots = -1
        self._gain = signal.gain({})

    def read(self) -> None:
        node = self._node
        if not node.ready:
            self._state.value = math.nan
            return
        if node.boots != self._boots:
            self._boots = node.boots
            self._gain = self._signal.gain({} if node.identity is None else node.identity.presets)
        self._state.value = self._signal.value(self._output.value, self._gain)


class DeviceParts:
    """All parts of a <ros2_control> tag with a CANopen device; RobotConfigError lists all configuration errors.

    A part that names no device has no interfaces: descriptions for other stacks have such parts for their own plugins.
    `present` is False if there are no parts, so that nothing has to be done in a cycle.
    """

    def __init__(self, parts: Sequence[ControlJoint], nodes: Mapping[str, tuple[RemoteNode, ProcessImage]]) -> None:
        self._parts: list[DevicePart] = []
        self._nodes: dict[str, NodeInputs] = {}
        problems: list[str] = []
        ids = {name: node.node_id for name, (node, _) in nodes.items()}
        for part in parts:
            name = device_of(part, ids)
            if name:
                node, image = nodes[name]
                problems += (part_errors := part_problems(part, node))
                if not part_errors:
                    inputs = self._nodes.setdefault(name, NodeInputs(node, image))
                    self._parts.append(DevicePart(part, node, image, inputs))
            elif name is not None:
                device = part.parameters.get("device_name") or part.parameters.get("node_id", "")
                problems.append(f"{part.name}: {device!r} is not a node of bus.yml{nearest(device, nodes)}")
        if problems:
            raise RobotConfigError("\n".join(problems))
        self.states: list[StateInterface] = [state for part in self._parts for state in part.states]
        self.commands: list[CommandInterface] = [command for part in self._parts for command in part.commands]
        self._owner = {command.name: part for part in self._parts for command in part.commands}
        self.present = bool(self._parts)

    @property
    def sending(self) -> bool:
        """Whether a changed RPDO of a device is waiting to be sent."""
        return any(pdo.changed and pdo.enabled for node in self._nodes.values() for pdo in node.node.sent)

    @property
    def has_news(self) -> bool:
        """Whether there are events for `take_news`."""
        for node in self._nodes.values():  # noqa: SIM110 - `any` would make a generator in the cycle
            if node.lost or node.jumps:
                return True
        return False

    def take_news(self) -> list[tuple[RemoteNode, str, str]]:
        """Return new events as node, kind and text: lost nodes and jumps of inputs."""
        events = []
        for inputs in self._nodes.values():
            jumps, inputs.jumps = inputs.jumps, []
            events += [(inputs.node, "input_jumped", text) for text in jumps]
            if inputs.lost:
                inputs.lost = False
                outputs = [name for part in self._parts if part.node is inputs.node for name in part.commanded]
                which = "its outputs" if len(outputs) > _FEW else ", ".join(outputs)
                suffix = f"; the commands of {which} are void until commanded again" if outputs else ""
                events.append((inputs.node, "device_lost", f"lost: its inputs are unknown{suffix}"))
        return events

    def void_outputs(self, node: RemoteNode) -> list[str]:
        """Return the names of a node's outputs whose command was lost with the node."""
        return [name for part in self._parts if part.node is node for name in part.void]

    @property
    def command_names(self) -> Collection[str]:
        return self._owner.keys()

    def read(self, now: int) -> None:
        for inputs in self._nodes.values():
            inputs.read(now)
        for part in self._parts:
            part.read(now)

    def write(self) -> None:
        for part in self._parts:
            part.write()

    def poll(self, now: int) -> None:
        """Request the inputs that are in no TPDO by SDO, at most one per node and call."""
        for inputs in self._nodes.values():
            inputs.poll(now)

    def release(self, interfaces: Collection[str]) -> None:
        """Release the outputs of command interfaces that are no longer claimed."""
        for name in interfaces:
            if (part := self._owner.get(name)) is not None:
                part.release(name)
