"""API server of a running robot: serves the methods of `rpc/messages/robot.py` and pushes data to subscribers."""

from __future__ import annotations

import os
from typing import TYPE_CHECKING, Any, Final, Protocol, TypeVar, get_args

from canopen_control.controllers.base import twist_axes_of
from canopen_control.controllers.command_timeout import CommandSender
from canopen_control.controllers.declared import checked, declared_by
from canopen_control.controllers.spawned_controllers import SpawnedControllers
from canopen_control.controllers.types import TYPES
from canopen_control.errors import ControlError, LocalProtocolError, UnknownName
from canopen_control.hardware.axis_statechart import Action
from canopen_control.hardware.interfaces import LifecycleState
from canopen_control.host.lineserver import MAX_KEPT
from canopen_control.host.sockets import socket_path
from canopen_control.master.event_log import Event, Level
from canopen_control.rpc.messages import robot as messages
from canopen_control.rpc.messages.declare import PROTOCOL, Done
from canopen_control.rpc.messages.drive import AddPayload, BlockJoint, PushRobot, WorldAct
from canopen_control.rpc.messages.parameters import MANAGER, GetParameters, ParameterReading, SetParameters, plain_value
from canopen_control.rpc.messages.robot import (
    ROBOT,
    AxisDone,
    ComponentState,
    HardwareReading,
    InterfaceReading,
    RobotHello,
    TouchProbe,
)
from canopen_control.rpc.messages.simulation import (
    GetLaserScans,
    GetSimulation,
    PauseSimulation,
    ResetSimulation,
    Simulation,
    StepSimulation,
)
from canopen_control.rpc.messages.state import ControllerReading
from canopen_control.rpc.server import Server
from canopen_control.runtime.api_objects import ObjectMethods, ProcessDataFeed
from canopen_control.runtime.api_trajectories import GoalMethods
from canopen_control.runtime.node_readings import event_message
from canopen_control.runtime.observer import RobotObserver
from canopen_control.runtime.startup_controllers import UNLOADED, configure_controller, load_controller
from canopen_control.runtime.status import (
    layout_message,
    nodes_message,
    simulated_seconds,
    state_sample,
    status_message,
)
from canopen_control.version import __version__

if TYPE_CHECKING:
    import socket
    from collections.abc import Iterator, Mapping, Sequence

    from canopen_control.hardware.interfaces import HardwareComponent
    from canopen_control.host.lineserver import Connection
    from canopen_control.rpc.messages.robot import RobotPush
    from canopen_control.rpc.server import Call
    from canopen_control.rpc.wire import Raw
    from canopen_control.runtime.core import RobotCore
    from canopen_control.runtime.robot_clock import RobotClock


# API methods about controllers and hardware components, equivalent to the services of ros2_control.


_RESTING: Final = ("inactive", "unconfigured")
_COMMUNICATING: Final = (LifecycleState.INACTIVE, LifecycleState.ACTIVE)


def answer_control(robot: RobotCore, server: Server[RobotHello, RobotPush]) -> None:
    """Register the API methods for controllers and hardware components on a server."""
    register = server.register
    register(messages.ListControllers, lambda call: call.reply(_controllers(robot, unloaded=call.request.all)))
    register(messages.ListControllerTypes, lambda call: call.reply(sorted(TYPES)))
    register(messages.LoadController, lambda call: _load(robot, call))
    register(messages.ConfigureController, lambda call: _configure(robot, call))
    register(messages.CleanupController, lambda call: _unload(robot, call))  # there is no cleaned-up state
    register(messages.UnloadController, lambda call: _unload(robot, call))
    register(messages.SwitchControllers, lambda call: _switch(robot, call))
    register(messages.SetMeasuredStates, lambda call: _set_measured_states(robot, call))
    register(
        messages.ListHardware,
        lambda call: call.reply([_component(robot, component) for component in robot.registry.components]),
    )
    register(messages.SetHardwareState, lambda call: _set_hardware_state(robot, call))


