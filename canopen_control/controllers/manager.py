"""Controller manager: loads, configures, switches and updates the controllers of a robot.

Rules (ros2_control jazzy): a switch is checked as a whole before anything changes. A STRICT switch is refused if any
controller cannot be switched, a best-effort switch ignores these controllers; a claimed or unavailable interface
refuses both (`switcher`). A controller whose update fails is deactivated with the controllers chained to it, and its
fallbacks take over. An error in a controller never leaves `update`.

Safer than upstream: a command to a controller is refused while its drives are not enabled, and the command of the
controller is cleared when a drive is no longer enabled, so that the first motion after every enabling follows a newer
command.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import TYPE_CHECKING, Final, Protocol

from canopen_control.controllers.base import (
    Controller,
    ControllerEvent,
    ControllerState,
    EnableStatus,
    sample_type_of,
    twist_axes_of,
)
from canopen_control.controllers.chains import joints_of
from canopen_control.controllers.command_timeout import MOVING, CommandSender
from canopen_control.controllers.declared import checked, declared_by, given_in
from canopen_control.controllers.params import Params
from canopen_control.controllers.request_protocols import (
    ClosesLoops,
    FollowsTrajectories,
    GripperGoal,
    Grips,
    HasOdometry,
    TakesNamedValues,
    takes_commands,
)
from canopen_control.controllers.switcher import Switched, Switcher
from canopen_control.controllers.types import make_controller
from canopen_control.controllers.update_loop import UpdateLoop
from canopen_control.errors import CanopenError, ControlError, NotYetEnabled, UnknownName, nearest
from canopen_control.rpc.messages.samples import kind_of
from canopen_control.rpc.messages.state import ControllerReading
from canopen_control.urdf.joint_element import POSITION

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from canopen_control.controllers.base import WheelGeometrySource
    from canopen_control.controllers.switcher import SwitchObserver
    from canopen_control.controllers.trajectory.goal import TrajectoryGoal
    from canopen_control.controllers.trajectory.point import JointTrajectory
    from canopen_control.hardware.interfaces import (
        CommandInterface,
        HardwareComponent,
        InterfaceRegistry,
    )
    from canopen_control.rpc.messages.parameters import ParameterReading, ParameterValue
    from canopen_control.urdf.joint_element import Joint

    AnyGoal = TrajectoryGoal | JointTrajectory | GripperGoal


# inside the class, `list` is the method, which has its name in ros2_control
Events = tuple[ControllerEvent, ...]
Names = list[str]
Running = tuple[Controller, ...]
Bases = dict[str, tuple[str, ...]]
Parameters = tuple["ParameterReading", ...]


_NO_TRAJECTORIES: Final = "is not a joint trajectory controller"
_AT_TARGET: Final = 1e-3  # rad or m: a smaller distance commands no motion


def _command(
    controller: Controller, values: Sequence[float] | Mapping[str, float], now: int, stamp: int | None
) -> None:
    """Pass a command to a controller; raise ControlError if it does not accept this kind of command."""
    if isinstance(values, Mapping):
        if not isinstance(controller, TakesNamedValues):
            raise controller.refusal("accepts no values by interface name; give one value for each interface, in order")
        controller.set_named(values, now)
    elif takes_commands(controller):
        controller.set_command(values, now, stamp)
    else:
        raise controller.refusal("accepts no commands; it only reads states")


def _send_goal(controller: Controller, goal: AnyGoal, now: int) -> None:
    """Pass a goal to a controller; raise ControlError if it does not accept this kind of goal."""
    if isinstance(goal, GripperGoal):
        if not isinstance(controller, Grips):
            raise controller.refusal("is not a gripper action controller")
        controller.grip(goal, now)
    elif isinstance(controller, FollowsTrajectories):
        controller.send_goal(goal, now)
    else:
        raise controller.refusal(_NO_TRAJECTORIES)


class CommandLimiter(Protocol):
    """Limiter of all commands of a cycle, such as `CommandLimits` or the speed limit of a preflight check."""

    def enforce(self, period: float) -> str | None:
        """Limit all commands; return a report of newly limited commands, or None. `period` is in s."""


class ControllerManager:
    """Controller manager of one robot; `update_rate` is in Hz.

    - `cycle`: period of the cycle in s if it is not that of `update_rate`.
    - `joints`, `geometry`, `description`: the movable joints of the description, its wheel dimensions, all its joints.
    - `enable_status`: enable status of the drives; `limiter`: limiter of all commands, which may be set at any time.
    - `running`: the active controllers; `new_events`: the events that `events` returns next.
    """

    def __init__(
        self,
        registry: InterfaceRegistry,
        update_rate: int = 100,
        *,
        cycle: float | None = None,
        joints: Sequence[str] | None = None,
        geometry: WheelGeometrySource | None = None,
        description: Mapping[str, Joint] | None = None,
        enable_status: EnableStatus | None = None,
    ) -> None:
        if update_rate <= 0:
            raise ControlError(f"controller_manager: update_rate is {update_rate}; give a rate in Hz above 0")
        self.registry, self.update_rate = registry, update_rate
        self._joints = None if joints is None else tuple(joints)
        self._geometry = geometry
        self._description = description or {}
        self.limiter: CommandLimiter | None = None
        self.enable_status = enable_status or EnableStatus()
        self._reported_refusals: set[str] = set()
        self.immobile: dict[str, str] = {}
        """By controller, why its limits permitted none of the motions of its commands; "" if they permitted one."""
        self._reported_idle: dict[str, set[str]] = {}  # by controller: joints that do not follow
        self._controllers: dict[str, Controller] = {}
        self._params: dict[str, Params] = {}
        self._fallbacks: dict[str, tuple[str, ...]] = {}
        self._node_options: dict[str, tuple[str, ...]] = {}
        self.new_events: list[ControllerEvent] = []
        self.running = UpdateLoop(update_rate, cycle or 1.0 / update_rate, self.new_events, self.enable_status)
        self._switcher = Switcher(registry, self._controllers, self.running, self.new_events)

    # ------------------------------------------------------------------------------------------------- lifecycle

    def load(
        self,
        name: str,
        type_name: str,
        params: Params | None = None,
        fallbacks: Sequence[str] = (),
        node_options: Sequence[str] = (),
    ) -> Controller:
        """Create an unconfigured controller; raise ControlError for an unknown type or a name in use.

        `params` are stored for `configure`. `fallbacks` are the controllers that are activated when the update of this
        controller fails; they must be configured by then. `node_options` are the arguments of its ROS node.
        """
        if name in self._controllers:
            raise ControlError(f"controller {name} is already loaded; unload it first")
        controller = make_controller(name, type_name)
        controller.description_joints, controller.geometry = self._joints, self._geometry
        controller.description, controller.cycle_rate = self._description, self.update_rate
        controller.enable_status = self.enable_status
        self.new_events += controller.notices
        controller.notices = self.new_events
        self._fallbacks[name], self._node_options[name] = tuple(fallbacks), tuple(node_options)
        self._controllers[name] = controller
        self._params[name] = params or Params.of({}, name)
        return controller

    def configure(self, name: str, params: Params | None = None) -> None:
        """Configure a controller that is not active, with new or stored parameters.

        Raise ControlError for an active controller, and ConfigError for invalid parameters, which leave it
        UNCONFIGURED.
        """
        controller = self.get(name)
        if controller.state is ControllerState.ACTIVE:
            raise ControlError(f"controller {name} is active; deactivate it before configuring it")
        self._withdraw(controller)
        controller.state = ControllerState.UNCONFIGURED
        self._params[name] = applied = params or self._params[name]
        previous = set(applied.warnings)
        controller.on_configure(applied)
        for text in applied.warnings:
            if text not in previous:
                self._report("parameter", name, text)
        if controller.update_rate > self.update_rate:
            rates = f"{controller.update_rate} Hz exceeds the {self.update_rate} Hz of the controller_manager"
            self._report("update_rate", name, f"{name}: update_rate {rates}; it runs at {self.update_rate} Hz")
        self.registry.export(controller.reference_interfaces(), name, controller.exported_states())
        controller.state = ControllerState.INACTIVE

    def unload(self, name: str) -> None:
        """Remove a controller; raise ControlError if it is active."""
        controller = self.get(name)
        if controller.state is ControllerState.ACTIVE:
            raise ControlError(f"controller {name} is active; deactivate it before unloading it")
        self._withdraw(controller)
        controller.state = ControllerState.FINALIZED
        del self._controllers[name], self._params[name]
        self._fallbacks.pop(name, None)
        self._node_options.pop(name, None)

    def get(self, name: str) -> Controller:
        """Return a loaded controller; raise UnknownName, with the nearest name, if it is not loaded."""
        controller = self._controllers.get(name)
        if controller is None:
            raise UnknownName(f"no controller {name!r} is loaded{nearest(name, self._controllers)}")
        return controller

    def follower(self, name: str) -> FollowsTrajectories:
        """Return a trajectory controller by name; raise ControlError if it has another type."""
        controller = self.get(name)
        if not isinstance(controller, FollowsTrajectories):
            raise ControlError(f"{name} {_NO_TRAJECTORIES}")
        return controller

    def base(self, name: str) -> HasOdometry:
        """Return a controller with odometry by name; raise ControlError if it has another type."""
        controller = self.get(name)
        if not isinstance(controller, HasOdometry):
            raise ControlError(f"{name} has no odometry; it is not a base controller")
        return controller

    def loops(self, name: str, action: str) -> ClosesLoops:
        """Return a PID controller by name; for another type raise ControlError, with `action` in its text."""
        controller = self.get(name)
        if not isinstance(controller, ClosesLoops):
            raise ControlError(f"{name} {action}; it is not a PID controller")
        return controller

    def observe(self, observer: SwitchObserver) -> None:
        """Set the observer of activations and deactivations."""
        self._switcher.observer = observer

    def list(self) -> list[ControllerReading]:
        """Return descriptions of all loaded controllers, in the order of loading."""
        return [self._info(controller) for controller in self._controllers.values()]

    @property
    def states(self) -> dict[str, str]:
        """Lifecycle states of all controllers by name, in the order of loading."""
        return {name: controller.state.value for name, controller in self._controllers.items()}

    @property
    def active(self) -> tuple[str, ...]:
        """Names of the active controllers, in the order of their updates."""
        return tuple(controller.name for controller in self.running.controllers)

    @property
    def bases(self) -> Bases:
        """Joints that each active base controller moves, by controller name."""
        running = self.running.controllers
        return {controller.name: tuple(joints_of(controller, running)) for controller in running if controller.is_base}

    def events(self) -> Events:
        """Return the events since the last call, in chronological order."""
        if not self.new_events:
            return ()
        events = tuple(self.new_events)
        self.new_events.clear()
        return events

    # -------------------------------------------------------------------------------------------------- parameters

    def parameters(self, name: str) -> Parameters:
        """Return the parameters of a controller; before it is configured, those given in its file."""
        controller, params = self.get(name), self._params[name]
        if params.source is None:
            return given_in(params)
        return declared_by(params.source, controller.settable, update_rate=controller.update_rate or self.update_rate)

    def set_parameters(self, name: str, parameters: Sequence[ParameterValue]) -> None:
        """Set parameters of a configured controller; if one is invalid, set none and raise ControlError or ConfigError.

        The values apply until the controller is unloaded, even if it is configured again.
        """
        controller = self.get(name)
        values = checked(name, self.parameters(name), parameters)
        changed = self._params[name].changed(values)
        controller.on_set(changed)
        self._params[name] = changed
        self._report(
            "parameter_set", name, f"{name}: " + ", ".join(f"{key} is {value}" for key, value in values.items())
        )

    # --------------------------------------------------------------------------------------------------- switching

    def switch(
        self,
        activate: Sequence[str] = (),
        deactivate: Sequence[str] = (),
        strict: bool = True,
        now: int | None = None,
    ) -> Switched:
        """Deactivate and activate controllers in one step between two cycles; `now` (ns) defaults to the last cycle.

        A refused request raises ControlError (InterfaceConflict, UnknownInterface) or DriveError and changes nothing.
        If a controller fails to start, all controllers of the request are deactivated, and the ControlError contains
        the reason.
        """
        return self._switcher.switch(activate, deactivate, self.running.now if now is None else now, strict=strict)

    def leave_out(self, names: Sequence[str]) -> None:
        """Report unknown controller names that a best-effort switch ignored."""
        self._report(
            "left_out",
            "",
            f"the switch ignores unknown controllers: {', '.join(names)}; see canopen-control controller list",
        )

    def deactivate_using(self, component: HardwareComponent, reason: str, now: int | None = None) -> Names:
        """Deactivate the controllers that use a failed component, and those chained to them; return their names.

        Broadcasters continue with the states of the other components.
        """
        owned = {interface.owner for interface in component.command_interfaces if interface.owner is not None}
        using = [self._controllers[name] for name in owned if name in self._controllers]
        return self._switcher.drop(using, reason, self.running.now if now is None else now)

    # ------------------------------------------------------------------------------------------------- every cycle

    def update(self, now: int, period: float) -> None:
        """Update the controllers that are due, in the order of their chains, and limit their commands.

        `now` is in ns, `period` is that of the cycle in s. The broadcasters are updated by `broadcast`.
        """
        elapsed = self.running.update(now, period)
        if self.running.failed:
            self._drop_failed(now)
        if elapsed >= 0.0 and self.limiter is not None and (limited := self.limiter.enforce(elapsed)) is not None:
            self._report("limited", "", f"enforce_command_limits: {limited}")

    def broadcast(self, now: int, period: float) -> None:
        """Update the broadcasters that are due, after the commands of the cycle were sent."""
        self.running.broadcast(now, period)
        if self.running.failed:
            self._drop_failed(now)

    def command(
        self,
        name: str,
        values: Sequence[float] | Mapping[str, float],
        now: int,
        stamp: int | None = None,
        *,
        source: str = "",
        holder: object = None,
        sender: CommandSender | None = None,
    ) -> dict[str, str]:
        """Pass a command to a controller; raise ControlError if it is refused, NotEnabled if drives are not enabled.

        `values` are all values, or some by interface names; times are in ns. `source` names the sender; the command
        ends with the connection `holder`, unless it commands standstill. A refusal is reported once, until a command is
        accepted. Return the joints that do not follow an accepted command, with the reason and the remedy. `sender`
        is the source with its identity, by default the source alone.
        """
        controller = self.get(name)
        self._pass(controller, lambda: _command(controller, values, now, stamp), source)
        numbers = list(values.values()) if isinstance(values, Mapping) else values
        self._accepted(controller, source, None if controller.is_standstill(numbers) else holder, sender, now)
        return self._idle(controller, numbers)

    def send_goal(
        self,
        name: str,
        goal: AnyGoal,
        now: int,
        *,
        source: str = "",
        holder: object = None,
        sender: CommandSender | None = None,
    ) -> None:
        """Pass a trajectory or a gripper goal to a controller, as `command` does.

        The goal is aborted when the connection `holder` ends.
        """
        controller = self.get(name)
        self._pass(controller, lambda: _send_goal(controller, goal, now), source)
        self._accepted(controller, source, holder, sender, now)

    def _accepted(
        self, controller: Controller, source: str, holder: object, sender: CommandSender | None, now: int
    ) -> None:
        """Record the sender of an accepted command, and report two senders that have started to alternate."""
        timeout = controller.command_timeout
        timeout.source, timeout.holder = source, holder
        if (both := timeout.senders.take(sender or CommandSender(source, source), now)) is not None:
            text = (
                f"{controller.name}: {' and '.join(both)} command it alternately, so its motion jerks; each newer "
                "command applies; end one of the two"
            )
            self._report("two_senders", controller.name, text)

    def _idle(self, controller: Controller, values: Sequence[float]) -> dict[str, str]:
        """Return, by joint, why it does not follow a command that requires its motion; report each new joint once."""
        name, entry = controller.name, self.running.entry_of(controller)
        disabled = [] if entry is None else entry.disabled
        reason = controller.why_immobile(values)
        if any(values):
            self.immobile[name] = "" if reason is None else self.immobile.get(name, reason)
        if reason is not None:
            return self._report_idle(name, {command.joint: reason for command in controller.commands})
        if not disabled:
            self._reported_idle.pop(name, None)
            return {}
        if len(values) == len(controller.commands):  # each interface has its own value
            pairs = zip(controller.commands, values, strict=True)
            still = {command.name for command, value in pairs if not self._requires_motion(command, value)}
            disabled = [command for command in disabled if command.name not in still]
        return self._report_idle(name, self.enable_status.idle(disabled))

    def _report_idle(self, name: str, reasons: dict[str, str]) -> dict[str, str]:
        reported = self._reported_idle.setdefault(name, set())
        if not reported.issuperset(reasons):
            reported.update(reasons)
            named = "; ".join(f"{joint} does not follow: {reason}" for joint, reason in reasons.items())
            self._report("not_followed", name, f"{name}: {named} (reported once)")
        return reasons

    def _requires_motion(self, command: CommandInterface, value: float) -> bool:
        """Whether a value commands a motion; a position does not if the joint is already there."""
        if command.quantity in MOVING:
            return value != 0.0
        if command.quantity != POSITION:
            return True
        known = {state.name: state.value for state in self.registry.state_interfaces}
        return not abs(known.get(f"{command.joint}/{POSITION}", math.nan) - value) < _AT_TARGET

    def _pass(self, controller: Controller, command: Callable[[], None], source: str) -> None:
        """Call `command` if the drives of the controller are enabled; report the first refusal, and raise every one."""
        name = controller.name
        try:
            self._require_enabled(controller)
            command()
        except ControlError as error:
            self.report_refusal(name, error, source)
            raise
        self._reported_refusals.discard(name)

    def report_refusal(self, name: str, error: ControlError, source: str) -> None:
        """Report a refused command if it is the first since the last accepted one; ignore NotYetEnabled."""
        if name not in self._reported_refusals and not isinstance(error, NotYetEnabled):
            self._reported_refusals.add(name)
            self._report("refused", name, f"{error} (from {source or 'not named'}; reported once)")

    def _require_enabled(self, controller: Controller) -> None:
        """Raise NotEnabled, and count a refusal, if no interface group of the controller is fully enabled."""
        entry = self.running.entry_of(controller)
        if entry is not None and not entry.follows:
            controller.rejected += 1
            raise self.enable_status.error(entry.disabled)

    # ----------------------------------------------------------------------------------------------------- internal

    def _drop_failed(self, now: int) -> None:
        failed, self.running.failed = self.running.failed, []
        for controller, reason in failed:
            again = f"canopen-control controller switch --activate {controller.name}"
            dropped = self._switcher.drop([controller], f"{reason}; after the repair, restart it: {again}", now)
            fallbacks = dict.fromkeys(name for controller in dropped for name in self._fallbacks.get(controller, ()))
            if fallbacks:
                self._fall_back(list(fallbacks), controller.name, now)

    def _fall_back(self, names: Sequence[str], failed: str, now: int) -> None:
        """Activate the fallback controllers of a failed controller, and report the outcome."""
        fallbacks = [name for name in names if name not in self.active]
        try:
            self.switch(fallbacks, now=now)
        except CanopenError as error:
            self._report("error", failed, f"{failed}: its fallbacks cannot take over: {error}")
        else:
            self._report("fallback", failed, f"{', '.join(names)} took over from {failed}")

    def _withdraw(self, controller: Controller) -> None:
        self.registry.withdraw(controller.reference_interfaces(), controller.exported_states())

    def _info(self, controller: Controller) -> ControllerReading:
        configured = controller.state is not ControllerState.UNCONFIGURED
        rate = min(controller.update_rate or self.update_rate, self.update_rate)
        sample_type = sample_type_of(controller)
        return ControllerReading(
            name=controller.name,
            type=controller.type,
            state=controller.state.value,
            joints=controller.joints,
            interface=controller.interface,
            claims=tuple(command.name for command in controller.commands),
            required_command_interfaces=tuple(controller.command_interface_names()) if configured else (),
            required_state_interfaces=tuple(controller.state_interface_names()) if configured else (),
            reference_interfaces=tuple(interface.name for interface in controller.reference_interfaces())
            if configured
            else (),
            exported_state_interfaces=tuple(state.name for state in controller.exported_states()) if configured else (),
            topic=controller.topic,
            twist_axes=twist_axes_of(controller),
            publishes=controller.publishes,
            frame_id=controller.frame_id,
            tells=None if sample_type is None else kind_of(sample_type),
            offers=controller.offers,
            is_broadcaster=controller.is_broadcaster,
            rejected=controller.rejected,
            update_rate=rate,
            node_options=self._node_options.get(controller.name, ()),
            publish_rate=0.0 if sample_type is None else min(controller.publish_rate or rate, rate),
        )

    def _report(self, kind: str, controller: str, text: str) -> None:
        self.new_events.append(ControllerEvent(kind, controller, text))
