"""`/NODE/*` services of each drive, as ros2_canopen's Cia402Driver has them, and `home` and `quick_stop`.

The law of the file: a Trigger that was done answers success with an empty message, as ros2_canopen does; one that was
refused says why. No service waits for another one: each request is on its way to the robot at once, so that `halt`,
`disable` and `quick_stop` are never behind an `init` or `home` that takes its time. `recover` resets a fault and does
not enable: nothing moves without an enable. `target` goes through the controller that commands the drive, with its
limits and its timeout; a drive that no controller commands has none. A node with several axes has the services of each
below its channel; those of the node itself mean all its axes, and it has no `target`.
"""

from __future__ import annotations

import math
import time
from typing import TYPE_CHECKING, Any, Final

from canopen_control.ros.endpoint import Endpoint
from canopen_control.ros.interfaces import interface
from canopen_control.ros.sdo import NodeSdo, master_handlers

if TYPE_CHECKING:
    from canopen_control.ros.conversions import ControllerView
    from canopen_control.ros.endpoint import Ros
    from canopen_control.ros.nodes import Channel, NodeView
    from canopen_control.ros.service import Handler, Reply, RosMessage

__all__ = ["DriveServices", "MasterServices", "Targets"]

#: service -> (method of the API, its parameters beside the node)
TRIGGERS: Final[dict[str, tuple[str, dict[str, Any]]]] = {
    "nmt_reset_node": ("nmt", {"command": "reset-node"}),
    "nmt_start_node": ("nmt", {"command": "start"}),
    "init": ("axis", {"action": "enable"}),
    "enable": ("axis", {"action": "enable"}),
    "disable": ("axis", {"action": "disable"}),
    "halt": ("axis", {"action": "halt"}),
    "quick_stop": ("axis", {"action": "quick-stop"}),
    "recover": ("axis", {"action": "fault-reset"}),
    "home": ("axis", {"action": "home"}),
    "position_mode": ("axis", {"action": "mode", "mode": "PP"}),
    "velocity_mode": ("axis", {"action": "mode", "mode": "PV"}),
    "torque_mode": ("axis", {"action": "mode", "mode": "TQ"}),
    "cyclic_position_mode": ("axis", {"action": "mode", "mode": "CSP"}),
    "cyclic_velocity_mode": ("axis", {"action": "mode", "mode": "CSV"}),
    "cyclic_torque_mode": ("axis", {"action": "mode", "mode": "CST"}),
    "interpolated_position_mode": ("axis", {"action": "mode", "mode": "IP"}),
}
_RECENT_S: Final = 0.5  # a target is older than this in the state stream as well


class Targets:
    """What the drives of one controller were told through `target`; shared by all drives of a robot."""

    def __init__(self) -> None:
        self._told: dict[tuple[str, str], tuple[float, float]] = {}

    def command(
        self, controller: ControllerView, joint: str, target: float, joints: dict[str, dict[str, Any]]
    ) -> list[float]:
        """Return the command that gives one joint a target, and leaves the others what they have."""
        now = time.monotonic()
        self._told[controller.name, joint] = (now, target)
        return [self._value(controller, name, joints.get(name) or {}, now) for name in controller.joints]

    def _value(self, controller: ControllerView, joint: str, state: dict[str, Any], now: float) -> float:
        at, target = self._told.get((controller.name, joint), (-math.inf, 0.0))
        return target if now - at < _RECENT_S else _held(state, controller.interface)


class DriveServices(Endpoint):
    """The services of one node."""

    def __init__(self, ros: Ros, node: NodeView, targets: Targets) -> None:
        self._ros, self._node, self._targets = ros, node, targets
        self._state: dict[str, Any] = {}
        trigger = interface("std_srvs/srv/Trigger")
        self._services = [ros.serve(trigger, node.path(name), self._trigger(*told)) for name, told in TRIGGERS.items()]
        self._services += [
            ros.serve(trigger, node.path(name, channel), self._trigger(method, {**params, "joint": channel.joint}))
            for channel in node.channels
            for name, (method, params) in TRIGGERS.items()
            if method == "axis"
        ]
        self._services += [
            ros.serve(interface(kind), node.path(name), handler)
            for name, kind, handler in NodeSdo(ros, node.name).handlers()
        ]
        target = interface("canopen_interfaces/srv/COTargetDouble")
        self._services += [
            ros.serve(target, node.path("target", channel), self._target(channel))
            for channel in node.channels or (None,)
        ]

    def on_state(self, state: dict[str, Any]) -> None:
        """Know the newest sample: which joints it drives, and what they are commanded."""
        self._state = state

    def close(self) -> None:
        """Leave the graph."""
        for service in self._services:
            self._ros.unserve(service)

    def _trigger(self, method: str, params: dict[str, Any]) -> Handler:
        def handler(_request: RosMessage, response: RosMessage, reply: Reply) -> None:
            def answer(_result: object, error: str | None) -> None:
                response.success, response.message = error is None, error or ""
                reply(response)

            self._ros.ask(method, {"node": self._node.name, **params}, answer)

        return handler

    def _target(self, channel: Channel | None) -> Handler:
        def handler(request: RosMessage, response: RosMessage, reply: Reply) -> None:
            self._take_target(channel.joint if channel is not None else self._joint(), request, response, reply)

        return handler

    def _take_target(self, joint: str | None, request: RosMessage, response: RosMessage, reply: Reply) -> None:
        def answer(_result: object, error: str | None) -> None:
            if error is not None:
                self._ros.warn(f"{self._node.name}/target", f"{self._node.name}: {error}")
            response.success = error is None
            reply(response)

        controller = None if joint is None else self._controller(joint)
        if joint is None or controller is None:
            answer(None, "no active forward controller commands this drive; activate one, it is what takes a target")
        elif not math.isfinite(request.target):
            answer(None, f"the target is not finite: {request.target:g}")
        else:
            values = self._targets.command(controller, joint, request.target, self._state["joints"])
            params = {"controller": controller.name, "values": values, "source": f"ros {self._node.name}/target"}
            self._ros.ask("command", params, answer)

    def _joint(self) -> str | None:
        node = (self._state.get("nodes") or {}).get(self._node.name) or {}
        joints = [str(axis["joint"]) for axis in node.get("axes") or ()]
        return joints[0] if len(joints) == 1 else None

    def _controller(self, joint: str) -> ControllerView | None:
        """Return the one that commands this joint, and one value per joint."""
        for each in self._ros.controllers.values():
            if each.active and each.topic == "commands" and joint in each.joints and each.width == len(each.joints):
                return each
        return None


class MasterServices(Endpoint):
    """`/master/sdo_read` and `/master/sdo_write`: a node by its id."""

    def __init__(self, ros: Ros) -> None:
        self._ros = ros
        self._services = [
            ros.serve(interface(kind), f"master/{name}", handler) for name, kind, handler in master_handlers(ros)
        ]

    def close(self) -> None:
        """Leave the graph."""
        for service in self._services:
            self._ros.unserve(service)


def _held(joint: dict[str, Any], name: str | None) -> float:
    """Return what a joint goes on doing: its command, else standstill."""
    command = joint.get("command")
    if command is None and name == "position":
        command = joint.get("position")
    return 0.0 if command is None else float(command)
