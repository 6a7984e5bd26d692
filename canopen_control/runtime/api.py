"""The runtime's API: newline-delimited JSON on a Unix socket, for every process that is not the robot itself.

The whole protocol. The server speaks first: `{"hello": {"robot", "version", "protocol": 1, "pid"}}`. A client sends
`{"id": N, "method": M, "params": {...}}` and is answered `{"id": N, "result": ...}` or `{"id": N, "error": {"kind",
"message"}}`; without "id" it is a notification and not answered. Answers may come in another order than the requests.
An error's kind is a class of errors.py: UnknownName where there is nothing of a name that was given.

  status                                            the shape of `status --json` (runtime/status.py)
  subscribe    state_rate (Hz or null), events, pdos   then pushes `{"state": {...}}`, `{"event": {...}}` and `{"pdos":
                                                    {"time", "nodes": {node: [[index, subindex, hex], ...]}}}`: what
                                                    TPDOs carry, first everything, then per cycle what has changed
  command      controller, values, source, dead_man a controller's command; SI units
  twist        controller, linear, angular, source, dead_man   the same as velocities of a base, m/s and rad/s;
                                                    dead_man true: it ends with this connection, whatever ends that
  stop         latch, source                        ramps to zero and disables; answered when no drive moves any more;
                                                    latch true: nothing moves before `release`, whoever asks for it
  release      source                               lets go of a latched stop; the drives stay disabled
  shutdown                                          the same, then the runtime ends
  set_odometry  controller, x, y, heading           where a base controller's odometry goes on from
  axis         action, node, joint, method, mode    enable, disable, halt, quick-stop, fault-reset, home (method),
                                                    mode (mode: a name such as CSP); node may be "all"; joint: that
                                                    one alone, of a node with several axes
  touch_probe  node                                 `{"status", "function", "probe_1_positive", ...}`, device units
  controllers                                       name, type, state, interfaces, topics of each
  controller_types                                  the names that a controller's `type` may have
  load, configure, cleanup, unload     controller   one of ros2_controllers.yaml; its next or previous state
  switch       activate, deactivate, strict         controller names
  hardware                                          name, type, plugin, state, interfaces of each component
  set_hardware_state   component, state             "inactive" or "active"; nothing moves by it
  nmt          command, node                        start, stop, preop, reset-node, reset-comm
  nodes                                             `{"buses": {bus: {"channel", "node_id"}}, "nodes": [{"name",
                                                    "node_id", "bus", "eds", "identity"}]}`: the master's node ids;
                                                    paths; what boot expects of 0x1000 and 0x1018 (0: anything)
  layout                                            `{"buses": {bus: ...}}`: what the PDOs carry (master/layout.py)
  sdo_read     node, index, subindex, block, timeout   `{"data": hex}`; block true asks for block transfer
  sdo_write    node, index, subindex, data (hex), timeout   seconds for each answer; default: the node's
  pdo_write    node, index, subindex, data (hex)    sent in the RPDOs that map it from the next cycle on, until it is
                                                    written again; not what moves an axis
  description                                       `{"urdf": text, "path": of the file it was made of}`
  tell         kind, text                           an event of level info, for all who watch: what a client has to say

A client that reads too slowly is dropped; a client that dies changes nothing but that its commands time out.
"""

from __future__ import annotations

import os
from typing import TYPE_CHECKING, Any

from canopen_control import __version__
from canopen_control.cia301.nmt import NmtCommand
from canopen_control.controllers.diff_drive import DiffDriveController
from canopen_control.errors import CanopenError, ControlError, LocalProtocolError, UnknownName
from canopen_control.hardware.joint import Action
from canopen_control.host.jsonlines import LineServer, encode
from canopen_control.host.sockets import socket_path
from canopen_control.master.events import Event, Level
from canopen_control.runtime.api_control import control_methods
from canopen_control.runtime.call import Call
from canopen_control.runtime.latch import forget_commands
from canopen_control.runtime.process_data import ProcessDataFeed, write_mapped
from canopen_control.runtime.status import event_dict, layout_dict, nodes_dict, state_dict, status_dict

