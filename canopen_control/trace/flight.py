"""Flight recorder: process that keeps the last minute of a robot in memory and writes it to a file after a fault.

``python -m canopen_control.trace.flight --name ROBOT --bus NAME=CHANNEL ...``

The process only listens, on the buses and on the robot's API, and sends nothing on a bus. While recording it decodes
nothing; frames remain records, with one append per read. It never delays the robot, because it is a separate process,
and a forked copy of it writes the file from the memory of that moment while the original continues to record. The
process ends with the robot: on SIGTERM it writes the pending file. If the robot's process was killed, which is a fault
too, it records until the drives have reacted, writes the file, and ends. Its end does not affect other processes.
"""

from __future__ import annotations

import argparse
import contextlib
import os
import signal
import sys
import time
from typing import TYPE_CHECKING, Final

from canopen_control.bus.channel import open_port, parse_channel
from canopen_control.bus.port_abilities import Arrivals
from canopen_control.client.drive_client import shapes_of_world
from canopen_control.client.robot_client import RobotClient
from canopen_control.errors import BusError, CanopenError
from canopen_control.host.files import state_dir
from canopen_control.host.lifeline import LivenessReport, lifeline_fd
from canopen_control.host.reactor import Reactor
from canopen_control.rpc.messages.layout import Layout
from canopen_control.rpc.messages.robot import GetLayout, GetStatus, PublishEvent, RequestSeen, Subscribe
from canopen_control.rpc.messages.state import RobotEvent, StateSample
from canopen_control.rpc.wire import text_of
from canopen_control.trace.flight_file import AFTER_NS, FrameRing, LineRing, RecordingTrigger, is_fault, is_sum

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping, Sequence
    from pathlib import Path

    from canopen_control.bus.port import Port
    from canopen_control.host.timer import Timer
    from canopen_control.rpc.messages.drive import WorldShape
    from canopen_control.rpc.messages.robot import RobotPush
    from canopen_control.rpc.messages.state import Status


SECOND: Final = 1_000_000_000
WINDOW_NS: Final = 60 * SECOND
STATE_RATE: Final = 10.0  # Hz; frames contain every cycle
FRAME_BYTES, STATE_BYTES, EVENT_BYTES = 16 << 20, 16 << 20, 1 << 20
_AGAIN_NS: Final = SECOND
_PULSE_NS: Final = SECOND
_TIMEOUT_S: Final = 2.0  # timeout of a request; meanwhile frames wait in the kernel
_NICENESS: Final = 5  # the robot takes precedence


def flight_folder(name: str) -> Path:
    """Return the folder for the recordings of the robot `name`."""
    return state_dir(name) / "flight"


