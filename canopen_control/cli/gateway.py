"""Serve the text commands of CiA 309-3, which read and write objects, for CANopenNode's cocomm and for scripts.

It serves the nodes of a running robot, or with --can all nodes of a bare bus. Commands come from standard input, from a
Unix socket that only you can open (--unix), or from a TCP port (--tcp), which every user of this computer can reach.
One client is served at a time. NMT commands, writes that may move a drive, and changes of node-IDs are refused without
--allow-motion. The robot runs, and stops, as it does without a gateway.

Exit codes: 0 after the end of the input or Ctrl-C; 1 the robot or the bus is gone, the address is in use, or the input
ended in the middle of a line; 2 wrong usage.
"""

from __future__ import annotations

import contextlib
import re
import signal
import socket
import sys
import time
from pathlib import Path
from typing import TYPE_CHECKING

from canopen_control.cia301.nmt import EXPECTED_STATE
from canopen_control.cli.support.arguments import whole_number
from canopen_control.cli.support.target import (
    NMT_TIMEOUT_S,
    ROBOT_TIMEOUTS,
    BusTarget,
    RobotTarget,
    add_target_arguments,
    robot_on,
)
from canopen_control.client import RobotClient
from canopen_control.errors import BusClosed, BusError, CanopenError, ConfigError
from canopen_control.frame import BROADCAST
from canopen_control.gateway.dialect import INTERNAL_STATE, UNSUPPORTED_NODE, WRONG_NMT_STATE, GatewayRefusal
from canopen_control.gateway.serving import ALLOW_MOTION, BusLog, GatewayService
from canopen_control.host import sockets
from canopen_control.host.signals import interrupt, on_signals
from canopen_control.rpc.messages.robot import Subscribe
from canopen_control.rpc.messages.state import RobotEvent

if TYPE_CHECKING:
    import argparse
    from collections.abc import Callable, Iterator

    from canopen_control.cia301.lss import LssMaster, LssRequest, LssResult
    from canopen_control.cia301.nmt import NmtCommand
    from canopen_control.commissioning.node_session import NodeSession


EXAMPLE = """canopen-control gateway
         canopen-control gateway --unix gateway.sock --allow-motion
         canopen-control gateway --can can0 --tcp 60000"""