if TYPE_CHECKING:
    from collections.abc import Callable

    from canopen_control.host.jsonlines import Connection
    from canopen_control.master.node import RemoteNode
    from canopen_control.runtime.core import RobotCore

__all__ = ["PROTOCOL", "ApiServer"]

PROTOCOL = 1
MAX_RATE = 1000.0  # Hz, of the state stream
MAX_TIMEOUT_S = 60.0  # of one SDO answer
MAX_KIND, MAX_TEXT = 32, 500  # characters of what a client tells
_NMT = {
    "start": NmtCommand.START,
    "stop": NmtCommand.STOP,
    "preop": NmtCommand.ENTER_PRE_OPERATIONAL,
    "reset-node": NmtCommand.RESET_NODE,
    "reset-comm": NmtCommand.RESET_COMMUNICATION,
}


class _Subscription:
    """What a connection watches; `every` is in cycles, 0 for no state."""

    __slots__ = ("events", "every", "pdos")

    def __init__(self) -> None:
        self.every, self.events, self.pdos = 0, False, False

    def wants_state(self, cycle: int) -> bool:
        """Whether it is to be told the state after this cycle."""
        return self.every > 0 and cycle % self.every == 0

    def is_due(self, cycle: int) -> bool:
        """Whether it is to be told something of this cycle, events apart."""
        return self.pdos or self.wants_state(cycle)


