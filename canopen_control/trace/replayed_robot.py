"""Replay of a robot's recording on a robot socket, with states and events at their original rate.

Clients that watch a robot (the page, `status --watch`, `monitor`) can watch the replay; requests for motion or changes
are refused. The recording is played once, starting when a client subscribes, and then remains at its end.
"""

from __future__ import annotations

import os
from typing import TYPE_CHECKING, Any, Final

from canopen_control.errors import ConfigError, ControlError
from canopen_control.host.sockets import socket_path
from canopen_control.rpc.messages import robot as messages
from canopen_control.rpc.messages.declare import PROTOCOL, Done
from canopen_control.rpc.messages.robot import ROBOT, BusPlace, Description, NodeListing, RobotHello
from canopen_control.rpc.messages.state import StateSample, Status
from canopen_control.rpc.server import Server
from canopen_control.version import __version__

if TYPE_CHECKING:
    from collections.abc import Sequence

    from canopen_control.host.lineserver import Connection
    from canopen_control.host.reactor import Reactor
    from canopen_control.rpc.messages.robot import RobotPush
    from canopen_control.rpc.messages.state import RobotEvent
    from canopen_control.rpc.server import Call
    from canopen_control.trace.flight_file import FlightMeta


_STANDS_NS: Final = 500_000_000
_LONGEST_S: Final = 1.0  # maximum pause between two samples: gaps in a recording are skipped


class ReplayedRobot:
    """Server that replays the `samples` and `events` of a recording; `speed` multiplies the rate.

    `over` is True after the last sample. Raise ConfigError without samples.
    """

    def __init__(
        self,
        name: str,
        meta: FlightMeta,
        samples: Sequence[StateSample],
        events: Sequence[RobotEvent],
        description: Description,
        reactor: Reactor,
        speed: float = 1.0,
    ) -> None:
        if not samples:
            raise ConfigError(f"the recording of {meta.robot} contains no states to replay")
        self.name, self.over, self._begun = name, False, False
        self._meta, self._samples = meta, samples
        self._description = Description(description.urdf, description.path, meta.world)
        self._events = sorted(events, key=lambda event: event.time)
        self._reactor, self._speed = reactor, speed
        self._at = 0
        self._past_events: list[RobotEvent] = []
        self._watching: dict[Connection, messages.Subscribe] = {}
        self._server: Server[RobotHello, RobotPush] = Server(
            ROBOT,
            reactor,
            socket_path("robot", name),
            lambda: RobotHello(name, __version__, PROTOCOL, os.getpid()),
            on_close=lambda connection: self._watching.pop(connection, None),
            may_idle=self._watching.__contains__,
        )
        self._answer()

    def _answer(self) -> None:
        register = self._server.register
        for method in ROBOT.methods.values():
            register(method.request, self._refuse)
        register(messages.GetStatus, lambda call: call.reply(self._status()))
        register(messages.GetDescription, lambda call: call.reply(self._description))
        register(messages.GetNodes, lambda call: call.reply(self._nodes()))
        register(messages.GetLayout, lambda call: call.reply(self._meta.layout))
        register(messages.ListControllers, lambda call: call.reply(()))
        register(messages.Subscribe, self._subscribe)

    def close(self) -> None:
        self._server.close()

    def _refuse(self, call: Call[Any]) -> None:
        call.refuse(ControlError(f"{self.name} is a recording of {self._meta.robot}, which cannot be changed"))

    def _subscribe(self, call: Call[messages.Subscribe]) -> None:
        self._watching[call.connection] = call.request
        call.reply(Done())
        if call.request.state_rate is None:
            return
        if self._begun:
            self._server.push(self._samples[self._at], [call.connection])
        else:
            self._begun = True
            self._report()

    def _report(self) -> None:
        sample = self._samples[self._at]
        self._server.push(
            sample,
            [connection for connection, subscription in self._watching.items() if subscription.state_rate is not None],
        )
        while self._events and self._events[0].time <= sample.time:
            event = self._events.pop(0)
            self._past_events.append(event)
            self._server.push(
                event, [connection for connection, subscription in self._watching.items() if subscription.events]
            )
        if self._at + 1 == len(self._samples):
            self.over = True
            self._reactor.call_later(_STANDS_NS, self._report)  # clients would consider a silent robot lost
            return
        wait = min(max(self._samples[self._at + 1].time - sample.time, 0.0), _LONGEST_S) / self._speed
        self._reactor.call_later(round(wait * 1e9), self._next)

    def _next(self) -> None:
        self._at += 1
        self._report()

    def _status(self) -> Status:
        sample, status = self._samples[self._at], self._meta.status
        return sample.grown(
            Status,
            robot=self.name,
            buses={} if status is None else status.buses,
            boot=[] if status is None else status.boot,
            events=list(self._past_events),
        )

    def _nodes(self) -> NodeListing:
        """Return the buses without nodes, because the nodes now on the bus are not the recorded nodes."""
        return NodeListing({name: BusPlace(channel, 1) for name, channel in self._meta.buses.items()}, [])