LOOPBACK = "127.0.0.1"
MAX_TIMEOUT_S = 60.0  # longest timeout that a robot accepts for an SDO request
BACKLOG = 50
_OWNER_S = 1.0  # time between two checks for a robot on the bus
_TAKE_IN_S = 0.001  # time for receiving frames


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the options."""
    add_target_arguments(parser)
    where = parser.add_mutually_exclusive_group()
    where.add_argument("--stdio", action="store_true", help="serve standard input and output (default)")
    where.add_argument(
        "--unix", nargs="?", const="", metavar="PATH", help="serve a Unix socket; without PATH in your runtime folder"
    )
    where.add_argument(
        "--tcp", type=whole_number("port: 0 to 65535", range(65536)), metavar="PORT", help=f"serve {LOOPBACK}:PORT"
    )
    parser.add_argument(ALLOW_MOTION, action="store_true", help="allow NMT and writes that may move a drive")


def run(args: argparse.Namespace) -> int:
    """Run the verb until the end of its input or Ctrl-C."""
    with contextlib.suppress(KeyboardInterrupt), on_signals([signal.SIGTERM], interrupt), _network(args) as network:
        service = GatewayService(network, allow_motion=args.allow_motion)
        if args.unix is None and args.tcp is None:
            if sys.stdin is None or sys.stdout is None:
                raise ConfigError("standard input or output is closed; serve a socket with --unix")
            if not service.serve_stdio():
                raise CanopenError("standard input ended in the middle of a line, which was not carried out")
            return 0
        with _listening(args, network.label) as listener:
            service.serve_listener(listener)
    return 0


@contextlib.contextmanager
def _network(args: argparse.Namespace) -> Iterator[RobotNetwork | BusNetwork]:
    if args.can is None:
        with RobotTarget(RobotClient.connect(args.name)) as robot:
            yield RobotNetwork(robot)
    else:
        with BusTarget(args.can) as bus:
            yield BusNetwork(bus)


@contextlib.contextmanager
def _listening(args: argparse.Namespace, label: str) -> Iterator[socket.socket]:
    """Context in which the socket selected by the arguments listens; its address is printed at the start."""
    listener = _unix_listener(args.unix, label) if args.tcp is None else _tcp_listener(args.tcp)
    try:
        if args.tcp is None:
            place = listener.getsockname()
        else:
            place = f"{LOOPBACK}:{listener.getsockname()[1]}"
            motion = ", and move its drives" if args.allow_motion else ""
            warning = f"every user and program of this computer can reach {label} at {place}{motion}; --unix is private"
            print(f"canopen-control: warning: {warning}", file=sys.stderr)
        print(f"{label}: CiA 309-3 at {place}; Ctrl-C ends it", flush=True)
        yield listener
    finally:
        if args.tcp is None:
            sockets.close_listener(listener)
        listener.close()


def _unix_listener(path: str, label: str) -> socket.socket:
    place = Path(path).expanduser() if path else sockets.socket_path("gateway", re.sub(r"[^\w-]", "_", label)[-32:])
    if not place.parent.is_dir():
        raise ConfigError(f"no folder {place.parent} for the socket {place}")
    mode = place.parent.stat().st_mode
    if mode & 0o002 and not mode & 0o1000:
        raise ConfigError(f"every user may replace files in {place.parent}; choose another folder for the socket")
    try:
        listener = sockets.listen(place, BACKLOG, advice="choose another path")
        place.chmod(0o600)
    except OSError as error:
        raise ConfigError(f"{place} cannot be a socket: {error.strerror or error}; choose another path") from None
    return listener


def _tcp_listener(port: int) -> socket.socket:
    listener = socket.socket(socket.AF_INET, socket.SOCK_STREAM)
    try:
        listener.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        listener.bind((LOOPBACK, port))
        listener.listen(BACKLOG)
        listener.setblocking(False)
    except OSError as error:
        listener.close()
        raise CanopenError(f"port {port} of {LOOPBACK}: {error.strerror}; choose another one with --tcp") from None
    return listener


class RobotNetwork:
    """Access of the gateway to the nodes of a running robot; `label` names the robot."""

    def __init__(self, target: RobotTarget) -> None:
        self._target, self._robot = target, target.robot
        self.label = f"robot {self._robot.robot}"
        self._events = BusLog()
        self._robot.ask(Subscribe(events=True))

    def fileno(self) -> int:
        return self._robot.fileno()

    def take_in(self) -> None:
        for message in self._robot.messages(0):
            if isinstance(message, RobotEvent):
                where = f"{message.node}: " if message.node else ""
                self._events.add(f"{where}{message.text}")

    def read(self, node_id: int, index: int, subindex: int, *, block: bool, timeout_s: float) -> bytes:
        return self._node(node_id, timeout_s).read(index, subindex, block=block)

    def write(self, node_id: int, index: int, subindex: int, data: bytes, *, block: bool, timeout_s: float) -> None:  # noqa: ARG002 - the robot chooses by length
        self._node(node_id, timeout_s).write(index, subindex, data)

    def nmt(self, command: NmtCommand, node_id: int) -> None:
        """Send an NMT command through the robot; raise GatewayRefusal 204 if a node does not confirm it."""
        all_nodes = node_id == BROADCAST
        sessions = self._target.sessions if all_nodes else [self._node(node_id)]
        timeout = ROBOT_TIMEOUTS.get(command, NMT_TIMEOUT_S)
        if sessions and (waiting := self._target.command(command, sessions, timeout, all_nodes=all_nodes)[0]):
            names = ", ".join(map(str, waiting))
            expected = EXPECTED_STATE[command].name.replace("_", " ")
            raise GatewayRefusal(WRONG_NMT_STATE, f"{names}: {expected} is not shown within {timeout:g} s")

    def lss(self, ask: Callable[[LssMaster], LssRequest], scan_s: float | None = None) -> LssResult:  # noqa: ARG002 - refused
        """Refuse LSS, which would disturb the nodes of the robot."""
        advice = f"end it first: canopen-control shutdown --name {self._robot.robot}"
        raise GatewayRefusal(INTERNAL_STATE, f"LSS would disturb the nodes of {self.label}; {advice}")

    def log(self) -> list[str]:
        self.take_in()
        return self._events.take()

    def _node(self, node_id: int, timeout_s: float | None = None) -> NodeSession:
        try:
            node = self._target.session(str(node_id))
        except ConfigError as error:
            raise GatewayRefusal(UNSUPPORTED_NODE, str(error)) from None
        if timeout_s is not None:
            node.transfers.set_timeout(min(timeout_s, MAX_TIMEOUT_S))
        return node


class BusNetwork:
    """Access of the gateway to the nodes of a bus, except those of a running robot; `label` is the channel."""

    def __init__(self, target: BusTarget) -> None:
        self._target, self._bus = target, target.bus
        self._bus.retries = 0  # CiA 309-3: the timeout applies to a whole transfer
        self.label = self._bus.port.channel
        self._events = BusLog()
        self._bus.listeners.append(self._events)
        self._owner_checked_at = time.monotonic()

    def fileno(self) -> int:
        return self._bus.port.fileno()

    def take_in(self) -> None:
        try:
            self._bus.listen(_TAKE_IN_S)
        except BusClosed:
            raise
        except BusError as error:
            self._events.add(str(error))  # bus-off, or the interface is down: it may come back

    def read(self, node_id: int, index: int, subindex: int, *, block: bool, timeout_s: float) -> bytes:
        return self._node(node_id, timeout_s).read(index, subindex, block=block)

    def write(self, node_id: int, index: int, subindex: int, data: bytes, *, block: bool, timeout_s: float) -> None:
        """Download an object; with `block`, long data is sent by block transfer."""
        self._node(node_id, timeout_s)
        self._bus.write(node_id, index, subindex, data, block=None if block else False)

    def nmt(self, command: NmtCommand, node_id: int) -> None:
        """Send an NMT command without waiting for a confirmation."""
        if node_id != BROADCAST:
            self._node(node_id)
        else:
            self._refuse_while_robot_runs("NMT to all nodes")
        self._bus.command(command, node_id, 0.0)

    def lss(self, ask: Callable[[LssMaster], LssRequest], scan_s: float | None = None) -> LssResult:
        """Run an LSS service; raise GatewayRefusal while a robot runs on the bus."""
        self._refuse_while_robot_runs("LSS")
        return self._bus.lss(ask, scan_s)

    def log(self) -> list[str]:
        self.take_in()
        return self._events.take()

    def _node(self, node_id: int, timeout_s: float | None = None) -> NodeSession:
        self._find_robot()
        node = self._target.session(str(node_id))
        if timeout_s is not None:
            node.transfers.set_timeout(timeout_s)
        return node

    def _find_robot(self) -> None:
        now = time.monotonic()
        if now - self._owner_checked_at > _OWNER_S:
            self._owner_checked_at = now
            self._target.owner = robot_on(self.label)

    def _refuse_while_robot_runs(self, service: str) -> None:
        self._find_robot()
        if self._target.owner is not None:
            name = self._target.owner[0]
            raise GatewayRefusal(
                INTERNAL_STATE, f"{service} would disturb the nodes of robot {name}; use --name {name}"
            )