def _controllers(robot: RobotCore, *, unloaded: bool) -> tuple[ControllerReading, ...]:
    controllers = robot.manager.list()
    if unloaded:
        loaded = robot.manager.states
        controllers += [
            ControllerReading(name=name, type=config.type, state=UNLOADED)
            for name, config in robot.setup.controllers.controllers.items()
            if name not in loaded
        ]
    return tuple(controllers)


def _load(robot: RobotCore, call: Call[messages.LoadController]) -> None:
    load_controller(robot.setup, robot.manager, call.request.controller, configure=call.request.configure)
    call.reply(Done())


def _configure(robot: RobotCore, call: Call[messages.ConfigureController]) -> None:
    configure_controller(robot.setup, robot.manager, call.request.controller)
    call.reply(Done())


def _unload(robot: RobotCore, call: Call[messages.UnloadController] | Call[messages.CleanupController]) -> None:
    robot.manager.unload(call.request.controller)
    call.reply(Done())


def _switch(robot: RobotCore, call: Call[messages.SwitchControllers]) -> None:
    request = call.request
    robot.switch(request.activate, request.deactivate, strict=request.strict)
    call.reply(Done())


def _set_measured_states(robot: RobotCore, call: Call[messages.SetMeasuredStates]) -> None:
    controller = robot.manager.loops(call.request.controller, "accepts no measured states")
    controller.set_measured_states(call.request.values, robot.cycle.clock.now())
    call.reply(Done())


def _component(robot: RobotCore, component: HardwareComponent) -> HardwareReading:
    """Describe a hardware component in the form of ROS 2's `list_hardware_components`.

    Command interfaces are available while the component is active, state interfaces also while it is inactive.
    """
    tags = {tag.name: tag for tag in robot.setup.description.hardware}
    tag = tags.get(component.name)
    commands, states = component.state is LifecycleState.ACTIVE, component.state in _COMMUNICATING
    return HardwareReading(
        name=component.name,
        type=tag.kind if tag is not None else "system",
        plugin=tag.plugin if tag is not None else "",
        state=component.state.value,
        rate=robot.setup.controllers.update_rate,
        command_interfaces=[
            InterfaceReading(interface.name, commands, interface.owner is not None)
            for interface in component.command_interfaces
        ],
        state_interfaces=[
            InterfaceReading(state_interface.name, states) for state_interface in component.state_interfaces
        ],
    )


def _set_hardware_state(robot: RobotCore, call: Call[messages.SetHardwareState]) -> None:
    """Activate, deactivate or clean up a hardware component; controllers that use it are deactivated."""
    name, state = call.request.component, call.request.state
    component = next((component for component in robot.registry.components if component.name == name), None)
    if component is None:
        names = ", ".join(component.name for component in robot.registry.components)
        raise UnknownName(f"no hardware component {name!r}; available: {names}")
    if state == "active":
        component.configure()
        component.activate()
    elif state in _RESTING:
        robot.manager.deactivate_using(component, f"{name} was set {state}")
        component.deactivate()
        (component.cleanup if state == "unconfigured" else component.configure)()
    else:
        choices = f"active, {' or '.join(_RESTING)}"
        raise ControlError(f"a running robot cannot set hardware component {name} to {state!r}; choose {choices}")
    call.reply(ComponentState(component.state.value))


# Parameters of controllers and of the controller manager, with the names and types of ROS 2.


