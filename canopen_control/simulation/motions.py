"""Commands that a robot's controllers accept, with the ranges of their values, for random schedules."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

from canopen_control.controllers.base import twist_axes_of
from canopen_control.controllers.types import moves_joints
from canopen_control.errors import CanopenError
from canopen_control.host.reactor import MarkedSelector, Reactor
from canopen_control.host.timer import ManualClock
from canopen_control.runtime.core import RobotCore
from canopen_control.runtime.startup_controllers import load_controller
from canopen_control.urdf.joint_element import EFFORT, POSITION, VELOCITY

if TYPE_CHECKING:
    from canopen_control.controllers.base import Controller
    from canopen_control.runtime.setup import RobotSetup
    from canopen_control.urdf.joint_element import Joint


_TWIST: Final = {"linear.x": 0.4, "linear.y": 0.3, "angular.z": 0.8}  # m/s, rad/s
_MAX: Final = {VELOCITY: 8.0, POSITION: 0.6, EFFORT: 0.2}  # limits of joints without smaller ones: rad/s, rad, Nm
_MARGIN: Final = 0.9  # fraction of a limit, so that commands are valid


@dataclass(frozen=True, slots=True)
class SampleMotion:
    """Controller that moves joints, the kind of its commands, and the range of each value.

    `starts` is True if the controller is active from the start. `life_ns` is the command timeout, 0 for none. `joints`
    are the joints of a trajectory, in the controller's order. `interfaces` are the command interfaces that receive
    single values.
    """

    controller: str
    kind: str
    ranges: tuple[tuple[float, float], ...]
    starts: bool
    life_ns: int = 0
    joints: tuple[str, ...] = ()
    interfaces: tuple[str, ...] = ()


def motions_of(setup: RobotSetup) -> tuple[SampleMotion, ...]:
    """Return the commands that a robot's controllers accept, in the order of the controllers file.

    Controllers that cannot be loaded are omitted.
    """
    with Reactor(ManualClock(), MarkedSelector()) as reactor:
        core = RobotCore(setup, reactor)
        motions = [_motion(setup, core, name, config.type) for name, config in setup.controllers.controllers.items()]
        core.close()
    return tuple(motion for motion in motions if motion is not None)


def _motion(setup: RobotSetup, core: RobotCore, name: str, type_name: str) -> SampleMotion | None:
    if not moves_joints(type_name):
        return None
    try:
        if name not in core.manager.states:
            load_controller(setup, core.manager, name)
        controller = core.manager.get(name)
        names = controller.command_interface_names()
    except CanopenError:
        return None
    starts, life_ns = name in setup.to_activate, controller.command_timeout.limit_ns
    if axes := twist_axes_of(controller):
        return SampleMotion(name, "command", tuple((-_TWIST[axis], _TWIST[axis]) for axis in axes), starts, life_ns)
    joints = setup.description.joints
    if controller.topic is None or "trajectory" in type_name:
        return _trajectory(controller, joints, starts=starts)
    ranges = [
        _range(joints.get(limit_or_name.partition("/")[0]), limit_or_name.rpartition("/")[2]) for limit_or_name in names
    ]
    limits = tuple(limit_or_name for limit_or_name in ranges if limit_or_name is not None)
    if not limits or len(limits) != len(ranges):
        return None
    return SampleMotion(name, "command", limits, starts, life_ns, interfaces=tuple(names))


def _trajectory(controller: Controller, joints: object, *, starts: bool) -> SampleMotion | None:
    if "trajectory" not in controller.type:
        return None  # grippers have goals instead
    ranges = [_range(joints.get(joint), POSITION) for joint in controller.joints]  # type: ignore[attr-defined]
    return SampleMotion(controller.name, "trajectory", tuple(ranges), starts, joints=tuple(controller.joints))  # type: ignore[arg-type]


def _range(joint: Joint | None, interface: str) -> tuple[float, float] | None:
    most = _MAX.get(interface)
    if joint is None or most is None:
        return None
    limits = joint.limits
    if interface == POSITION:
        low, high = max(-most, limits.lower * _MARGIN), min(most, limits.upper * _MARGIN)
        return (low, high) if low < high else (limits.lower, limits.upper)
    limit = limits.speed if interface == VELOCITY else limits.max_effort
    return (-min(most, limit * _MARGIN), min(most, limit * _MARGIN)) if math.isfinite(limit) else (-most, most)
