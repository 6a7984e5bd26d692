"""ros2_canopen controllers that offer the services of one CANopen node or drive.

Rules (canopen_ros2_controllers): the parameter is `joint`; topics and services have the controller's name. Upstream
passes each request through interfaces that a hardware component polls in its cycle. Here the controllers claim no
interfaces: they offer the services that every node of the bus has, with the same answers and safety checks. So they
are started beside the controller that moves the joint, and work whether they are active or not.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar

from canopen_control.controllers.base import Controller
from canopen_control.controllers.params import CommonParams
from canopen_control.errors import RobotConfigError
from canopen_control.rpc.messages.state import DRIVE_SERVICES, NODE_SERVICES
from canopen_control.yamlfile.convert import setting

if TYPE_CHECKING:
    from canopen_control.controllers.params import Params


@dataclass(frozen=True)
class DeviceParams(CommonParams):
    """Parameters of the CANopen device controllers; `joint` may also be the name of a node without joints."""

    joint: str = setting("", help="a joint driven by a node, or the name of a node without joints")


class CanopenProxyController(Controller):
    """Controller that offers the services of one node: NMT commands, SDO access and PDOs."""

    title: ClassVar[str] = "One node, with the interfaces of ros2_canopen"
    reads: ClassVar[type[DeviceParams]] = DeviceParams
    moves_joints: ClassVar[bool] = False
    offers: ClassVar[tuple[str, ...]] = (NODE_SERVICES,)

    def on_configure(self, params: Params) -> None:
        settings = params.read(DeviceParams)
        if not settings.joint:
            raise RobotConfigError(f"{self.name}: no 'joint'; give it under {self.name}: ros__parameters: joint: NAME")
        self.joints, self.update_rate = (settings.joint,), settings.update_rate


class Cia402DeviceController(CanopenProxyController):
    """Controller that offers the services of one drive: the services of a node, and CiA 402 states and modes."""

    offers: ClassVar[tuple[str, ...]] = (DRIVE_SERVICES,)
