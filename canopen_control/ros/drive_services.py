"""Services of each node, as in ros2_canopen's Cia402Driver for drives and ProxyDriver for other nodes.

A successful Trigger is answered with an empty message, as in ros2_canopen; the answer to a refused Trigger has the
reason. If an action applied to several drives, because a base controller claims them together, the answer names them.
No service waits for another service: each request is sent to the robot at once, so that `halt`, `disable` and
`quick_stop` are never delayed by a long `init` or `home`. `recover` resets a fault and does not enable the drive:
nothing moves without an enable. Without a fault its answer is true, as in ros2_canopen, and says that nothing was
reset. `target` is sent through the controller that commands the drive, with the controller's limits and timeout;
without such a controller, or while the drive does not follow commands, the answer is false and a warning of the bridge
has the reason.

A node with several axes has the services for each axis below its channel; the services of the node itself affect all
its axes, and do not include `target`. A node without a joint is a proxy, and has only the services for SDO and NMT.
`nmt_reset_node` boots the node again, as ros2_canopen's master does.
"""

from __future__ import annotations

import math
import time
from typing import TYPE_CHECKING, Any, Final

from canopen_control.ros.endpoint import COMMANDER, Endpoint
from canopen_control.ros.sdo_services import NodeSdo, master_handlers
from canopen_control.rpc.messages.robot import AxisDone, AxisRequest, CommandController, CommandDone, NmtRequest

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping

    from canopen_control.ros.endpoint import Handler, NodeContext, Reply, RosMessage
    from canopen_control.ros.nodes import Channel, RosNode
    from canopen_control.rpc.messages.declare import Done, Request
    from canopen_control.rpc.messages.state import ControllerReading, JointReading, StateSample

    RequestFactory = Callable[[str, str | None], AxisRequest | NmtRequest]


def _nmt(command: str, *, boot: bool = False) -> RequestFactory:
    return lambda node, _joint: NmtRequest(node=node, command=command, boot=boot)


def _axis(action: str, mode: str | None = None) -> RequestFactory:
    return lambda node, joint: AxisRequest(node=node, joint=joint, action=action, mode=mode, source=COMMANDER)


_RESET: Final = "fault-reset"
#: service -> function that makes the request to the robot from a node and the joint of an axis (None: all axes)
PROXY_TRIGGERS: Final[dict[str, RequestFactory]] = {
    "nmt_reset_node": _nmt("reset-node", boot=True),
    "nmt_start_node": _nmt("start"),
}
#: the same for drives
TRIGGERS: Final[dict[str, RequestFactory]] = {
    **PROXY_TRIGGERS,
    "init": _axis("enable"),
    "enable": _axis("enable"),
    "disable": _axis("disable"),
    "halt": _axis("halt"),
    "quick_stop": _axis("quick-stop"),
    "recover": _axis(_RESET),
    "home": _axis("home"),
    "position_mode": _axis("mode", "PP"),
    "velocity_mode": _axis("mode", "PV"),
    "torque_mode": _axis("mode", "TQ"),
    "cyclic_position_mode": _axis("mode", "CSP"),
    "cyclic_velocity_mode": _axis("mode", "CSV"),
    "cyclic_torque_mode": _axis("mode", "CST"),
    "interpolated_position_mode": _axis("mode", "IP"),
}
_TOPICS: Final = ("commands", "target")
_RECENT_S: Final = 0.5  # a target older than this has reached the state stream


class DriveTargets:
    """Targets received by the `target` services, which the state stream may not contain yet."""

    def __init__(self) -> None:
        self._last_targets: dict[tuple[str, str], tuple[float, float]] = {}

    def command(
        self, controller: ControllerReading, joint: str, target: float, joints: Mapping[str, JointReading]
    ) -> list[float]:
        """Return a controller's command with a new target for `joint` and the current commands of the other joints."""
        now = time.monotonic()
        self._last_targets[controller.name, joint] = (now, target)
        return [self._value(controller, name, joints.get(name), now) for name in controller.joints]

    def _value(self, controller: ControllerReading, joint: str, state: JointReading | None, now: float) -> float:
        at, target = self._last_targets.get((controller.name, joint), (-math.inf, 0.0))
        return target if now - at < _RECENT_S else _held(state, controller.interface)


