"""Supervision of a robot's child processes: virtual drives, and clients such as the ROS bridge.

Every child has a lifeline to this process and its own session. After the robot has stopped, the clients are ended
first, then the drives. The unexpected end of a child is reported with its last output and does not end the robot.
Clients with a `Restarts` policy are restarted, but only a few times a minute: a child that fails repeatedly has a cause
that a restart does not remove, and its starts delay the robot's thread. Children that are started before the robot must
report that they are ready. If a client stops sending the required liveness reports while this process is on time, it
hangs or was suspended: it is killed, and its end is handled like any other.
"""

from __future__ import annotations

import shlex
from collections import deque
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Final, NamedTuple, Protocol

from canopen_control.bus.channel import may_host_virtual_drives, open_port, parse_channel
from canopen_control.errors import CanopenError
from canopen_control.host.environment import MODULE, lean_python
from canopen_control.host.files import state_dir
from canopen_control.host.spawn import end_children, spawn
from canopen_control.master.event_log import Event, Level
from canopen_control.runtime.physics_plant import write_buses
from canopen_control.runtime.setup import required_objects, unit_quirks
from canopen_control.virtual.plant import WORLD_NOTE

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping, Sequence

    from canopen_control.bus.port import Port
    from canopen_control.host.fork import Main
    from canopen_control.host.reactor import Reactor
    from canopen_control.host.spawn import Child
    from canopen_control.host.timer import Timer
    from canopen_control.master.config import BusConfig
    from canopen_control.master.remote_node import RemoteNode
    from canopen_control.od.model import Address
    from canopen_control.runtime.realtime import RealTime
    from canopen_control.runtime.setup import RobotSetup
    from canopen_control.virtual.node_host import NodeHost


MAX_RESTARTS: Final = 3  # maximum number of restarts of a child within the window
WINDOW_NS: Final = 60_000_000_000
DELAY_NS: Final = 500_000_000  # before each restart, so that resources of the ended process are released
_DRIVE = "drive-"
_FLIGHT: Final = "flight"
_NOTES = 50  # output lines of a drive process before it is ready
_USAGE, _ERROR_PREFIX = 2, "canopen-control: "  # exit code for wrong files, and prefix of the message
_READY_NS = 20_000_000_000  # time for drives to join the bus, even on a busy machine
_READY_EACH_NS = 500_000_000  # additional time per drive
_LISTENING_NS = 2_000_000_000  # for the recorder, without which the robot can start
_CHECK_NS = 1_000_000_000
_SILENCE_NS = 4_000_000_000  # timeout of a recorder that reports each second
_ANSWER_CHECK_NS = 250_000_000
_ON_TIME_NS = 50_000_000  # if later, this process was delayed too, and its children may have been
_ANSWER_NS = 3_000_000_000  # timeout of a client that answers twice a second
_FIRST_ANSWER_NS = 10_000_000_000  # for a client that starts, which takes a second
_BUSY_FACTOR = 4  # factor for these timeouts while the client runs or waits for a CPU
_GRACE_S = 5.0  # for a child to end by itself after SIGTERM
_RECORDER_MODULE: Final = "canopen_control.trace.flight"
_RECORDER = lean_python(_RECORDER_MODULE)
_VERBS: Final = "canopen_control"  # the module of the command line
_VERBS_MAIN: Final = "canopen_control.cli.main"


class SupervisedRun(Protocol):
    """Run of a robot, notified when all child processes are ready or one has failed."""

    def children_ready(self) -> None:
        """Start the robot; all child processes are ready."""
        ...

    def child_failed(self, text: str) -> None:
        """End the run because a child process failed; `text` is the reason."""
        ...


class _Restartable(NamedTuple):
    """Child process that is restarted when it ends: name, restart policy, and start function."""

    name: str
    restarts: Restarts
    start: Callable[[], None]


