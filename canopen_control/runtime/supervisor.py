"""The processes around a robot: virtual drives, and clients such as the ROS bridge.

The law of this file: every child hangs on a lifeline of this process, lives in a session of its own, and is ended here
in order: clients first, drives last, when the robot has stopped. A child that dies is told with the last lines it said;
it never ends the robot.
"""

from __future__ import annotations

import sys
from pathlib import Path
from typing import TYPE_CHECKING

from canopen_control.bus.channel import may_host_virtual_drives, open_port, parse_channel
from canopen_control.errors import CanopenError
from canopen_control.host.environment import MODULE
from canopen_control.host.spawn import spawn, state_dir
from canopen_control.master.events import Event, Level

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping, Sequence

    from canopen_control.bus.port import Port
    from canopen_control.host.reactor import Reactor
    from canopen_control.host.spawn import Child
    from canopen_control.master.config import BusConfig
    from canopen_control.runtime.setup import RobotSetup
    from canopen_control.virtual.nodehost import NodeHost

__all__ = ["Supervisor"]

_GRACE_S = 5.0  # for a child to end by itself after SIGTERM
#: a Python that needs nothing but the package's own folder starts in half the time
_LEAN = (sys.executable, "-I", "-S", "-c")
_RECORDER = (
    f"import sys; sys.path.insert(0, {str(Path(__file__).parents[2])!r}); "
    "from canopen_control.trace.flight import main; sys.exit(main())"
)


class Supervisor:
    """Starts and ends the children of one robot; `report` is told when one dies unasked, `on_started` each pid."""

    def __init__(self, name: str, reactor: Reactor, report: Callable[[Event], None]) -> None:
        self._name, self._reactor, self._report = name, reactor, report
        self.on_started: Callable[[int], None] = lambda _pid: None
        self._drives: list[Child] = []
        self._clients: list[Child] = []
        self._recorder: Child | None = None
        self._hosts: list[tuple[NodeHost, Port]] = []
        self._ending = False

    def start_drives(self, setup: RobotSetup) -> None:
        """Start a virtual drive for every node of bus.yml: a process each, or inside this one where the bus is."""
        for name, channel in setup.channels.items():
            if parse_channel(channel).kind.in_process:
                self._host_drives(setup.buses[name], channel)
            else:
                self._spawn_drives(setup.buses[name], channel)

    def start_client(
        self, name: str, arguments: Sequence[str], *, ros: bool = False, inherit_stdout: bool = False
    ) -> None:
        """Start a client: `python -m ARGUMENTS`."""
        self._clients.append(self._spawn(name, arguments, ros=ros, inherit_stdout=inherit_stdout))

    def start_recorder(self, buses: Mapping[str, str]) -> None:
        """Start the flight recorder, which listens on `buses` {name: channel}; without it the robot runs as well."""
        options = ["--name", self._name, *(f"--bus={name}={channel}" for name, channel in buses.items())]
        try:
            self._recorder = self._start([*_LEAN, _RECORDER, *options], "flight")
        except CanopenError as error:
            self._report(Event(self._reactor.now(), "no_recorder", "", str(error), Level.WARNING))
        else:
            self._clients.append(self._recorder)

    def end_clients(self) -> None:
        """End the clients; a second call does nothing."""
        self._end(self._clients)

    def end(self) -> None:
        """End everything: clients, then drives; blocks for a few seconds at most, when the robot has stopped."""
        self.end_clients()
        if self._recorder is not None:  # nobody serves the API any more: what it wrote last is told for it
            for line in self._recorder.last_lines():
                if "flight record" in line:
                    self._report(Event(self._reactor.now(), "flight", "", line))
            self._recorder = None
        self._end(self._drives)
        for host, port in self._hosts:
            host.close()
            port.close()
        self._hosts.clear()

    @property
    def pids(self) -> dict[str, int]:
        """The process ids of the children by name."""
        return {child.name: child.pid for child in (*self._drives, *self._clients)}

    def _spawn_drives(self, bus: BusConfig, channel: str) -> None:
        for node in bus.nodes.values():
            eds = bus.eds_paths[node.name]
            arguments = [
                "canopen_control",
                "drive",
                "--node-id",
                str(node.node_id),
                "--eds",
                str(eds),
                "--can",
                channel,
            ]
            self._drives.append(self._spawn(f"drive-{node.name}", arguments))

    def _host_drives(self, bus: BusConfig, channel: str) -> None:
        from canopen_control.virtual.device import make_device
        from canopen_control.virtual.nodehost import NodeHost

        for node in bus.nodes.values():
            port = open_port(channel, label=f"drive {node.node_id}")
            device = make_device(bus.eds_paths[node.name], node.node_id)
            self._hosts.append((NodeHost(self._reactor, port, [device]), port))

    def _spawn(self, name: str, arguments: Sequence[str], *, ros: bool = False, inherit_stdout: bool = False) -> Child:
        return self._start([*MODULE, *arguments], name, ros=ros, inherit_stdout=inherit_stdout)

    def _start(self, argv: Sequence[str], name: str, *, ros: bool = False, inherit_stdout: bool = False) -> Child:
        log_dir = None if inherit_stdout else state_dir(self._name)
        child = spawn(argv, name=name, log_dir=log_dir, ros=ros, inherit_stdout=inherit_stdout)
        self.on_started(child.pid)
        child.watch(self._reactor, lambda returncode, lines: self._on_exit(child, returncode, lines))
        return child

    def _on_exit(self, child: Child, returncode: int, lines: list[str]) -> None:
        """Tell the death of a child; what it means for the robot shows on the bus or in a command that times out."""
        if self._ending or child not in (*self._drives, *self._clients):
            return
        for children in (self._drives, self._clients):
            if child in children:
                children.remove(child)
        how = f"was ended by signal {-returncode}" if returncode < 0 else f"ended with exit code {returncode}"
        said = f"; it said: {' | '.join(lines[-3:])}" if lines else ""
        text = f"process {child.name} (pid {child.pid}) {how}{said}"
        self._report(Event(self._reactor.now(), "process_ended", "", text, Level.ERROR))

    def _end(self, children: list[Child]) -> None:
        self._ending = True
        for child in children:
            child.unwatch()
            child.terminate()
        for child in children:
            if child.wait(_GRACE_S) is None:
                child.kill()
                child.wait(_GRACE_S)
        children.clear()
        self._ending = False


def hosts_virtual_drives(setup: RobotSetup) -> bool:
    """Whether all buses of the robot are of the kinds that no real drive can be on."""
    return all(may_host_virtual_drives(channel) for channel in setup.channels.values())