class DriveServices(Endpoint):
    """Services of one node; if `joint` is given, the services of a drive act only on the axis of this joint."""

    def __init__(self, ros: NodeContext, node: RosNode, targets: DriveTargets, joint: str | None = None) -> None:
        super().__init__(ros)
        self._node, self._targets, self._own = node, targets, joint
        self._state: StateSample | None = None
        trigger = "std_srvs/srv/Trigger"
        for name, make_request in (TRIGGERS if node.joints else PROXY_TRIGGERS).items():
            self.serve(trigger, node.path(name), self._trigger(make_request(node.name, joint)))
        for channel in node.channels:
            for name, make_request in TRIGGERS.items():
                request = make_request(node.name, channel.joint)
                if isinstance(request, AxisRequest):
                    self.serve(trigger, node.path(name, channel), self._trigger(request))
        for name, kind, handler in NodeSdo(ros, node.name).handlers():
            self.serve(kind, node.path(name), handler)
        for aimed in node.channels or ((None,) if node.joints else ()):
            self.serve("canopen_interfaces/srv/COTargetDouble", node.path("target", aimed), self._target(aimed))

    def on_state(self, state: StateSample) -> None:
        self._state = state

    def _trigger(self, request: Request[Any]) -> Handler:
        def handler(_request: RosMessage, response: RosMessage, reply: Reply) -> None:
            def answer(result: AxisDone | Done | None, error: str | None) -> None:
                text = result.text if isinstance(result, AxisDone) else ""
                response.success, response.message = error is None or self._resets_nothing(request), error or text
                reply(response)

            self._ros.ask(request, answer)

        return handler

    def _resets_nothing(self, request: Request[Any]) -> bool:
        """Whether a request is a fault reset of drives whose states are known, and none has a fault."""
        if not isinstance(request, AxisRequest) or request.action != _RESET:
            return False
        node = None if self._state is None else self._state.nodes.get(self._node.name)
        axes = [] if node is None else [axis for axis in node.axes if request.joint in (None, axis.joint)]
        return bool(axes) and not any(axis.state is None or axis.in_fault for axis in axes)

    def _target(self, channel: Channel | None) -> Handler:
        def handler(request: RosMessage, response: RosMessage, reply: Reply) -> None:
            self._take_target(channel.joint if channel is not None else self._joint(), request, response, reply)

        return handler

    def _take_target(self, joint: str | None, request: RosMessage, response: RosMessage, reply: Reply) -> None:
        def answer(result: CommandDone | None, error: str | None) -> None:
            if result is not None and joint in result.idle:  # other joints of the controller follow
                error = f"{joint} does not follow: {result.idle[joint]}"
            if error is not None:
                self._ros.warn(f"{self._node.name}/target", f"{self._node.name}: {error}")
            response.success = error is None
            reply(response)

        controller = None if joint is None else self._controller(joint)
        if joint is None or controller is None:
            answer(None, "targets are sent through a forward command controller; activate one that commands this drive")
        elif not math.isfinite(request.target):
            answer(None, f"the target is {request.target:g}; give a finite number")
        else:
            joints = {} if self._state is None else self._state.joints
            values = self._targets.command(controller, joint, request.target, joints)
            source = f"ros {self._node.name}/target"
            command = CommandController(controller=controller.name, values=values, source=source, dead_man=True)
            self._ros.ask(command, answer)

    def _joint(self) -> str | None:
        if self._own is not None:
            return self._own
        node = None if self._state is None else self._state.nodes.get(self._node.name)
        return node.axes[0].joint if node is not None and len(node.axes) == 1 else None

    def _controller(self, joint: str) -> ControllerReading | None:
        """Return the active controller that takes one value per joint and commands `joint`, or None."""
        for controller in self._ros.controllers.values():
            if (
                controller.active
                and controller.topic in _TOPICS
                and joint in controller.joints
                and controller.width == len(controller.joints)
            ):
                return controller
        return None


class MasterServices(Endpoint):
    """Services `/master/sdo_read` and `/master/sdo_write`, which access a node by its node-ID."""

    def __init__(self, ros: NodeContext) -> None:
        super().__init__(ros)
        for name, kind, handler in master_handlers(ros):
            self.serve(kind, f"master/{name}", handler)


def _held(joint: JointReading | None, name: str | None) -> float:
    """Return a joint's current command; without one, the position for a position interface, else 0."""
    if joint is None:
        return 0.0
    command = joint.position if joint.command is None and name == "position" else joint.command
    return 0.0 if command is None else command
