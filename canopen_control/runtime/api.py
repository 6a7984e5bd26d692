"""The server of a running robot's socket: the methods of `rpc/messages/robot.py`, and what is pushed to who watches."""

from __future__ import annotations

import os
from typing import TYPE_CHECKING, TypeVar

from canopen_control.controllers.base import twist_axes_of
from canopen_control.errors import ControlError, LocalProtocolError, UnknownName
from canopen_control.hardware.joint import Action
from canopen_control.host.lineserver import MAX_KEPT
from canopen_control.host.sockets import socket_path
from canopen_control.master.event_log import Event, Level
from canopen_control.rpc.messages import robot as messages
from canopen_control.rpc.messages.declare import PROTOCOL, Done
from canopen_control.rpc.messages.robot import ROBOT, AxisDone, RobotHello, TouchProbe
from canopen_control.rpc.server import Server
from canopen_control.runtime.api_control import answer_control
from canopen_control.runtime.api_gripper import GripperMethods
from canopen_control.runtime.api_objects import ObjectMethods
from canopen_control.runtime.api_parameters import ParameterMethods
from canopen_control.runtime.api_simulation import SimulationMethods
from canopen_control.runtime.api_trajectories import TrajectoryMethods
from canopen_control.runtime.process_data import ProcessDataFeed
from canopen_control.runtime.status import (
    event_message,
    layout_message,
    nodes_message,
    state_sample,
    status_message,
)
from canopen_control.version import __version__

if TYPE_CHECKING:
    import socket
    from collections.abc import Callable

    from canopen_control.rpc.messages.robot import RobotPush
    from canopen_control.rpc.server import Call, Connection
    from canopen_control.rpc.wire import Raw
    from canopen_control.runtime.core import RobotCore

__all__ = ["ApiServer"]

MAX_KIND, MAX_TEXT = 32, 500  # characters of what a client tells
MAX_REQUEST = 1 << 16  # bytes of a request that others are told
_PLANAR, _SIDEWAYS = ("linear.x", "angular.z"), "linear.y"
Commands = TypeVar("Commands", messages.CommandController, messages.CommandByName, messages.TwistController)


class _Subscription:
    """What a connection watches; `every` is in cycles, 0 for no state."""

    __slots__ = ("events", "every", "pdos", "requests")

    def __init__(self) -> None:
        self.every, self.events, self.pdos, self.requests = 0, False, False, False

    def wants_state(self, cycle: int) -> bool:
        """Whether it is to be told the state after this cycle."""
        return self.every > 0 and cycle % self.every == 0

    def is_due(self, cycle: int) -> bool:
        """Whether it is to be told something of this cycle, events apart."""
        return self.pdos or self.wants_state(cycle)


