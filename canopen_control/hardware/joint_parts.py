"""The parts of a joint and of the drive axis behind it, and what they say: state, power, homing, feedback.

The law of this file: nothing here acts; what moves the axis is `joint`.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from canopen_control.cia402.state import State
from canopen_control.errors import RobotConfigError
from canopen_control.hardware.axis import Axis, configured_machine
from canopen_control.hardware.axis_parameters import AxisParameters
from canopen_control.hardware.axis_power import AxisPower, AxisState
from canopen_control.hardware.axis_status import BLIND_STOP_NS
from canopen_control.hardware.feedback import Feedback
from canopen_control.hardware.homing_run import HomingRun, Reference
from canopen_control.hardware.interfaces import DIGITAL_OUTPUTS, POSITION, TARGET, VELOCITY, StateInterface
from canopen_control.hardware.joint_events import FaultReason, JointEvent
from canopen_control.hardware.joint_targets import JointTargets
from canopen_control.master.event_log import Level

if TYPE_CHECKING:
    from canopen_control.cia402.drive import DriveMachine
    from canopen_control.cia402.units import Scale
    from canopen_control.master.cycle import ProcessImage
    from canopen_control.master.remote_node import RemoteNode
    from canopen_control.urdf.ros2_control import ControlJoint

__all__ = ["JointParts"]


class JointParts:
    """A joint bound to one axis of one node; the interfaces are what controllers claim.

    `tracking` is how well it follows its set-points.
    """

    def __init__(self, description: ControlJoint, node: RemoteNode, image: ProcessImage, axis: int = 0) -> None:
        self.joint, self.node = description.name, node
        self.axis = Axis(description.name, node, image, axis)
        self.machine: DriveMachine = configured_machine(node)
        profile = TARGET in description.command_interfaces
        self.parameters = AxisParameters(self.axis, self._on_parameters, self._on_parameter, profile=profile)
        self.targets: JointTargets = JointTargets(description, self.axis, self.machine, self.parameters)
        self.commands = self.targets.commands
        self.reference = Reference(self.axis, self.machine, self.parameters)
        self.feedback = Feedback(description, self.axis)
        self.states = self.feedback.states
        self.reason = FaultReason(self.axis, self._on_error_code)
        self.power = AxisPower(
            self.machine,
            [each for name, each in self.commands.items() if name != DIGITAL_OUTPUTS],
            holds_load=_holds_load(description),
        )
        self.tracking = self.targets.tracking
        unknown = StateInterface(description.name, POSITION)  # for ever nan
        self._measured = {name: self.states.get(name, unknown) for name in (POSITION, VELOCITY)}
        self._blind_stop_ns = BLIND_STOP_NS
        self._events: list[JointEvent] = []

    @property
    def scale(self) -> Scale:
        """Device units and SI."""
        return self.axis.scale

    @property
    def state(self) -> State | None:
        """The CiA 402 state, None while the node is not there."""
        return self.machine.state if self.node.ready else None

    @property
    def statusword(self) -> int | None:
        """The newest statusword, None before the first; without its TPDO the one that SDO brought."""
        status = self.axis.statusword
        return status.value if status.fresh and not status.pdo.overdue else self.machine.statusword

    @property
    def claimed(self) -> str | None:
        """The command interface that a controller drives."""
        return self.targets.claimed

    @property
    def wanted(self) -> bool:
        """Whether it is to follow commands."""
        return self.power.wanted

    @property
    def following(self) -> bool:
        """Whether targets are followed now; the command interfaces say the same as `enabled`."""
        return self.power.following

    @property
    def enabled(self) -> bool:
        """Whether the drive follows commands."""
        return self.power.following and self.node.ready

    @property
    def homing(self) -> HomingRun | None:
        """The homing under way."""
        return self.reference.homing

    @property
    def homed(self) -> bool:
        """Whether its zero was found by a homing, and not lost since."""
        return self.reference.known

    @property
    def may_rise(self) -> bool:
        """Whether nothing but its group keeps it from being enabled."""
        machine = self.machine
        return machine.enabled or (machine.waiting and self.parameters.loaded)

    @property
    def standing(self) -> bool:
        """Whether the drive reports (nearly) no motion."""
        return self.feedback.standing

    def age_ns(self, now: int) -> int | None:
        """How old the newest statusword is."""
        return self.axis.statusword.age_ns(now)

    def has_come_to_rest(self, now: int) -> bool:
        """Whether a stop may end in disabling the drive."""
        if not self.node.ready or self.machine.state is not State.OPERATION_ENABLED:
            return True
        if self.axis.is_stale:
            return now - self.power.since > self._blind_stop_ns
        return self.power.state is AxisState.SETTLING and self.feedback.standing

    def events(self) -> list[JointEvent]:
        """Return what happened since the last call."""
        happened, self._events = self._events, []
        return happened

    def _on_error_code(self, text: str) -> None:
        self._events.append(JointEvent("error_code", text, Level.INFO))

    def _on_parameter(self, text: str) -> None:
        self._events.append(JointEvent("parameters", text))

    def _on_parameters(self) -> None:
        self.feedback.refresh_scale()
        self.targets.refresh()
        self._events += [JointEvent("parameters", text) for text in self.parameters.failed]


def _holds_load(description: ControlJoint) -> bool:
    """Read whether a joint's load would fall if its drive had no power; RobotConfigError for what is no truth value."""
    text = description.parameters.get("holds_load", "false").strip().lower()
    if text not in ("true", "false"):
        raise RobotConfigError(f"joint {description.name}: holds_load is {text!r}; it is true or false")
    return text == "true"