class ApiServer:
    """Serves one robot; the socket exists from construction to `close`."""

    def __init__(self, robot: RobotCore) -> None:
        self._robot = robot
        self._subscriptions: dict[Connection, _Subscription] = {}
        self._dead_men: dict[Connection, tuple[str, str]] = {}  # controller and source of what ends with its connection
        self._process_data = ProcessDataFeed(robot.nodes.values())
        self._server = LineServer(
            robot.reactor, socket_path("robot", robot.setup.name), self._greet, self._on_message, self._on_close
        )
        self._methods: dict[str, Callable[[Call], None]] = {
            "status": lambda call: call.reply(status_dict(robot)),
            "subscribe": self._subscribe,
            "command": self._command,
            "twist": self._twist,
            "set_odometry": self._set_odometry,
            "stop": lambda call: robot.stop(call.settle, call.source if call.params.get("latch") else None),
            "release": self._release,
            "shutdown": self._shutdown,
            "axis": self._axis,
            "touch_probe": self._touch_probe,
            **control_methods(robot),
            "nodes": lambda call: call.reply(nodes_dict(robot)),
            "layout": lambda call: call.reply(layout_dict(robot)),
            "nmt": self._nmt,
            "sdo_read": self._sdo_read,
            "sdo_write": self._sdo_write,
            "pdo_write": self._pdo_write,
            "description": lambda call: call.reply(
                {"urdf": robot.setup.description.urdf_xml, "path": os.path.abspath(robot.setup.description.path)}
            ),
            "tell": self._tell,
        }
        robot.after_cycle.append(self._after_cycle)

    def close(self) -> None:
        """End every connection and remove the socket."""
        self._flush_events()
        self._server.close()

    def _greet(self, connection: Connection) -> None:
        hello = {"robot": self._robot.setup.name, "version": __version__, "protocol": PROTOCOL, "pid": os.getpid()}
        connection.send({"hello": hello})

    def _on_close(self, connection: Connection) -> None:
        if (held := self._dead_men.pop(connection, None)) is not None:
            self._let_go(*held)
        subscription = self._subscriptions.pop(connection, None)
        if connection.reason == "slow" and subscription is not None:
            text = f"client {connection.name} (pid {connection.pid}) read too slowly and was dropped"
            self._robot.report(Event(self._robot.reactor.now(), "client_dropped", "", text, Level.WARNING))

    def _on_message(self, connection: Connection, message: dict[str, Any]) -> None:
        """Do what a client asks; whatever it sends, the answer is a sentence and the robot goes on."""
        method, params = message.get("method"), message.get("params", {})
        call = Call(connection, params, message.get("id"))
        handler = self._methods.get(method) if isinstance(method, str) else None
        try:
            if handler is None:
                raise LocalProtocolError(f"no method {method!r}; there are: {', '.join(self._methods)}")
            if not isinstance(params, dict):
                raise LocalProtocolError(f"params of {method} must be an object")
            handler(call)
        except CanopenError as error:
            call.refuse(error)
        except (KeyError, TypeError, ValueError, OverflowError) as error:
            call.refuse(LocalProtocolError(f"{method}: bad or missing parameter: {error}"))

    def _after_cycle(self, _now: int) -> None:
        """Have what is new told to those who watch, between this cycle and the next: what has come is read before."""
        robot, watched = self._robot, self._subscriptions
        if robot.events.waiting or (watched and any(each.is_due(robot.pacer.count) for each in watched.values())):
            robot.reactor.call_soon(self._push)

    def _push(self) -> None:
        """Send what is new; each rate's sample is encoded once."""
        if self._robot.events.waiting:
            self._flush_events()
        count, sample = self._robot.pacer.count, b""
        for connection, subscription in list(self._subscriptions.items()):
            if subscription.wants_state(count):
                sample = sample or encode({"state": state_dict(self._robot)})
                connection.send_encoded(sample)
        if any(each.pdos for each in self._subscriptions.values()):
            self._push_process_data()

    def _push_process_data(self) -> None:
        changes = self._process_data.changes()
        line = encode(self._process_data_message(changes)) if changes else b""
        for connection, subscription in list(self._subscriptions.items()) if changes else ():
            if subscription.pdos:
                connection.send_encoded(line)

    def _process_data_message(self, nodes: dict[str, Any]) -> dict[str, Any]:
        now = self._robot.reactor.now() + self._robot.wall_offset_ns
        return {"pdos": {"time": now / 1e9, "nodes": nodes}}

    def _flush_events(self) -> None:
        events = self._robot.events.take()
        watchers = [connection for connection, wanted in self._subscriptions.items() if wanted.events]
        for event in events if watchers else ():
            line = encode({"event": event_dict(self._robot, event)})
            for connection in watchers:
                connection.send_encoded(line)

    def _subscribe(self, call: Call) -> None:
        rate = call.params.get("state_rate")
        subscription = self._subscriptions.setdefault(call.connection, _Subscription())
        subscription.events = bool(call.params.get("events", False))
        subscription.pdos = bool(call.params.get("pdos", False))
        subscription.every = 0
        if rate is not None:
            rate = float(rate)
            if not 0.0 < rate <= MAX_RATE:
                raise LocalProtocolError(f"state_rate {rate:g} Hz: it must be above 0 and at most {MAX_RATE:g}")
            subscription.every = max(1, round(1e9 / rate / self._robot.pacer.period_ns))
        call.reply({})
        if subscription.pdos:
            call.connection.send(self._process_data_message(self._process_data.everything()))

    def _command(self, call: Call) -> None:
        values = [float(value) for value in call.params["values"]]
        self._robot.command(str(call.params["controller"]), values, call.source)
        self._hold(call)
        call.reply({})

    def _twist(self, call: Call) -> None:
        name = str(call.params["controller"])
        if self._robot.manager.get(name).topic != "cmd_vel":
            raise ControlError(f"{name} takes no twist; it is no base controller, command it by values")
        values = [float(call.params["linear"]), float(call.params["angular"])]
        stamp = call.params.get("stamp")
        self._robot.command(name, values, call.source, None if stamp is None else float(stamp))
        self._hold(call)
        call.reply({})

    def _hold(self, call: Call) -> None:
        if call.params.get("dead_man"):
            self._dead_men[call.connection] = (str(call.params["controller"]), call.source)

    def _let_go(self, controller: str, source: str) -> None:
        """End what a client has commanded that is gone, unless somebody else commands by now."""
        if self._robot.commander == source:
            running = [each for each in self._robot.manager.running if each.name == controller]
            forget_commands(running, self._robot.reactor.now())

    def _set_odometry(self, call: Call) -> None:
        name = str(call.params["controller"])
        controller = self._robot.manager.get(name)
        if not isinstance(controller, DiffDriveController):
            raise ControlError(f"{name} has no odometry; it is no base controller")
        controller.set_odometry(*(float(call.params[key]) for key in ("x", "y", "heading")))
        call.reply({})

    def _release(self, call: Call) -> None:
        self._robot.latch.release(call.source, self._robot.reactor.now())
        call.reply({})

    def _shutdown(self, call: Call) -> None:
        call.reply({})
        self._robot.shutdown(f"a client asked for it (pid {call.connection.pid})")

    def _axis(self, call: Call) -> None:
        method, mode, joint = (call.params.get(key) for key in ("method", "mode", "joint"))
        action, name = _choice(Action, call.params["action"]), str(call.params["node"])
        self._robot.axis(
            action,
            name,
            call.settle,
            joint=None if joint is None else str(joint),
            method=None if method is None else int(method),
            mode=None if mode is None else str(mode),
        )

    def _touch_probe(self, call: Call) -> None:
        def read(found: dict[str, int] | str) -> None:
            if isinstance(found, str):
                call.settle(found)
            else:
                call.reply(found)

        self._robot.touch_probe(self._node(call.params["node"]).name, read)

    def _node(self, name: object) -> RemoteNode:
        return self._robot.node(str(name))

    def _nmt(self, call: Call) -> None:
        name, wanted, robot = str(call.params["command"]), str(call.params["node"]), self._robot
        if name not in _NMT:
            raise UnknownName(f"no NMT command {name!r}; there are: {', '.join(_NMT)}")
        for node in list(robot.nodes.values()) if wanted == "all" else [self._node(wanted)]:
            node.command(_NMT[name], robot.reactor.now())
            robot.bus_of(node).send_waiting()
        call.reply({})

    def _tell(self, call: Call) -> None:
        """Let a client speak to all; on one line, since it is printed where the robot's own sentences are."""
        kind, text = str(call.params["kind"]), " ".join(str(call.params["text"]).split())
        if not (kind.isidentifier() and len(kind) <= MAX_KIND and 0 < len(text) <= MAX_TEXT and text.isprintable()):
            raise LocalProtocolError(f"tell: a word as kind, and a printable text of 1 to {MAX_TEXT} characters")
        self._robot.report(Event(self._robot.reactor.now(), kind, "", text))
        call.reply({})

    def _sdo_read(self, call: Call) -> None:
        node, (index, subindex) = self._node(call.params["node"]), _address(call)
        block = bool(call.params.get("block", False))
        request = node.sdo.read(index, subindex, block=block, timeout_ns=_timeout(call))
        request.context = call.ended
        self._robot.bus_of(node).send_waiting()

    def _sdo_write(self, call: Call) -> None:
        node, (index, subindex) = self._node(call.params["node"]), _address(call)
        self._robot.latch.check_write(index)
        data = bytes.fromhex(str(call.params["data"]))
        request = node.sdo.write(index, subindex, data, timeout_ns=_timeout(call))
        request.context = call.ended
        self._robot.bus_of(node).send_waiting()

    def _pdo_write(self, call: Call) -> None:
        node, (index, subindex) = self._node(call.params["node"]), _address(call)
        write_mapped(self._robot, node, index, subindex, bytes.fromhex(str(call.params["data"])))
        call.reply({})


def _address(call: Call) -> tuple[int, int]:
    return int(call.params["index"]), int(call.params.get("subindex", 0))


def _timeout(call: Call) -> int | None:
    seconds = call.params.get("timeout")
    if seconds is None:
        return None
    if not 0.0 < float(seconds) <= MAX_TIMEOUT_S:
        raise LocalProtocolError(f"timeout {seconds} s: it must be above 0 and at most {MAX_TIMEOUT_S:g}")
    return round(float(seconds) * 1e9)


def _choice(kind: type[Action], text: object) -> Action:
    try:
        return kind(text)
    except ValueError:
        raise UnknownName(f"no action {text!r}; there are: {', '.join(each.value for each in kind)}") from None