class ApiServer:
    """Serves one robot; the socket exists from construction to `close`, unless a `listener` stands for it.

    `on_request` hears each request that was not refused at once, but of those that only read.
    """

    def __init__(self, robot: RobotCore, listener: socket.socket | None = None) -> None:
        self._robot = robot
        self.on_request: Callable[[messages.Asked], object] | None = None
        self._subscriptions: dict[Connection, _Subscription] = {}
        self._process_data = ProcessDataFeed(robot.nodes.values())
        self._server: Server[RobotHello, RobotPush] = Server(
            ROBOT,
            robot.reactor,
            socket_path("robot", robot.setup.name),
            lambda: RobotHello(robot.setup.name, __version__, PROTOCOL, os.getpid()),
            on_close=self._on_close,
            keeps=self._keeps,
            listener=listener,
        )
        self._objects = ObjectMethods(robot, self._server)
        self._answer()
        answer_control(robot, self._server)
        self._trajectories = TrajectoryMethods(robot, self._server, self._keep)
        self._grippers = GripperMethods(robot, self._server, self._keep, self._trajectories.promise)
        ParameterMethods(robot, self._server)
        SimulationMethods(robot, self._server)
        self._server.check()
        self._server.on_done = self._push_request
        robot.after_cycle.append(self._after_cycle)

    def _answer(self) -> None:
        """Give every method its handler, but those of controllers and of objects."""
        robot, answers = self._robot, self._server.answers
        answers(messages.GetStatus, lambda call: call.reply(status_message(robot)))
        answers(messages.Subscribe, self._subscribe)
        answers(messages.CommandController, self._command)
        answers(messages.CommandByName, self._command_by_name)
        answers(messages.TwistController, self._twist)
        answers(messages.SetOdometry, self._set_odometry)
        answers(messages.SetFeedForward, self._set_feed_forward)
        answers(messages.Stop, self._stop)
        answers(messages.Release, self._release)
        answers(messages.Shutdown, self._shutdown)
        answers(messages.AxisRequest, self._axis)
        answers(messages.ReadTouchProbe, self._touch_probe)
        answers(messages.GetNodes, lambda call: call.reply(nodes_message(robot)))
        answers(messages.GetLayout, lambda call: call.reply(layout_message(robot)))
        answers(messages.GetDescription, self._description)
        answers(messages.Tell, self._tell)

    def close(self) -> None:
        """End every connection and remove the socket."""
        self._flush_events()
        self._server.close()

    def _on_close(self, connection: Connection) -> None:
        self._objects.forget(connection)
        self._trajectories.forget(connection)
        self._grippers.forget(connection)
        self._robot.let_go(connection)
        subscription = self._subscriptions.pop(connection, None)
        if connection.reason == "slow" and subscription is not None:
            text = f"client {connection.name} (pid {connection.pid}) read too slowly and was dropped"
            self._robot.report(Event(self._robot.reactor.now(), "client_dropped", "", text, Level.WARNING))

    def _keeps(self, connection: Connection) -> bool:
        """Whether a connection may be silent: it is told something, or what it commands ends with it."""
        return connection in self._subscriptions or connection in self._robot.manager.running.holders

    def _keep(self, connection: Connection) -> None:
        """Refuse one more of those who stay; the places that are left are for `stop`, `status` and their like."""
        if (
            not self._keeps(connection)
            and len({*self._subscriptions, *self._robot.manager.running.holders}) >= MAX_KEPT
        ):
            raise ControlError(f"{MAX_KEPT} clients watch or hold a command already; end one of them")

    # ------------------------------------------------------------------------------------------- what is pushed

    def _after_cycle(self, _now: int) -> None:
        """Have what is new told to those who watch, between this cycle and the next: what has come is read before."""
        robot, watched = self._robot, self._subscriptions
        if robot.events.waiting or (watched and any(each.is_due(robot.pacer.count) for each in watched.values())):
            robot.reactor.call_soon(self._push)

    def _push(self) -> None:
        """Send what is new; each rate's sample is encoded once."""
        if self._robot.events.waiting:
            self._flush_events()
        count = self._robot.pacer.count
        watched = [each for each, wanted in self._subscriptions.items() if wanted.wants_state(count)]
        if watched:
            self._server.push(state_sample(self._robot), watched)
        if any(each.pdos for each in self._subscriptions.values()):
            self._push_process_data()

    def _push_process_data(self) -> None:
        changes = self._process_data.changes()
        if changes:
            watchers = [each for each, wanted in self._subscriptions.items() if wanted.pdos]
            self._server.push(messages.ProcessData(self._unix_time(), changes), watchers)

    def _push_request(self, method: str, params: Raw) -> None:
        if self.on_request is not None:
            self.on_request(messages.Asked(self._unix_time(), method, params))
        watchers = [connection for connection, wanted in self._subscriptions.items() if wanted.requests]
        if watchers and len(bytes(params)) <= MAX_REQUEST:
            self._server.push(messages.Asked(self._unix_time(), method, params), watchers)

    def _unix_time(self) -> float:
        return (self._robot.reactor.now() + self._robot.wall_offset_ns) / 1e9

    def _flush_events(self) -> None:
        events = self._robot.events.take()
        watchers = [connection for connection, wanted in self._subscriptions.items() if wanted.events]
        for event in events if watchers else ():
            self._server.push(event_message(self._robot, event), watchers)

    def _subscribe(self, call: Call[messages.Subscribe]) -> None:
        wanted = call.request
        self._keep(call.connection)
        subscription = self._subscriptions.setdefault(call.connection, _Subscription())
        subscription.events, subscription.pdos, subscription.every = wanted.events, wanted.pdos, 0
        subscription.requests = wanted.requests
        if wanted.state_rate is not None:
            subscription.every = max(1, round(1e9 / wanted.state_rate / self._robot.pacer.period_ns))
        call.reply(Done())
        if wanted.pdos:
            everything = messages.ProcessData(self._unix_time(), self._process_data.everything())
            self._server.push(everything, [call.connection])

    # ------------------------------------------------------------------------------------------- motion

    def _command(self, call: Call[messages.CommandController]) -> None:
        wanted = call.request
        source = wanted.source or call.who
        self._require_interface(wanted)
        self._robot.command(wanted.controller, wanted.values, source, holder=self._holder(call))
        call.reply(Done())

    def _command_by_name(self, call: Call[messages.CommandByName]) -> None:
        wanted = call.request
        source = wanted.source or call.who
        self._robot.command(wanted.controller, wanted.values, source, holder=self._holder(call))
        call.reply(Done())

    def _require_interface(self, wanted: messages.CommandController) -> None:
        """Refuse values that their sender takes for something else than the controller does now; ControlError."""
        name, manager = wanted.controller, self._robot.manager
        takes = manager.get(name).interface if name in manager.states else None
        if takes is not None and wanted.interface not in (None, takes):
            raise ControlError(f"{name} takes a {takes} now and no {wanted.interface}; nothing was applied")

    def _twist(self, call: Call[messages.TwistController]) -> None:
        wanted = call.request
        name = wanted.controller
        values, source = self._twist_values(wanted), wanted.source or call.who
        self._robot.command(name, values, source, wanted.stamp, holder=self._holder(call))
        call.reply(Done())

    def _twist_values(self, wanted: messages.TwistController) -> list[float]:
        """Return a twist by the axes that the base has; ControlError for one that it cannot drive."""
        name, manager = wanted.controller, self._robot.manager
        axes: tuple[str, ...] = _PLANAR
        if name in manager.states:
            axes = twist_axes_of(manager.get(name))
            if not axes:
                raise ControlError(f"{name} takes no twist; it is no base controller, command it by values")
            if wanted.lateral and _SIDEWAYS not in axes:
                raise ControlError(f"{name} cannot drive sideways; it takes {' and '.join(axes)}")
        twist = {"linear.x": wanted.linear, _SIDEWAYS: wanted.lateral, "angular.z": wanted.angular}
        return [twist[axis] for axis in axes]

    def _holder(self, call: Call[Commands]) -> Connection | None:
        """Return with whom a command ends: the connection it came on, where that was asked for."""
        if not call.request.dead_man:
            return None
        self._keep(call.connection)
        return call.connection

    def _set_odometry(self, call: Call[messages.SetOdometry]) -> None:
        wanted = call.request
        self._robot.manager.get(wanted.controller).set_odometry(wanted.x, wanted.y, wanted.heading)
        self._robot.truth.align()
        call.reply(Done())

    def _set_feed_forward(self, call: Call[messages.SetFeedForward]) -> None:
        self._robot.manager.get(call.request.controller).set_feed_forward(call.request.enabled)
        call.reply(Done())

    def _stop(self, call: Call[messages.Stop]) -> None:
        who = call.request.source or call.who
        self._robot.stop(call.settle, who if call.request.latch else None, who)

    def _release(self, call: Call[messages.Release]) -> None:
        self._robot.latch.release(call.request.source or call.who, self._robot.reactor.now())
        call.reply(Done())

    def _shutdown(self, call: Call[messages.Shutdown]) -> None:
        call.reply(Done())
        self._robot.shutdown(f"a client asked for it (pid {call.connection.pid})")

    def _axis(self, call: Call[messages.AxisRequest]) -> None:
        wanted = call.request

        def done(error: str | None) -> None:  # never before `axis` has returned
            if error is None:
                call.reply(AxisDone(together))
            else:
                call.refuse(ControlError(error))

        together = self._robot.axis(
            _action(wanted.action), str(wanted.node), done, joint=wanted.joint, method=wanted.method, mode=wanted.mode
        )
        node = "" if wanted.node == "all" else self._robot.node(str(wanted.node)).name
        what = f"{wanted.action} {wanted.mode}" if wanted.mode else wanted.action
        joint = f" ({wanted.joint})" if wanted.joint not in (None, node) else ""
        text = f"{wanted.source or call.who} asked for {what} of {node or 'all axes'}{joint}"
        self._robot.report(Event(self._robot.reactor.now(), "axis_asked", node, text))

    def _touch_probe(self, call: Call[messages.ReadTouchProbe]) -> None:
        def read(found: dict[str, int] | str) -> None:
            if isinstance(found, str):
                call.refuse(ControlError(found))
            else:
                call.reply(TouchProbe(**found))

        self._robot.touch_probe(self._robot.node(str(call.request.node)).name, read)

    # ------------------------------------------------------------------------------------------- words

    def _description(self, call: Call[messages.GetDescription]) -> None:
        description = self._robot.setup.description
        call.reply(messages.Description(description.urdf_xml, os.path.abspath(description.path)))

    def _tell(self, call: Call[messages.Tell]) -> None:
        """Let a client speak to all; on one line, since it is printed where the robot's own sentences are."""
        kind, text = call.request.kind, " ".join(call.request.text.split())
        if not (kind.isidentifier() and len(kind) <= MAX_KIND and 0 < len(text) <= MAX_TEXT and text.isprintable()):
            raise LocalProtocolError(f"tell: a word as kind, and a printable text of 1 to {MAX_TEXT} characters")
        if (level := _TOLD_LEVELS.get(call.request.level)) is None:
            raise LocalProtocolError(f"tell: no level {call.request.level!r}; there are: {', '.join(_TOLD_LEVELS)}")
        self._robot.report(Event(self._robot.reactor.now(), kind, "", text, level))
        call.reply(Done())


_TOLD_LEVELS = {"info": Level.INFO, "warning": Level.WARNING}


def _action(text: str) -> Action:
    try:
        return Action(text)
    except ValueError:
        raise UnknownName(f"no action {text!r}; there are: {', '.join(each.value for each in Action)}") from None
