"""Control socket of a hub: serves the requests of `rpc.messages.hub` for one `FrameRouter`.

Its import takes longer than the rest of a hub, because of msgspec, so the hub imports it when no port waits for frames.
"""

from __future__ import annotations

import os
from typing import TYPE_CHECKING, Final, NoReturn, TypeVar

from canopen_control.bus import error_frames
from canopen_control.bus.frame_router import DropRule
from canopen_control.errors import ConfigError
from canopen_control.frame import RECORD_SIZE
from canopen_control.host.sockets import socket_path
from canopen_control.rpc.messages import hub
from canopen_control.rpc.messages.declare import PROTOCOL, Done, Request
from canopen_control.rpc.server import Call, Server

if TYPE_CHECKING:
    import socket
    from collections.abc import Callable, Mapping

    from canopen_control.bus.frame_router import FrameRouter, RouterPort
    from canopen_control.frame import CanFrame
    from canopen_control.host.reactor import Reactor


R = TypeVar("R", bound=Request[Done])
_NS_PER_MS: Final = 1_000_000

ERROR_FRAMES: Final[Mapping[hub.ErrorKind, Callable[[], CanFrame]]] = {
    "bus-error": error_frames.protocol_error_frame,
    "error-passive": error_frames.passive_frame,
    "error-active": error_frames.active_frame,
    "overrun": lambda: error_frames.overrun_frame(0),
}


class HubControl:
    """Control server of the bus `name`; `listener` is the listening socket.

    `started` is the reactor's time at which the hub started; `after` is called when the router may have frames to send.
    """

    def __init__(
        self,
        name: str,
        exchange: FrameRouter,
        reactor: Reactor,
        listener: socket.socket,
        *,
        started: int,
        after: Callable[[], None],
    ) -> None:
        self._name, self._exchange, self._now, self._after = name, exchange, reactor.now, after
        self._started = started
        path = socket_path("busctl", name)
        self._server: Server[hub.HubHello, NoReturn] = Server(hub.HUB, reactor, path, self._hello, listener=listener)
        self._server.register(hub.GetHubStatus, lambda call: call.reply(self._status()))
        self._answer_faults()
        self._server.check()

    def close(self) -> None:
        """End all connections and remove the socket; a second call does nothing."""
        self._server.close()

    def _hello(self) -> hub.HubHello:
        return hub.HubHello(self._name, PROTOCOL, os.getpid())

    def _answer_faults(self) -> None:
        exchange, label = self._exchange, self._label
        self._serve(hub.Cut, lambda request: exchange.cut(label(request.label)))
        self._serve(hub.Uncut, lambda request: exchange.cut(label(request.label), repair=True))
        self._serve(hub.ForceBusOff, lambda request: exchange.bus_off(label(request.label)))
        self._serve(hub.Restart, lambda request: exchange.bus_off(label(request.label), restart=True))
        self._serve(
            hub.SendErrorFrame, lambda request: exchange.report(self._label_or_all(request.label), _frame(request))
        )
        self._serve(hub.DropFrames, self._drop)
        self._serve(hub.DelayFrames, self._delay)
        self._serve(hub.SetBitrate, lambda request: exchange.pace(request.bitrate, self._now()))
        self._serve(hub.ClearFaults, lambda _request: exchange.clear_faults())

    def _serve(self, kind: type[R], do: Callable[[R], object]) -> None:
        def handle(call: Call[R]) -> None:
            self._exchange.tick(self._now())  # first process what was due before
            do(call.request)
            self._after()
            call.reply(Done())

        self._server.register(kind, handle)

    def _label(self, label: str) -> str:
        """Return `label` if a member or a fault has it, else raise ConfigError."""
        faults = self._exchange.faults
        labels = [member.label for member in self._exchange.members.values()]
        if label in labels or faults.silences(label) or label in faults.delays:
            return label
        raise ConfigError(f"no member called {label!r} on local:{self._name}; available: {', '.join(labels) or 'none'}")

    def _label_or_all(self, label: str) -> str:
        return self._label(label) if label else ""

    def _drop(self, request: hub.DropFrames) -> None:
        rule = DropRule(self._label_or_all(request.label), request.can_id, request.every, request.count)
        self._exchange.faults.drops.append(rule)

    def _delay(self, request: hub.DelayFrames) -> None:
        self._exchange.faults.delay(self._label_or_all(request.label), request.ms * _NS_PER_MS)

    def _status(self) -> hub.HubStatus:
        exchange, faults, now = self._exchange, self._exchange.faults, self._now()
        return hub.HubStatus(
            bus=self._name,
            pid=os.getpid(),
            uptime_s=(now - self._started) / 1e9,
            bitrate=None if exchange.wire is None else exchange.wire.bitrate,
            load=exchange.load(now),
            frames=exchange.frames,
            dropped=exchange.dropped,
            members=[_member(member) for member in exchange.members.values()],
            cut=sorted(faults.cut),
            bus_off=sorted(faults.bus_off),
            delays_ms={label: delay / _NS_PER_MS for label, delay in faults.delays.items()},
            drops=[_drop_state(rule) for rule in faults.drops],
        )


def _frame(request: hub.SendErrorFrame) -> CanFrame:
    return ERROR_FRAMES[request.kind]()


def _member(member: RouterPort) -> hub.Member:
    queued = len(member.outbox) // RECORD_SIZE
    return hub.Member(member.label, member.pid, member.rx, member.tx, member.lost, queued)


def _drop_state(rule: DropRule) -> hub.DropState:
    return hub.DropState(rule.label, rule.can_id, rule.every, rule.count, rule.matched, rule.lost)