class FlightRecorder:
    """Recorder of the robot `name` on `buses` {name: channel}, run by a reactor; call `finish` at the end.

    `unsent` contains the messages that could not be sent because the robot had ended.
    """

    def __init__(self, reactor: Reactor, name: str, buses: Mapping[str, str]) -> None:
        self.name, self.buses = name, dict(buses)
        self.unsent: list[str] = []
        self._reactor = reactor
        self._begun_ns = time.time_ns() - reactor.now()
        self._frames = FrameRing(WINDOW_NS, FRAME_BYTES)
        self._states = LineRing(WINDOW_NS, STATE_BYTES)
        self._events = LineRing(None, EVENT_BYTES)
        self._requests = LineRing(WINDOW_NS, STATE_BYTES)
        self._trigger = RecordingTrigger(WINDOW_NS - 5 * SECOND)
        self._timer: Timer | None = None
        self._ports: dict[str, Port] = {}
        self._robot: RobotClient | None = None
        self._status: Status | None = None
        self._layout = Layout()
        self._world: tuple[WorldShape, ...] = ()
        self._repeated: set[bytes] = set()
        self._writer: tuple[int, int] | None = None  # process id and pipe of the writing copy
        self._finished = False
        self._liveness = LivenessReport()

    @property
    def _wall_offset_ns(self) -> int:
        """Offset in ns from the reactor's time to Unix time, according to the current system clock.

        Times are therefore right even if the recorder was started before the clock was set, as at a boot without a
        battery.
        """
        return self._begun_ns if self._reactor.clock.is_manual else time.time_ns() - self._reactor.now()

    def start(self) -> None:
        """Start recording; a bus that cannot be opened is omitted and noted in the file."""
        for number, (bus, channel) in enumerate(self.buses.items()):
            # other channels are inside one process, or have one owner
            if parse_channel(channel).kind.shared:
                self._open(number, bus, channel)
        self._beat()
        self._connect()

    def _beat(self) -> None:
        """Report to the parent process once a second that this process is running."""
        self._liveness.beat()
        self._reactor.call_later(_PULSE_NS, self._beat)

    # -- listening

    def _open(self, number: int, bus: str, channel: str) -> None:
        try:
            port = open_port(channel, label="flight recorder")
        except CanopenError as error:
            print(error, flush=True)  # noqa: T201 - the log of this process
            return
        self._ports[bus] = port
        arrivals = Arrivals(port, self._reactor.now)

        def receive() -> None:
            try:
                self._take_frames(number, arrivals)
            except BusError:
                self._reactor.remove_reader(port.fileno())
                port.close()

        self._reactor.add_reader(port.fileno(), receive)

    def _take_frames(self, number: int, arrivals: Arrivals) -> None:
        """Record frames with their arrival times, which are correct even if a busy computer reads many frames late."""
        records, stamps = arrivals.receive()
        if records:
            self._frames.add(number, records, stamps)

    def _connect(self) -> None:
        if self._finished:
            return
        try:
            robot = RobotClient.connect(self.name, timeout=_TIMEOUT_S)
        except CanopenError:  # not yet running, ended, or busy
            self._reactor.call_later(_AGAIN_NS, self._connect)
            return
        self._robot = robot
        try:
            robot.ask(Subscribe(state_rate=STATE_RATE, events=True, requests=True))
            self._layout = robot.ask(GetLayout())
            self._status = status = robot.ask(GetStatus())
            self._record_world()
        except CanopenError:
            self._disconnect()
            return
        self._take_earlier_events(status)
        self._reactor.add_reader(robot.fileno(), self._read)
        self._reactor.call_soon(self._read)  # frames received while the requests were answered

    def _take_earlier_events(self, status: Status) -> None:
        """Record events from before this process started; the stream may repeat these events."""
        lines = set(self._events.lines())
        self._repeated = {text_of(event) for event in status.events}
        for event in status.events:
            if text_of(event) not in lines:
                self._on_event(event)

    def _refresh(self) -> None:
        """Request the robot's status and the world of its virtual drives for the next file."""
        self._record_world()
        if self._robot is not None:
            with contextlib.suppress(CanopenError):
                self._status = self._robot.ask(GetStatus())

    def _record_world(self) -> None:
        """Record the world of the virtual drives; without a reply, keep the last known world."""
        nodes = [(self.buses[bus], node.node_id) for bus, layout in self._layout.buses.items() if bus in self.buses
                 for node in layout.nodes]  # fmt: skip
        self._world = shapes_of_world(nodes) or self._world

    def _disconnect(self) -> None:
        if self._robot is not None:
            self._reactor.remove_reader(self._robot.fileno())
            self._robot.close()
            self._robot = None
            self._reactor.call_later(_AGAIN_NS, self._connect)

    def _read(self) -> None:
        if self._robot is None:
            return
        try:
            for message in self._robot.messages(0):
                self._take(message)
        except CanopenError:
            self._disconnect()

    def _take(self, message: RobotPush) -> None:
        if isinstance(message, StateSample):
            self._states.add(text_of(message), self._reactor.now())
        elif isinstance(message, RequestSeen):
            self._requests.add(text_of(message), self._reactor.now())
        elif isinstance(message, RobotEvent) and text_of(message) not in self._repeated:
            self._on_event(message)

    def _on_event(self, event: RobotEvent) -> None:
        now = self._reactor.now()
        self._events.add(text_of(event), now)
        if is_fault(event) and not is_sum(event):
            self._trigger.fault(event, now)
            self._plan()

    # -- writing

    def _plan(self) -> None:
        deadline = self._trigger.next_deadline()
        if self._timer is not None:
            self._timer.cancel()
        self._timer = None if deadline is None else self._reactor.call_at(deadline, self._check_trigger)

    def _check_trigger(self) -> None:
        if self._writer is None:
            reason = self._trigger.due(self._reactor.now())
            if reason is not None:
                self._refresh()
                self._write_aside(reason)
            self._plan()

    def _write_aside(self, reason: RobotEvent) -> None:
        """Write the file in a forked copy of this process; its result is reported to the robot later."""
        ours, theirs = os.pipe()
        child = os.fork()
        if child == 0:
            try:
                os.nice(_NICENESS)  # lower its priority again: listening takes precedence over writing
                os.write(theirs, self.write(reason).encode())
            finally:
                os._exit(0)  # the copy must end here in every case
        os.close(theirs)
        self._writer = (child, ours)
        self._reactor.add_reader(ours, self._on_written)

    def _on_written(self) -> None:
        if self._writer is None:
            return
        child, pipe = self._writer
        sentence = os.read(pipe, 4096).decode(errors="replace")
        self._reactor.remove_reader(pipe)
        os.close(pipe)
        os.waitpid(child, 0)
        self._writer = None
        self._send_event(sentence or "the flight recorder could not write: its writing process died")
        self._plan()

    def write(self, reason: RobotEvent) -> str:
        """Write the file in this process; return a sentence with the path, or with the reason for a failure."""
        from canopen_control.trace.flight_file import FlightMeta, candump_lines, save

        now, offset = self._reactor.now(), self._wall_offset_ns
        since = now - WINDOW_NS
        meta = FlightMeta(
            robot=self.name,
            reason=reason,
            written=(now + offset) / 1e9,
            begin=(since + offset) / 1e9,
            buses=self.buses,
            unheard=tuple(bus for bus in self.buses if bus not in self._ports),
            frames_lost=sum(port.stats.lost for port in self._ports.values()),
            faults_left_out=self._trigger.left_out,
            layout=self._layout,
            status=self._status,
            world=self._world,
        )
        can = candump_lines(self._frames.frames(since), list(self.buses), offset)
        try:
            lines = self._events.lines(), self._states.lines(since), self._requests.lines(since)
            path = save(flight_folder(self.name), meta, can, *lines)
        except (CanopenError, OSError, ValueError) as error:
            return f"the flight recorder could not write a file about this fault: {error}"
        return f"flight recording: {path} (show it with canopen-control report)"

    def _send_event(self, sentence: str) -> None:
        """Send a text to the robot as an event, or add it to `unsent` if the robot has ended."""
        if self._robot is not None:
            with contextlib.suppress(CanopenError):
                self._robot.notify(PublishEvent(kind="flight", text=sentence))
                return
        self.unsent.append(sentence)

    # -- end

    def orphaned(self, ended: Callable[[], object]) -> None:
        """Record the death of the robot's process as a fault; call `ended` after the drives have had time to react."""
        now = self._reactor.now()
        text = "the process of the robot has died; its drives stop by themselves"
        died = (now + self._wall_offset_ns) / 1e9
        self._on_event(RobotEvent(time=died, kind="died", node=None, level="error", text=text))
        self._reactor.call_at(now + AFTER_NS, ended)

    def finish(self) -> None:
        """Write the pending file, if any, and close everything; a second call has no effect."""
        if self._finished:
            return
        self._finished = True
        self._read()
        if self._writer is not None:
            self._on_written()
        reason = self._trigger.end(self._reactor.now())
        if reason is not None:
            self._send_event(self.write(reason))
        self._disconnect()
        for port in self._ports.values():
            port.close()