class ParameterMethods:
    """API methods that get and set parameters of controllers and of the controller manager."""

    def __init__(self, robot: RobotCore, server: Server[RobotHello, RobotPush]) -> None:
        self._robot, self._spawned = robot, SpawnedControllers(robot.setup.controllers)
        server.register(GetParameters, self._get)
        server.register(SetParameters, self._set)

    def _get(self, call: Call[GetParameters]) -> None:
        name = call.request.controller
        call.reply(self._of_manager() if name == MANAGER else self._robot.manager.parameters(name))

    def _set(self, call: Call[SetParameters]) -> None:
        name, values = call.request.controller, call.request.values
        if name != MANAGER:
            self._robot.manager.set_parameters(name, values)
        else:
            declared_names = {declared.name for declared in declared_by(self._robot.setup.controllers.manager)}
            foreign = [declared for declared in values if declared.name in declared_names or "." not in declared.name]
            checked(MANAGER, self._of_manager(), foreign)  # every such parameter is read-only or not declared
            self._spawned.set(values)
        call.reply(Done())

    def _of_manager(self) -> tuple[ParameterReading, ...]:
        declared = declared_by(self._robot.setup.controllers.manager)
        return tuple(sorted((*declared, *self._of_controllers()), key=lambda of_controller: of_controller.name))

    def _of_controllers(self) -> Iterator[ParameterReading]:
        """Yield the parameters that the controller manager has for each controller, such as `NAME.type`."""
        for name, config in self._robot.setup.controllers.controllers.items():
            yield ParameterReading(name=f"{name}.type", kind="string", value=config.type)
            for key, texts in (("fallback_controllers", config.fallbacks), ("node_options_args", config.node_options)):
                if texts:
                    yield ParameterReading(name=f"{name}.{key}", kind="string_array", value=plain_value(texts))
        for name, arguments in self._spawned.arguments.items():
            if arguments.params_file:
                value = plain_value(arguments.params_file)
                yield ParameterReading(name=f"{name}.params_file", kind="string_array", value=value)


# Only a simulated robot without buses can be paused, since drives have their own time. Resuming clears all commands,
# and a reset restarts the active controllers, so that only later commands move the robot.


_HEAVIEST: Final = "the heaviest link"


class SimulationMethods:
    """API methods that pause, resume, step, reset and disturb a simulation."""

    def __init__(self, robot: RobotCore, server: Server[RobotHello, RobotPush]) -> None:
        self._robot = robot
        self._stepping: Call[StepSimulation] | None = None
        server.register(GetSimulation, self._get)
        server.register(GetLaserScans, self._scan)
        server.register(PauseSimulation, self._pause)
        server.register(StepSimulation, self._step)
        server.register(ResetSimulation, self._reset)
        for kind in get_args(WorldAct):
            server.register(kind, self._act)

    def _clock(self) -> RobotClock:
        """Return the clock of the simulated robot; raise ControlError if the robot has buses or is not simulated."""
        robot = self._robot
        if robot.cycle.clock.simulated:
            return robot.cycle.clock
        on_bus = f"{robot.setup.name} has drives on a bus, which cannot be paused" if robot.buses else ""
        why = on_bus or f"{robot.setup.name} is not simulated, its joints are mocked"
        raise ControlError(f"{why}; only a simulation plugin without drives can be paused, stepped and reset")

    def _state(self) -> Simulation:
        robot, clock = self._robot, self._clock()
        seconds = simulated_seconds(robot) or 0.0
        period = robot.pacer.period_ns / 1e9
        return Simulation(seconds=seconds, paused=clock.paused, period=period, changeable=bool(self._worlds()))

    def _worlds(self) -> list[HardwareComponent]:
        return [component for component in self._robot.registry.components if component.changeable]

    def _get(self, call: Call[GetSimulation]) -> None:
        call.reply(self._state())

    def _scan(self, call: Call[GetLaserScans]) -> None:
        call.reply(tuple(scan for component in self._robot.registry.components for scan in component.scan()))

    def _pause(self, call: Call[PauseSimulation]) -> None:
        clock = self._clock()
        if call.request.paused and not clock.paused:
            clock.pause()
            self._report("paused", f"the simulation was paused by {call.client}")
        elif clock.paused and not call.request.paused:
            self._robot.manager.running.forget(clock.now(), "the simulation was paused; send the command again")
            clock.resume()
            self._report("resumed", f"the simulation was resumed by {call.client}; earlier commands were discarded")
        call.reply(self._state())

    def _step(self, call: Call[StepSimulation]) -> None:
        clock = self._clock()
        if not clock.paused:
            raise ControlError("the simulation is not paused and cannot be stepped; pause it first")
        clock.step(call.request.steps, self)  # answers the previous request first
        self._stepping = call

    def settle(self, error: str | None) -> None:
        """Answer the pending step request with the state of the simulation, or with `error`."""
        call, self._stepping = self._stepping, None
        if call is not None and error is None:
            call.reply(self._state())
        elif call is not None:
            call.refuse(ControlError(error))

    def _act(self, call: Call[Any]) -> None:
        """Apply a disturbance, such as a push, to the physics simulation; raise ControlError without physics."""
        self._clock()
        worlds = self._worlds()
        if not worlds:
            name = self._robot.setup.name
            raise ControlError(f"simple motors move {name}; for physics: pip install 'canopen-control[physics]'")
        for component in worlds:
            component.act(call.request)
        self._report("world", f"{_act_text(call.request)} (by {call.client})")
        call.reply(Done())

    def _reset(self, call: Call[ResetSimulation]) -> None:
        self._clock()
        robot, manager = self._robot, self._robot.manager
        for component in robot.registry.components:
            component.reset(call.request.keyframe)
        active = manager.active
        manager.switch(activate=active, deactivate=active)  # they restart at the present joint positions
        for name in manager.bases:
            manager.base(name).set_odometry(0.0, 0.0, 0.0)
        robot.truth.align()
        where = f"key frame {call.request.keyframe}" if call.request.keyframe else "its initial state"
        self._report("reset", f"the simulation was reset to {where} by {call.client}")
        call.reply(self._state())

    def _report(self, kind: str, text: str) -> None:
        self._robot.report(Event(self._robot.reactor.now(), kind, "", text))


