"""The parameters of the gripper action controllers, of jazzy.

Keys, defaults and meaning are those of gripper_controllers and parallel_gripper_controller.
"""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from typing import TYPE_CHECKING, TypeVar, cast

from canopen_control.controllers.params import CommonParams
from canopen_control.controllers.standard_params import LoopGains
from canopen_control.errors import RobotConfigError
from canopen_control.hardware.interfaces import POSITION, VELOCITY
from canopen_control.yamlfile.convert import derived, setting

if TYPE_CHECKING:
    from canopen_control.controllers.params import Params

__all__ = ["EffortGripperParams", "GripperParams", "ParallelGripperParams", "read_params"]

P = TypeVar("P", bound="GripperParams")


@dataclass(frozen=True)
class GripperParams(CommonParams):
    """Parameters of position_controllers/GripperActionController: rad or m, Nm or N, s."""

    joint: str = ""
    action_monitor_rate: float = setting(20.0, low=0.1)
    goal_tolerance: float = setting(0.01, low=0.0)
    max_effort: float = setting(0.0, low=0.0)
    allow_stalling: bool = False
    stall_velocity_threshold: float = setting(0.001, low=0.0)
    stall_timeout: float = setting(1.0, low=0.0, high=1e6)
    state_interfaces: tuple[str, ...] = (POSITION, VELOCITY)
    max_effort_interface: str = ""
    max_velocity_interface: str = ""
    max_velocity: float = setting(0.1, low=0.0)

    @property
    def limits(self) -> list[str]:
        """The command interfaces of the most effort and velocity that are given."""
        return [each for each in (self.max_effort_interface, self.max_velocity_interface) if each]

    def mistake(self) -> str | None:
        """Say what cannot be, None if nothing is wrong."""
        if not self.joint:
            return "no 'joint'; give it under ros__parameters: joint: finger_joint"
        if missing := [each for each in (POSITION, VELOCITY) if each not in self.state_interfaces]:
            return f"state_interfaces lacks {missing[0]}; a goal is judged by position and velocity"
        if len(set(self.state_interfaces)) != len(self.state_interfaces) or len(set(self.limits)) != len(self.limits):
            return "state_interfaces, or the interfaces of the limits, name one twice; name each once"
        return None


@dataclass(frozen=True)
class ParallelGripperParams(GripperParams):
    """Parameters of parallel_gripper_action_controller/GripperActionController."""

    max_effort: float = setting(10.0, low=0.0)


@dataclass(frozen=True)
class EffortGripperParams(GripperParams):
    """Parameters of effort_controllers/GripperActionController; `gains` are those of the loop over the position."""

    gains: LoopGains = derived(LoopGains())  # noqa: RUF009 - it is frozen


def read_params(params: Params, name: str, cls: type[P]) -> P:
    """Return the parameters of controller `name`; raise RobotConfigError with what is wrong in them."""
    node = params.flat.get("joint")
    joint = "" if node is None else node.text
    found = params.read(_with_gains(cls, joint))
    if isinstance(found, EffortGripperParams):
        found = dataclasses.replace(found, gains=getattr(found, "loop"))  # noqa: B009 - of the class that is made
    if (mistake := found.mistake()) is not None:
        raise RobotConfigError(f"{name}: {mistake}")
    return found


def _with_gains(cls: type[P], joint: str) -> type[P]:
    """Return the class of the parameters with the gains of the joint, which have its name in their keys."""
    if not issubclass(cls, EffortGripperParams):
        return cls
    loop = ("loop", LoopGains, setting(LoopGains(), key=f"gains.{joint}", section=True))
    return cast("type[P]", dataclasses.make_dataclass(cls.__name__, [loop], bases=(cls,), frozen=True))