def main(arguments: Sequence[str] | None = None) -> int:
    """Record the robot named in the arguments until it ends; return the exit code 0."""
    parser = argparse.ArgumentParser(prog="canopen_control.trace.flight", description=(__doc__ or "").split("\n\n")[0])
    parser.add_argument("--name", required=True, help="the robot")
    parser.add_argument("--bus", action="append", default=[], metavar="NAME=CHANNEL", help="a bus to listen to")
    args = parser.parse_args(arguments)
    with Reactor() as reactor:
        recorder = FlightRecorder(reactor, args.name, dict(bus.split("=", 1) for bus in args.bus))
        reactor.handle_signals({signal.SIGTERM: reactor.stop, signal.SIGINT: reactor.stop})
        lifeline = lifeline_fd()
        if lifeline is not None:
            reactor.add_reader(lifeline, lambda: _orphan(reactor, recorder, lifeline))
        try:
            recorder.start()
            reactor.run()
        finally:
            recorder.finish()
            for sentence in recorder.unsent:
                print(sentence, flush=True)  # noqa: T201 - the last lines of the log, which the robot's process reports
    return 0


def _orphan(reactor: Reactor, recorder: FlightRecorder, lifeline: int) -> None:
    reactor.remove_reader(lifeline)
    recorder.orphaned(reactor.stop)


if __name__ == "__main__":
    sys.exit(main())