def _act_text(act: WorldAct) -> str:
    """Return the event text for a disturbance of the simulation."""
    if isinstance(act, BlockJoint):
        return f"{act.joint} is {'blocked' if act.on else 'released'}"
    if isinstance(act, AddPayload):
        return f"a payload of {act.mass:g} kg is put on {act.on or _HEAVIEST}"
    if isinstance(act, PushRobot):
        return f"{act.on or _HEAVIEST} is pushed with {', '.join(f'{newtons:g}' for newtons in act.force)} N"
    return f"the floor has a friction of {act.friction:g}"


MAX_KIND, MAX_TEXT = 32, 500  # characters of a client's message
MAX_REQUEST = 1 << 16  # bytes of a request that is passed on to subscribers
_PLANAR, _SIDEWAYS = ("linear.x", "angular.z"), "linear.y"
Commands = TypeVar("Commands", messages.CommandController, messages.CommandByName, messages.TwistController)


class _Subscription:
    """Subscription of one connection; the state is sent every `every` cycles, or never if `every` is 0."""

    __slots__ = ("events", "every", "pdos", "requests")

    def __init__(self) -> None:
        self.every, self.events, self.pdos, self.requests = 0, False, False, False

    def wants_state(self, cycle: int) -> bool:
        return self.every > 0 and cycle % self.every == 0

    def is_due(self, cycle: int) -> bool:
        return self.pdos or self.wants_state(cycle)


class RequestObserver(Protocol):
    """Observer of client requests."""

    def requested(self, message: messages.RequestSeen) -> None:
        """Handle a client's request; the time in `message` is Unix time in s."""


