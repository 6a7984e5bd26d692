"""Socket of a simulated robot, to which programs connect as they would to a running robot.

Their requests reach the robot's own server at the end of a slice of virtual time; the answers are sent after the next
slice. The simulation is paced to real time. The player's observers are informed of the requests. With other programs
simulations are not reproducible. A killed robot closes the connections, and accepts new ones after its restart.
"""

from __future__ import annotations

import contextlib
import time
from typing import TYPE_CHECKING, Final

from canopen_control.errors import RobotConfigError
from canopen_control.host.reactor import Reactor
from canopen_control.host.sockets import SocketInUse, close_listener, listen, peer_pid, same_user, socket_path
from canopen_control.runtime.supervisor import Restarts, Supervisor
from canopen_control.simulation.motions import motions_of
from canopen_control.simulation.recorded_scenario import RequestActs
from canopen_control.simulation.simulated_clients import SimulatedClient

if TYPE_CHECKING:
    import socket
    from collections.abc import Sequence

    from canopen_control.rpc.messages.robot import RequestSeen
    from canopen_control.simulation.event_player import EventPlayer
    from canopen_control.simulation.simulated_clients import SimulatedClients


_CHUNK: Final = 1 << 16
_MAX: Final = 1 << 20  # limit of the bytes that wait for a program; a slower program is disconnected


class OutsideClient(SimulatedClient):
    """Real connection of a program outside the simulation."""

    def __init__(self, clients: SimulatedClients, sock: socket.socket, front: Reactor) -> None:
        super().__init__(clients, clients.robot.host, reads=True, pid=peer_pid(sock))
        self._sock, self._front = sock, front
        self._answers = bytearray()
        sock.setblocking(False)
        front.add_reader(sock, self._on_readable)

    def take(self, data: bytes) -> int:
        """Buffer data from the robot until `flush` at the end of the time slice; return their length."""
        self._answers += data
        return len(data)

    def flush(self) -> None:
        """Send the buffered data; disconnect a program that is gone or reads too slowly."""
        while self._answers:
            try:
                sent = self._sock.send(self._answers)
            except BlockingIOError:
                break
            except OSError:
                self._gone()
                return
            del self._answers[:sent]
        if len(self._answers) > _MAX:
            self._gone()

    def close(self) -> None:
        if self._sock.fileno() >= 0:
            self._front.remove_reader(self._sock)
            self._sock.close()

    def _gone(self) -> None:
        self.close()
        self.leave()

    def _on_readable(self) -> None:
        try:
            data = self._sock.recv(_CHUNK)
        except BlockingIOError:
            return
        except OSError:
            data = b""
        if not data:
            self._gone()
            return
        self.end.inbox += data
        self.end.arrived()


class ServedSimulation:
    """Server that connects other programs to a player's robot; raises RobotConfigError if the socket is in use.

    Requests are received and answers sent during `wait`, which follows each `slice_ns` of virtual time.
    """

    slice_ns: Final = 5_000_000

    def __init__(self, player: EventPlayer) -> None:
        self._player, self._clients = player, player.clients
        self._requests = RequestActs(motions_of(player.robot.setup))
        self._here: list[OutsideClient] = []
        self._held = contextlib.ExitStack()
        self._front = Reactor()
        self._held.callback(self._front.close)
        name = player.robot.setup.name
        try:
            self._socket = listen(socket_path("robot", name))
        except SocketInUse as error:
            self._held.close()
            owner = f" (process {error.pid})" if error.pid else ""
            raise RobotConfigError(
                f"a robot named {name} is already running{owner}; stop it, or choose another name with --as"
            ) from error
        self._held.callback(close_listener, self._socket)
        self._front.add_reader(self._socket, self._on_connection)
        self._clients.observer = self
        player.robot.reports_virtual_time = player.robot.core.in_virtual_time = True

    def start_bridge(self, arguments: Sequence[str]) -> None:
        """Start the ROS bridge as a client of the robot; `close` ends it."""
        robot = self._player.robot
        supervisor = Supervisor(robot.setup.name, self._front, lambda event: robot.core.report(event))
        self._held.callback(supervisor.end)
        bridge = ["canopen_control.ros.bridge", "--name", robot.setup.name, *arguments]
        supervisor.start_client("ros", bridge, ros=True, restarts=Restarts())

    def wait(self, seconds: float) -> None:
        """Exchange data with the programs for `seconds` of real time."""
        for client in self._here:
            client.flush()
            if client.dropped or not self._clients.serves(client):
                client.close()
        self._here = [
            client for client in self._here if client.here and self._clients.serves(client) and not client.dropped
        ]
        self._front.run_for(round(seconds * 1e9))

    def run(self, duration_ns: int, speed: float = 1.0) -> None:
        """Advance virtual time at most `speed` times as fast as real time, and serve the programs meanwhile."""
        robot, begun, passed = self._player.robot, time.perf_counter(), 0
        while passed < duration_ns:
            step = min(self.slice_ns, duration_ns - passed)
            robot.run_for(step)
            passed += step
            self.wait(max(0.0, passed / 1e9 / speed - (time.perf_counter() - begun)))

    def close(self) -> None:
        for client in self._here:
            client.flush()
            client.close()
        self._here.clear()
        self._held.close()

    def _on_connection(self) -> None:
        try:
            sock, _ = self._socket.accept()
        except OSError:
            return
        if not self._player.robot.up or not same_user(sock):
            sock.close()
            return
        self._here.append(self._clients.admit(OutsideClient(self._clients, sock, self._front)))

    def requested(self, record: RequestSeen) -> None:
        """Notify the player's observers of a request by a program."""
        for act in self._requests.acts(record):
            self._player.requested(act)