class Supervisor:
    """Supervisor of a robot's child processes; unexpected ends are reported to `report`.

    With `realtime`, the CPU binding of this process is undone for the children. `nodes` are the robot's nodes; when the
    process of their virtual drive has ended, their `restart_command` is the command that starts it again.
    """

    def __init__(
        self,
        name: str,
        reactor: Reactor,
        report: Callable[[Event], None],
        realtime: RealTime | None = None,
        nodes: Mapping[str, RemoteNode] | None = None,
    ) -> None:
        self._name, self._reactor, self._report = name, reactor, report
        self._realtime, self._nodes = realtime, nodes or {}
        self._drives: list[Child] = []
        # by child name: nodes, and the shell command that starts them
        self._drive_commands: dict[str, tuple[tuple[str, ...], str]] = {}
        self._world: tuple[Child, tuple[str, ...]] | None = None  # process of all drives, names of their nodes
        self.refused = False  # the drives refused their files
        self._clients: list[Child] = []
        self._recorder: Child | None = None
        self._hosts: list[tuple[NodeHost, Port]] = []
        self._awaited: dict[Child, Timer] = {}  # children that are not ready yet, and their deadlines
        self._run: SupervisedRun | None = None
        self._waiting = False  # whether `_run` waits for `children_ready`
        self._recorder_silent = False
        self._ending = self._over = False
        self._restartable: dict[Child, _Restartable] = {}
        self._like: list[str] = []
        self.missing: dict[str, str] = {}
        """Names of child processes that have ended unexpectedly, with the consequence, until restarted."""

    def start_drives(self, setup: RobotSetup, plant: Path | None = None, *, like: str = "") -> None:
        """Start virtual drives for all nodes in bus.yml, in child processes or, on an in-process bus, in this process.

        With a `plant` file, all drives run in one process, because they move the same simulated robot. `like` is the
        personality of the drives.
        """
        # absolute, so that the command that restarts a drive can be entered in any folder
        self._like = ["--like", _absolute(like)] if like else []
        if plant is not None:
            self._spawn_world(setup, plant)
            return
        for name, channel in setup.channels.items():
            if parse_channel(channel).kind.in_process:
                self._host_drives(setup.buses[name], channel)
            else:
                self._spawn_drives(setup.buses[name], channel)

    def start_client(
        self,
        name: str,
        arguments: Sequence[str],
        *,
        ros: bool = False,
        inherit_stdout: bool = False,
        answers: bool = False,
        restarts: Restarts | None = None,
        prepared: Child | None = None,
    ) -> None:
        """Start a client as `python -m ARGUMENTS`; with `restarts`, the client is restarted after its end.

        If `answers`, the client must send liveness reports repeatedly, and is killed if they stop. `prepared` is the
        process of this client if it has already been started and waits at its gate.
        """
        if prepared is None:
            child = self._start_module(arguments, name, ros=ros, inherit_stdout=inherit_stdout, reports=answers)
        else:
            child = self._supervised(prepared)
            child.open_gate()
        self._clients.append(child)
        self.missing.pop(name, None)
        if answers:
            child.watch_ready(self._reactor, lambda: None)
            self._watch_answers(child, Silence(self._reactor.now()))
        if restarts is not None:
            start = partial(self.start_client, name, arguments, ros=ros, inherit_stdout=inherit_stdout, answers=answers)
            self._restartable[child] = _Restartable(name, restarts, partial(start, restarts=restarts))

    def _watch_answers(self, child: Child, silence: Silence) -> None:
        """Kill a client that no longer sends liveness reports; check a live or busy client again later."""
        if child not in self._clients:
            return
        now = self._reactor.now()
        limit = _FIRST_ANSWER_NS if child.heard_at is None else _ANSWER_NS
        silent = silence.update(now, child.heard_at)
        if silent < limit or (silent < _BUSY_FACTOR * limit and child.is_busy()):
            self._reactor.call_later(_ANSWER_CHECK_NS, partial(self._watch_answers, child, silence))
            return
        text = f"process {child.name} (pid {child.pid}) has not answered for {silent / 1e9:.0f} s and is killed"
        why = "it hangs or was stopped"
        self._report(Event(now, "client_silent", "", f"{text}: {why}", Level.WARNING))
        child.kill()

    def _restart(self, name: str, restarts: Restarts, start_client: Callable[[], None]) -> None:
        """Report the end of a client, and schedule a restart if the policy permits."""

        def start() -> None:
            if self._over:
                return
            try:
                start_client()
            except CanopenError as error:
                self.missing[name] = str(error)
                self._report(Event(self._reactor.now(), "process_ended", "", str(error), Level.ERROR))

        text = restarts.died(self._reactor.now())
        self.missing[name] = f"{self.missing.get(name, 'it has ended')}; {text}"
        level = Level.ERROR if restarts.given_up else Level.WARNING
        self._report(Event(self._reactor.now(), "restart", "", f"process {name}: {text}", level))
        if not restarts.given_up:
            self._reactor.call_later(DELAY_NS, start)

    def start_recorder(self, buses: Mapping[str, str], restarts: Restarts | None = None) -> None:
        """Start the flight recorder on `buses` {name: channel}; a failure is only reported.

        With `restarts`, the recorder is restarted after its end.
        """
        options = ["--name", self._name, *(f"--bus={name}={channel}" for name, channel in buses.items())]
        try:
            self._recorder = self._start([*_RECORDER, *options], _FLIGHT, (_RECORDER_MODULE, options), reports=True)
        except CanopenError as error:
            text = f"nothing is recorded: {error}"
            self._report(Event(self._reactor.now(), "no_recorder", "", text, Level.WARNING))
        else:
            self._clients.append(self._recorder)
            self.missing.pop(_FLIGHT, None)
            self._recorder_silent = False
            if restarts is not None:
                start = partial(self.start_recorder, buses, restarts)
                self._restartable[self._recorder] = _Restartable(_FLIGHT, restarts, start)
            self._listen_to_recorder(self._recorder)

    def when_ready(self, run: SupervisedRun) -> None:
        """Call `run.children_ready` when all drives and the recorder are ready or have ended.

        If a drive is not ready in time, or the drives refuse their files, `run.child_failed` is called instead. A late
        recorder is reported and no longer awaited.
        """
        self._run, self._waiting = run, True
        drives_ns = _READY_NS + _READY_EACH_NS * len(self._drives)
        for child in [child for child in (*self._drives, self._recorder) if child is not None]:
            is_drive = child is not self._recorder
            on_timeout = (
                partial(self._fail_late, child, run) if is_drive else partial(self._continue_without_recorder, child)
            )
            self._awaited[child] = self._reactor.call_later(drives_ns if is_drive else _LISTENING_NS, on_timeout)
            child.watch_ready(self._reactor, partial(self._continue_without_ready, child))
        self._check_ready()

    def _continue_without_ready(self, child: Child) -> None:
        """Stop waiting for a child; if it simulates all drives, wait for its error message first."""
        if child.heard_at is not None or self._world is None or child is not self._world[0]:
            self._stop_waiting_for(child)

    def _stop_waiting_for(self, child: Child) -> None:
        timer = self._awaited.pop(child, None)
        if timer is not None:
            timer.cancel()
            if self._world is not None and child is self._world[0]:
                self._report_notes(child)
            self._check_ready()

    def _report_notes(self, child: Child) -> None:
        """Report the notes that the process of the drives has printed about the physics simulation."""
        for line in child.last_lines(_NOTES):
            if line.startswith(WORLD_NOTE):
                self._report(Event(self._reactor.now(), "physics", "", line.removeprefix(WORLD_NOTE)))

    def _check_ready(self) -> None:
        if not self._awaited and self._waiting and self._run is not None:
            self._waiting = False
            self._run.children_ready()

    def _fail_late(self, child: Child, run: SupervisedRun) -> None:
        """Fail the run because a drive process is not ready in time."""
        self._stop_waiting()
        seconds = (_READY_NS + _READY_EACH_NS * len(self._drives)) / 1e9
        last_output = " | ".join(child.last_lines()[-3:]) or "nothing yet"
        run.child_failed(
            f"process {child.name} (pid {child.pid}) was not ready within {seconds:g} s; its last output: "
            f"{last_output}; is the machine too busy?"
        )

    def _continue_without_recorder(self, child: Child) -> None:
        text = "the flight recorder is not ready; events before it is ready are not recorded"
        self._report(Event(self._reactor.now(), "no_recorder", "", text, Level.WARNING))
        self._stop_waiting_for(child)

    def _stop_waiting(self) -> None:
        self._waiting = False
        for timer in self._awaited.values():
            timer.cancel()
        self._awaited.clear()

    def _listen_to_recorder(self, child: Child) -> None:
        """Report when the recorder stops responding, and when it continues."""
        if child not in self._clients:
            return
        now = self._reactor.now()
        silent = child.heard_at is not None and now - child.heard_at > _SILENCE_NS
        if silent is not self._recorder_silent:
            self._recorder_silent = silent
            process = f"process {child.name} (pid {child.pid})"
            text = f"{process} is silent: it hangs or was stopped, and nothing is recorded"
            event = Event(now, "recorder_silent", "", text, Level.WARNING)
            self._report(event if silent else Event(now, "recorder_back", "", f"{process} records again"))
        self._reactor.call_later(_CHECK_NS, partial(self._listen_to_recorder, child))

    def end_clients(self) -> None:
        """End the client processes and do not restart them; a second call does nothing."""
        self._over = True
        self._end(self._clients)

    def end(self) -> None:
        """End all child processes, clients before drives; blocks for a few seconds at most."""
        self._stop_waiting()
        self.end_clients()
        if self._recorder is not None:  # the API is closed, so the last lines of the recorder are reported here
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
    def driven(self) -> list[str]:
        """Names of the nodes with a virtual drive in a child process."""
        if self._world is not None and self._world[0] in self._drives:
            return list(self._world[1])
        return [child.name.removeprefix(_DRIVE) for child in self._drives]

    @property
    def pids(self) -> dict[str, int]:
        """Process ids of the child processes, by name."""
        return {child.name: child.pid for child in (*self._drives, *self._clients)}

    def _spawn_drives(self, bus: BusConfig, channel: str) -> None:
        for node in bus.nodes.values():
            eds = bus.eds_paths[node.name].resolve()
            arguments = [
                "canopen_control",
                "drive",
                "--node-id",
                str(node.node_id),
                "--eds",
                str(eds),
                "--can",
                channel,
                *self._like,
                *(f"--quirk={quirk}" for quirk in unit_quirks(bus, node.name)),
                *(f"--object={words}" for words in _words(required_objects(bus, node.name))),
            ]
            self._start_drives(arguments, f"{_DRIVE}{node.name}", (node.name,))

    def _spawn_world(self, setup: RobotSetup, plant: Path) -> None:
        """Start all virtual drives of a robot in one process, which simulates the robot from the file `plant`."""
        nodes = [(bus, node) for bus in setup.buses.values() for node in bus.nodes.values()]
        if len(setup.buses) > 1:
            arguments = ["canopen_control", "drive", "--buses", str(write_buses(plant.parent, [(setup, plant)]))]
        else:
            ids = ",".join(str(number) for number in sorted(node.node_id for _, node in nodes))
            (channel,) = setup.channels.values()
            arguments = ["canopen_control", "drive", "--node-id", ids, "--can", channel, "--plant", str(plant)]
            for bus, node in nodes:
                arguments += ["--eds", f"{node.node_id}={bus.eds_paths[node.name].resolve()}"]
                objects = _words(required_objects(bus, node.name))
                arguments += [f"--object={node.node_id}={words}" for words in objects]
        quirks = {tuple(unit_quirks(bus, node.name)) for bus, node in nodes}
        if len(quirks) == 1:  # the process applies its quirks to all of its drives
            arguments += [f"--quirk={quirk}" for quirk in quirks.pop()]
        names = tuple(node.name for _, node in nodes)
        self._world = self._start_drives([*arguments, *self._like], "drives", names), names

    def _start_drives(self, arguments: Sequence[str], name: str, nodes: tuple[str, ...]) -> Child:
        """Start a process of virtual drives for `nodes`, and store the shell command that starts the process again."""
        self._drive_commands[name] = nodes, shlex.join(["canopen-control", *arguments[1:]])
        child = self._start_module(arguments, name, reports=True)
        self._drives.append(child)
        return child

    def node_ready(self, name: str) -> None:
        """Discard the advice to start a virtual drive again, because its node has returned."""
        if name in self._nodes and self._nodes[name].restart_command:
            for child, (nodes, _) in self._drive_commands.items():
                if name in nodes:
                    self._nodes[name].restart_command = ""
                    self.missing.pop(child, None)

    def _host_drives(self, bus: BusConfig, channel: str) -> None:
        from canopen_control.personality import read_personality
        from canopen_control.virtual.device import make_device
        from canopen_control.virtual.node_host import NodeHost

        like = read_personality(self._like[1]) if self._like else None

        for node in bus.nodes.values():
            port = open_port(channel, label=f"drive {node.node_id}")
            quirks, objects = unit_quirks(bus, node.name), required_objects(bus, node.name)
            device = make_device(bus.eds_paths[node.name], node.node_id, quirks=quirks, like=like, objects=objects)
            self._hosts.append((NodeHost(self._reactor, port, [device]), port))

    def _start_module(
        self,
        arguments: Sequence[str],
        name: str,
        *,
        ros: bool = False,
        inherit_stdout: bool = False,
        reports: bool = False,
    ) -> Child:
        """Start `python -m ARGUMENTS` as a child process."""
        module, *rest = arguments
        main = (_VERBS_MAIN, rest) if module == _VERBS else None
        return self._start([*MODULE, *arguments], name, main, ros=ros, inherit_stdout=inherit_stdout, reports=reports)

    def _start(
        self,
        argv: Sequence[str],
        name: str,
        main: Main | None,
        *,
        ros: bool = False,
        inherit_stdout: bool = False,
        reports: bool = False,
    ) -> Child:
        """Start a child process with `argv`, or, before any bus is joined, by a fork that runs `main`."""
        log_dir = None if inherit_stdout else state_dir(self._name)
        child = spawn(
            argv,
            name=name,
            log_dir=log_dir,
            ros=ros,
            inherit_stdout=inherit_stdout,
            reports=reports,
            main=main if self._run is None else None,
        )
        return self._supervised(child)

    def _supervised(self, child: Child) -> Child:
        """Watch a child process for its end, and remove the inherited processor binding."""
        if self._realtime is not None:
            self._realtime.release(child.pid)
        child.watch(self._reactor, lambda returncode, lines: self._on_exit(child, returncode, lines))
        return child

    def _on_exit(self, child: Child, returncode: int, lines: list[str]) -> None:
        """Report the unexpected end of a child process, and restart it if the policy permits."""
        if self._ending or child not in (*self._drives, *self._clients):
            return
        child.unwatch_ready(self._reactor)
        for children in (self._drives, self._clients):
            if child in children:
                children.remove(child)
        outcome = f"was ended by signal {-returncode}" if returncode < 0 else f"ended with exit code {returncode}"
        last_output = f"; its last output: {' | '.join(lines[-3:])}" if lines else ""
        if returncode == _USAGE and child in self._awaited and self._world is not None and child is self._world[0]:
            self.refused = True
            self._stop_waiting()
            text = "\n".join(line.removeprefix(_ERROR_PREFIX) for line in lines if not line.startswith(WORLD_NOTE))
            if self._run is not None:
                self._run.child_failed(text)
            return
        nodes, command = self._drive_commands.get(child.name, ((), ""))
        for name in nodes:
            if name in self._nodes:
                self._nodes[name].restart_command = command
        again = f"; start it again: {command}" if command else ""
        text = f"process {child.name} (pid {child.pid}) {outcome}{last_output}{again}"
        self._report(Event(self._reactor.now(), "process_ended", "", text, Level.ERROR))
        self.missing[child.name] = f"{outcome}{again}"
        self._stop_waiting_for(child)
        restartable = self._restartable.pop(child, None)
        if restartable is not None and not self._over:
            self._restart(*restartable)

    def _end(self, children: list[Child]) -> None:
        self._ending = True
        end_children(children, self._reactor, _GRACE_S)
        children.clear()
        self._ending = False


