"""Recording of a running robot in memory: samples, events and frames for some seconds.

The recorder only listens; the caller limits the time, because all data are kept in memory. A bus inside the robot's
process is omitted and named in the result.
"""

from __future__ import annotations

import contextlib
import functools
import operator
from typing import TYPE_CHECKING, Final

from canopen_control.bus.channel import open_port, parse_channel
from canopen_control.bus.port_abilities import Arrivals
from canopen_control.client.robot_client import RobotClient
from canopen_control.errors import BusError, CanopenError
from canopen_control.frame import frames_of
from canopen_control.host.reactor import Reactor
from canopen_control.rpc.messages.robot import GetLayout, GetStatus, Subscribe
from canopen_control.rpc.messages.state import RobotEvent, StateSample
from canopen_control.trace.flight_file import NO_FAULT, FlightFile, FlightMeta

if TYPE_CHECKING:
    from canopen_control.bus.port import Port


RATE: Final = 50.0  # sampling rate in Hz
_NS: Final = 1_000_000_000


def watch(name: str | None, seconds: float) -> FlightFile:
    """Record the robot `name`, or the only running one, until `seconds` elapse or the robot ends.

    Raise ConfigError if there is no robot.
    """
    with RobotClient.connect(name) as robot, Reactor() as reactor:
        layout, status = robot.ask(GetLayout()), robot.ask(GetStatus())
        channels = {bus: bus_layout.channel for bus, bus_layout in layout.buses.items()}
        file = FlightFile(FlightMeta(robot=robot.robot, reason=NO_FAULT), events=list(status.events))
        ports = _listen(reactor, channels, file)
        robot.ask(Subscribe(state_rate=RATE, events=True))
        reactor.add_reader(robot.fileno(), lambda: _read(reactor, robot, file))
        reactor.call_later(round(seconds * _NS), reactor.stop)
        reactor.run()
        with contextlib.suppress(CanopenError):
            status = robot.ask(GetStatus())
        file.meta = FlightMeta(
            robot=robot.robot,
            reason=NO_FAULT,
            buses=channels,
            unheard=tuple(bus for bus in channels if bus not in ports),
            frames_lost=sum(port.stats.lost for port in ports.values()),
            layout=layout,
            status=status,
        )
        for port in ports.values():
            port.close()
    file.frames.sort(key=operator.itemgetter(0))  # several buses are read one after the other
    return file


def _read(reactor: Reactor, robot: RobotClient, file: FlightFile) -> None:
    try:
        for message in robot.messages(0):
            if isinstance(message, StateSample):
                file.states.append(message)
            elif isinstance(message, RobotEvent) and message not in file.events:
                file.events.append(message)
    except CanopenError:  # the robot has ended
        reactor.remove_reader(robot.fileno())
        reactor.stop()


def _listen(reactor: Reactor, channels: dict[str, str], file: FlightFile) -> dict[str, Port]:
    ports: dict[str, Port] = {}
    for bus, channel in channels.items():
        if not parse_channel(channel).kind.shared:
            continue
        ports[bus] = port = open_port(channel, label="report", join=True)
        reactor.add_reader(port.fileno(), functools.partial(_receive, reactor, file, bus, Arrivals(port)))
    return ports


def _receive(reactor: Reactor, file: FlightFile, bus: str, arrivals: Arrivals) -> None:
    try:
        records, stamps = arrivals.receive()
    except BusError:
        reactor.remove_reader(arrivals.port.fileno())
        return
    offset = arrivals.unix_offset_ns
    file.frames.extend((at + offset, bus, frame) for at, frame in zip(stamps, frames_of(records), strict=True))