class ApiServer(RobotObserver):
    """API server of one robot on a Unix socket, which `close` removes; `listener` is an existing socket, if any.

    `observer` receives each request that was not refused at once, except requests that only read.
    """

    def __init__(self, robot: RobotCore, listener: socket.socket | None = None) -> None:
        self._robot = robot
        self.observer: RequestObserver | None = None
        self._subscriptions: dict[Connection, _Subscription] = {}
        self._process_data = ProcessDataFeed(robot.nodes.values())
        self._server: Server[RobotHello, RobotPush] = Server(
            ROBOT,
            robot.reactor,
            socket_path("robot", robot.setup.name),
            lambda: RobotHello(robot.setup.name, __version__, PROTOCOL, os.getpid()),
            on_close=self._on_close,
            may_idle=self._may_idle,
            listener=listener,
        )
        self._objects = ObjectMethods(robot, self._server)
        self._answer()
        answer_control(robot, self._server)
        self._goals = GoalMethods(robot, self._server, self._keep)
        ParameterMethods(robot, self._server)
        SimulationMethods(robot, self._server)
        self._server.check()
        self._server.observer = self
        robot.observers.append(self)

    def _answer(self) -> None:
        robot, register = self._robot, self._server.register
        register(messages.GetStatus, lambda call: call.reply(status_message(robot)))
        register(messages.Subscribe, self._subscribe)
        register(messages.CommandController, self._command)
        register(messages.CommandByName, self._command_by_name)
        register(messages.TwistController, self._twist)
        register(messages.SetOdometry, self._set_odometry)
        register(messages.SetFeedForward, self._set_feed_forward)
        register(messages.Stop, self._stop)
        register(messages.Release, self._release)
        register(messages.Shutdown, self._shutdown)
        register(messages.AxisRequest, self._axis)
        register(messages.ReadTouchProbe, self._touch_probe)
        register(messages.GetNodes, lambda call: call.reply(nodes_message(robot)))
        register(messages.GetLayout, lambda call: call.reply(layout_message(robot)))
        register(messages.GetDescription, self._description)
        register(messages.PublishEvent, self._report)

    def close(self) -> None:
        self._flush_events()
        self._server.close()

    def _on_close(self, connection: Connection) -> None:
        self._objects.forget(connection)
        self._goals.forget(connection)
        self._robot.client_disconnected(connection)
        subscription = self._subscriptions.pop(connection, None)
        if connection.reason == "slow" and subscription is not None:
            text = f"client {connection.name} (pid {connection.pid}) read too slowly and was dropped"
            self._robot.report(Event(self._robot.reactor.now(), "client_dropped", "", text, Level.WARNING))

    def _may_idle(self, connection: Connection) -> bool:
        """Whether a connection may stay idle: it has a subscription, or a command that ends with the connection."""
        return connection in self._subscriptions or connection in self._robot.manager.running.clients_with_commands

    def _keep(self, connection: Connection) -> None:
        """Raise ControlError if too many connections are permanent; one must remain free for a `stop` at any time."""
        if (
            not self._may_idle(connection)
            and len({*self._subscriptions, *self._robot.manager.running.clients_with_commands}) >= MAX_KEPT
        ):
            raise ControlError(f"{MAX_KEPT} clients already subscribe or hold a command; end one of them")

    # ------------------------------------------------------------------------------------------- pushed messages

    def after_cycle(self, now: int) -> None:
        del now
        robot, watched = self._robot, self._subscriptions
        if robot.events.waiting or (
            watched and any(subscription.is_due(robot.pacer.count) for subscription in watched.values())
        ):
            robot.reactor.call_soon(self._push)

    def _push(self) -> None:
        """Send events, state samples and process data to their subscribers; each sample is encoded only once."""
        if self._robot.events.waiting:
            self._flush_events()
        count = self._robot.pacer.count
        watched = [client for client, subscription in self._subscriptions.items() if subscription.wants_state(count)]
        if watched:
            self._server.push(state_sample(self._robot), watched)
        if any(subscription.pdos for subscription in self._subscriptions.values()):
            self._push_process_data()

    def _push_process_data(self) -> None:
        changes = self._process_data.changes()
        if changes:
            watchers = [client for client, subscription in self._subscriptions.items() if subscription.pdos]
            self._server.push(messages.ProcessData(self._unix_time(), changes), watchers)

    def done(self, method: str, params: Raw) -> None:
        """Report an accepted request to `observer` and, up to `MAX_REQUEST` bytes, to the subscribers of requests."""
        if self.observer is not None:
            self.observer.requested(messages.RequestSeen(self._unix_time(), method, params))
        watchers = [connection for connection, subscription in self._subscriptions.items() if subscription.requests]
        if watchers and len(bytes(params)) <= MAX_REQUEST:
            self._server.push(messages.RequestSeen(self._unix_time(), method, params), watchers)

    def _unix_time(self) -> float:
        return (self._robot.reactor.now() + self._robot.wall_offset_ns) / 1e9

    def _flush_events(self) -> None:
        events = self._robot.events.take()
        watchers = [connection for connection, subscription in self._subscriptions.items() if subscription.events]
        for event in events if watchers else ():
            self._server.push(event_message(event, self._robot.wall_offset_ns), watchers)

    def sends_events_to(self, pid: int | None) -> bool:
        """Whether the process `pid` has subscribed to events."""
        return any(
            subscription.events and connection.pid == pid for connection, subscription in self._subscriptions.items()
        )

    def _subscribe(self, call: Call[messages.Subscribe]) -> None:
        request = call.request
        self._keep(call.connection)
        subscription = self._subscriptions.setdefault(call.connection, _Subscription())
        subscription.events, subscription.pdos, subscription.every = request.events, request.pdos, 0
        subscription.requests = request.requests
        if request.state_rate is not None:
            subscription.every = max(1, round(1e9 / request.state_rate / self._robot.pacer.period_ns))
        call.reply(Done())
        if request.pdos:
            everything = messages.ProcessData(self._unix_time(), self._process_data.everything())
            self._server.push(everything, [call.connection])

    # ------------------------------------------------------------------------------------------- motion

    def _command(self, call: Call[messages.CommandController]) -> None:
        self._require_interface(call.request)
        self._pass(call, call.request.values)

    def _command_by_name(self, call: Call[messages.CommandByName]) -> None:
        self._pass(call, call.request.values)

    def _pass(
        self, call: Call[Commands], values: Sequence[float] | Mapping[str, float], stamp: float | None = None
    ) -> None:
        """Pass a command to its controller, and answer with the joints that do not follow the command."""
        request, source = call.request, call.request.source
        sender = CommandSender(call.connection, call.sender(source))
        holder = self._holder(call)
        idle = self._robot.command(
            request.controller, values, source or call.client, stamp, holder=holder, sender=sender
        )
        call.reply(messages.CommandDone(idle))

    def _require_interface(self, request: messages.CommandController) -> None:
        """Raise ControlError if a request names a command interface that the controller is not using."""
        name, manager = request.controller, self._robot.manager
        expected = manager.get(name).interface if name in manager.states else None
        if expected is not None and request.interface not in (None, expected):
            raise ControlError(f"{name} currently accepts {expected}, not {request.interface}; nothing was applied")

    def _twist(self, call: Call[messages.TwistController]) -> None:
        self._pass(call, self._twist_values(call.request), call.request.stamp)

    def _twist_values(self, request: messages.TwistController) -> list[float]:
        """Return the values of a twist in the controller's order.

        Raise ControlError if the controller accepts no twists, or no lateral velocity.
        """
        name, manager = request.controller, self._robot.manager
        axes: tuple[str, ...] = _PLANAR
        if name in manager.states:
            axes = twist_axes_of(manager.get(name))
            if not axes:
                raise ControlError(f"{name} accepts no twist, since it is not a base controller; command it by values")
            if request.lateral and _SIDEWAYS not in axes:
                raise ControlError(f"{name} cannot drive sideways; it accepts {' and '.join(axes)}")
        twist = {"linear.x": request.linear, _SIDEWAYS: request.lateral, "angular.z": request.angular}
        return [twist[axis] for axis in axes]

    def _holder(self, call: Call[Commands]) -> Connection | None:
        """Return the connection whose loss ends the command, or None if the request has no `dead_man`."""
        if not call.request.dead_man:
            return None
        self._keep(call.connection)
        return call.connection

    def _set_odometry(self, call: Call[messages.SetOdometry]) -> None:
        request = call.request
        self._robot.manager.base(request.controller).set_odometry(request.x, request.y, request.heading)
        self._robot.truth.align()
        call.reply(Done())

    def _set_feed_forward(self, call: Call[messages.SetFeedForward]) -> None:
        controller = self._robot.manager.loops(call.request.controller, "has no feed-forward to switch")
        controller.set_feed_forward(call.request.enabled)
        call.reply(Done())

    def _stop(self, call: Call[messages.Stop]) -> None:
        source = call.request.source or call.client
        self._robot.stop(call.settle, source if call.request.latch else None, source)

    def _release(self, call: Call[messages.Release]) -> None:
        self._robot.latch.release(call.request.source or call.client, self._robot.reactor.now())
        call.reply(Done())

    def _shutdown(self, call: Call[messages.Shutdown]) -> None:
        call.reply(Done())
        self._robot.shutdown(f"requested by a client (pid {call.connection.pid})")

    def _axis(self, call: Call[messages.AxisRequest]) -> None:
        request = call.request

        def done(error: str | None) -> None:  # never before `axis` has returned
            if error is None:
                call.reply(AxisDone(together))
            else:
                call.refuse(ControlError(error))

        together = self._robot.axis(
            _action(request.action),
            str(request.node),
            done,
            joint=request.joint,
            method=request.method,
            mode=request.mode,
            holder=call.holder,
        )
        node = "" if request.node == "all" else self._robot.node(str(request.node)).name
        action = f"{request.action} {request.mode}" if request.mode else request.action
        joint = f" ({request.joint})" if request.joint not in (None, node) else ""
        text = f"{request.source or call.client} requested {action} of {node or 'all axes'}{joint}"
        self._robot.report(Event(self._robot.reactor.now(), "axis_asked", node, text))

    def _touch_probe(self, call: Call[messages.ReadTouchProbe]) -> None:
        def read(positions: dict[str, int] | str) -> None:
            if isinstance(positions, str):
                call.refuse(ControlError(positions))
            else:
                call.reply(TouchProbe(**positions))

        self._robot.touch_probe(self._robot.node(str(call.request.node)).name, read)

    # ------------------------------------------------------------------------------- descriptions and events

    def _description(self, call: Call[messages.GetDescription]) -> None:
        description = self._robot.setup.description
        call.reply(messages.Description(description.urdf_xml, os.path.abspath(description.path)))

    def _report(self, call: Call[messages.PublishEvent]) -> None:
        """Publish a client's message as a one-line event; raise LocalProtocolError for an invalid message."""
        kind, text = call.request.kind, " ".join(call.request.text.split())
        if not (kind.isidentifier() and len(kind) <= MAX_KIND and 0 < len(text) <= MAX_TEXT and text.isprintable()):
            raise LocalProtocolError(f"tell: give a word as kind, and a printable text of 1 to {MAX_TEXT} characters")
        if (level := _CLIENT_LEVELS.get(call.request.level)) is None:
            raise LocalProtocolError(f"tell: no level {call.request.level!r}; available: {', '.join(_CLIENT_LEVELS)}")
        self._robot.report(Event(self._robot.reactor.now(), kind, "", text, level))
        call.reply(Done())


_CLIENT_LEVELS = {"info": Level.INFO, "warning": Level.WARNING}


def _action(text: str) -> Action:
    try:
        return Action(text)
    except ValueError:
        raise UnknownName(f"no action {text!r}; available: {', '.join(action.value for action in Action)}") from None