def hosts_virtual_drives(setup: RobotSetup) -> bool:
    """Whether virtual drives may be started on all buses of a robot, because no channel has real drives."""
    return all(may_host_virtual_drives(channel) for channel in setup.channels.values())


class Silence:
    """Duration of a child's silence, counted only while this process runs on time; times are in monotonic ns."""

    def __init__(self, now: int) -> None:
        self._checked_at, self._heard_at = now, -1
        self._duration = 0

    def update(self, now: int, heard_at: int | None) -> int:
        """Return the silence in ns; `heard_at` is the time of the last report. Call this every `_ANSWER_CHECK_NS`."""
        since, self._checked_at = now - self._checked_at, now
        if heard_at is not None and heard_at != self._heard_at:
            self._heard_at, self._duration = heard_at, 0
        elif since <= _ANSWER_CHECK_NS + _ON_TIME_NS:
            self._duration += since
        return self._duration


class Restarts:
    """Restart policy of a child process; `given_up` is set after too many restarts, times are in monotonic ns."""

    def __init__(self) -> None:
        self.given_up = False
        self._times: deque[int] = deque(maxlen=MAX_RESTARTS)

    def died(self, now: int) -> str:
        """Count an unexpected end; return the restart decision as text, and set `given_up` if there is no restart."""
        if len(self._times) == MAX_RESTARTS and now - self._times[0] < WINDOW_NS:
            self.given_up = True
            return f"it is not restarted, because it was restarted {MAX_RESTARTS} times within a minute"
        self._times.append(now)
        recent = sum(now - time_ns < WINDOW_NS for time_ns in self._times)
        return f"it is restarted ({recent} of {MAX_RESTARTS} times a minute)"


def _words(objects: Mapping[Address, int]) -> list[str]:
    """Return values of objects in the form of `drive --object`."""
    return [f"0x{index:04X}:{subindex:02X}=0x{value:X}" for (index, subindex), value in objects.items()]


def _absolute(like: str) -> str:
    """Return the name of a bundled personality, or the absolute path of a file."""
    from canopen_control.personality import personality_names

    return like if like in personality_names() else str(Path(like).resolve())
