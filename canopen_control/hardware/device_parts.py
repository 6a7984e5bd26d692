"""A <gpio> or <sensor> of the description that stands for signals of a CANopen device: its interfaces in units.

The device is the node that `device_name` or `node_id` names, else the node of the part's own name. Interfaces have the
names of the device's signals (`di0`, `ao1`, `position`, those of `signals` in bus.yml), or are objects by their address
with raw numbers (`0x6401:01`). A state of an output is what the device holds.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Final

from canopen_control.cia402.objects import MOTION
from canopen_control.errors import RobotConfigError, nearest
from canopen_control.hardware.derived_signals import DERIVED, EncoderVelocity, TiltOrientation
from canopen_control.hardware.device_inputs import InputSignal, NodeInputs
from canopen_control.hardware.device_outputs import OutputSignal
from canopen_control.hardware.interfaces import CommandInterface, StateInterface
from canopen_control.profiles.device_type import Profile
from canopen_control.profiles.profile_tables import object_signal

if TYPE_CHECKING:
    from collections.abc import Collection, Mapping, Sequence

    from canopen_control.master.cycle import Output, ProcessImage
    from canopen_control.master.remote_node import RemoteNode
    from canopen_control.profiles.device_signal import Signal
    from canopen_control.urdf.ros2_control import ControlJoint

__all__ = ["DevicePart", "DeviceParts", "device_of", "is_measured", "part_problems"]


_FEW: Final = 6  # names that a sentence bears


def _is(names: Sequence[str]) -> str:
    return "is" if len(names) == 1 else "are"


def device_of(part: ControlJoint, nodes: Mapping[str, int]) -> str | None:
    """Return the name of the node that a part stands for, of `nodes` with their ids; "" for a wrong one, None: none."""
    name, node_id = part.parameters.get("device_name"), part.parameters.get("node_id")
    if name is not None:
        return name if name in nodes else ""
    if node_id is not None:
        return next((each for each, number in nodes.items() if str(number) == node_id.strip()), "")
    return part.name if part.name in nodes else None


def is_measured(joint: ControlJoint, nodes: Mapping[str, tuple[RemoteNode, ProcessImage]]) -> bool:
    """Whether a joint is only measured, by a device that is no drive, such as an encoder."""
    name = device_of(joint, {name: node.node_id for name, (node, _) in nodes.items()})
    return bool(name) and not joint.command_interfaces and not nodes[name or ""][0].plan.axes


def signal_of(node: RemoteNode, name: str) -> Signal | None:
    """Return a signal of a node by the name of an interface."""
    return node.plan.signals.get(name) or object_signal(node.od, name)


def _derived(node: RemoteNode, name: str) -> bool:
    """Whether an interface is made of several values of the device; one of bus.yml with its name goes before it."""
    plan = node.plan
    if name in plan.signals or name not in DERIVED.get(plan.profile, ()):
        return False
    return {"lateral", "longitudinal"} <= plan.signals.keys() or "position" in plan.signals


def part_problems(part: ControlJoint, node: RemoteNode) -> list[str]:
    """Return what is wrong with the interfaces of a part, a sentence each."""
    problems = []
    sent = {(mapped.index, mapped.subindex) for layout in node.plan.rpdos for mapped in layout.objects}
    what = f"{node.plan.profile.words} {node.name}"
    for name in dict.fromkeys((*part.command_interfaces, *part.state_interfaces)):
        signal = signal_of(node, name)
        if _derived(node, name) and name not in part.command_interfaces:
            continue
        if signal is None:
            hint = nearest(name, node.plan.signals) or "; give it signals in bus.yml"
            problems.append(f"{part.name}: no signal {name!r} of {what}{hint}")
        elif name not in part.command_interfaces:
            continue
        elif not signal.output:
            problems.append(f"{part.name}: {name!r} of {what} is an input; make it a state_interface")
        elif signal.index in {index + offset for index in MOTION for offset in node.plan.axes}:
            problems.append(f"{part.name}: {name!r} of {what} moves an axis; a joint commands it")
        elif signal.address not in sent:
            problems.append(f"{part.name}: {name!r} of {what} is in no RPDO; map {signal.where} in bus.yml")
    return problems


class DevicePart:
    """The interfaces of one part; `part_problems` has found nothing wrong with it."""

    def __init__(self, part: ControlJoint, node: RemoteNode, image: ProcessImage, inputs: NodeInputs) -> None:
        self.name, self.node = part.name, node
        self.states = [StateInterface(part.name, name) for name in part.state_interfaces]
        self.commands = [
            CommandInterface(part.name, name, minimum=each.minimum, maximum=each.maximum)
            for name, each in part.command_interfaces.items()
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
                made = EncoderVelocity if node.plan.profile is Profile.ENCODER else TiltOrientation
                self._inputs.append(made(state, node.plan.signals, inputs))
                continue
            output = None if signal is None else image.output(node.node_id, *signal.address)
            if signal is not None and signal.output and output is not None:
                self._held.append(_HeldOutput(signal, state, output, node))
            elif signal is not None:
                self._inputs.append(InputSignal(signal, state, inputs))

    def read(self, now: int) -> None:
        """Show the inputs, and what the outputs are."""
        for signal in self._inputs:
            signal.read(now)
        for held in self._held:
            held.read()

    def write(self) -> None:
        """Send what was commanded."""
        for output in self._outputs.values():
            output.write()

    @property
    def commanded(self) -> list[str]:
        """The outputs that somebody has commanded."""
        return [output.signal.name for output in self._outputs.values() if output.commanded]

    @property
    def void(self) -> list[str]:
        """The outputs that were commanded when the node was lost, and by nobody since."""
        return [output.signal.name for output in self._outputs.values() if output.void]

    def release(self, interface: str) -> None:
        """Take that a controller gave a command interface back."""
        if (output := self._outputs.get(interface)) is not None:
            output.release()


def _output(node: RemoteNode, image: ProcessImage, name: str) -> tuple[Signal, Output | None]:
    signal = signal_of(node, name)
    assert signal is not None  # `part_problems` has looked
    return signal, image.output(node.node_id, *signal.address)


class _HeldOutput:
    """The state of an output: what the device holds as far as is known, nan while the node is lost."""

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
    """All <gpio> and <sensor> of a tag that stand for devices; RobotConfigError with everything that is wrong there.

    A part that names no device has no interfaces: other stacks have such parts for their own plugins. Without `present`
    there are none, and nothing to be done in a cycle.
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
                problems += (found := part_problems(part, node))
                if not found:
                    inputs = self._nodes.setdefault(name, NodeInputs(node, image))
                    self._parts.append(DevicePart(part, node, image, inputs))
            elif name is not None:
                wanted = part.parameters.get("device_name") or part.parameters.get("node_id", "")
                problems.append(f"{part.name}: {wanted!r} is no node of bus.yml{nearest(wanted, nodes)}")
        if problems:
            raise RobotConfigError("\n".join(problems))
        self.states: list[StateInterface] = [state for part in self._parts for state in part.states]
        self.commands: list[CommandInterface] = [command for part in self._parts for command in part.commands]
        self._owner = {command.name: part for part in self._parts for command in part.commands}
        self.present = bool(self._parts)

    @property
    def sending(self) -> bool:
        """Whether an output waits to be sent."""
        return any(pdo.changed and pdo.enabled for each in self._nodes.values() for pdo in each.node.sent)

    @property
    def has_news(self) -> bool:
        """Whether `take_news` has something to tell."""
        for each in self._nodes.values():  # noqa: SIM110 - `any` would make a generator in the cycle
            if each.lost or each.jumps:
                return True
        return False

    def take_news(self) -> list[tuple[RemoteNode, str, str]]:
        """Return node, kind and sentence of what happened since the last call: a node was lost, an input jumped."""
        found = []
        for inputs in self._nodes.values():
            jumps, inputs.jumps = inputs.jumps, []
            found += [(inputs.node, "input_jumped", text) for text in jumps]
            if inputs.lost:
                inputs.lost = False
                outputs = [name for part in self._parts if part.node is inputs.node for name in part.commanded]
                which = "those commanded are" if len(outputs) > _FEW else f"{', '.join(outputs)} {_is(outputs)}"
                held = f"; of its outputs {which} void, and not restored until commanded anew" if outputs else ""
                found.append((inputs.node, "device_lost", f"lost: its inputs are unknown{held}"))
        return found

    def void_outputs(self, node: RemoteNode) -> list[str]:
        """Return the outputs of a node that are void since it was lost: nothing restores them."""
        return [name for part in self._parts if part.node is node for name in part.void]

    @property
    def command_names(self) -> Collection[str]:
        """The command interfaces by name."""
        return self._owner.keys()

    def read(self, now: int) -> None:
        """Show all inputs."""
        for inputs in self._nodes.values():
            inputs.read(now)
        for part in self._parts:
            part.read(now)

    def write(self) -> None:
        """Send what was commanded."""
        for part in self._parts:
            part.write()

    def poll(self, now: int) -> None:
        """Ask the nodes for inputs that no TPDO carries, each for one."""
        for inputs in self._nodes.values():
            inputs.poll(now)

    def release(self, interfaces: Collection[str]) -> None:
        """Take that controllers gave command interfaces back."""
        for name in interfaces:
            if (part := self._owner.get(name)) is not None:
                part.release(name)
