"""A flight recording of robby in simulated time: its wheels turn, its left drive loses power, and it stops."""

from msgspec.structs import replace
from support.apiclient import Client
from support.robots import FORWARD, LEFT, RIGHT, Bench

from canopen_control.bus.channel import open_port
from canopen_control.frame import frames_of, pack_records
from canopen_control.rpc.messages.layout import Layout
from canopen_control.rpc.messages.state import RobotEvent, Status, TimedSnapshot
from canopen_control.rpc.wire import convert, text_of
from canopen_control.runtime.api import ApiServer
from canopen_control.trace.flight_file import NO_FAULT, FlightFile, FlightMeta, KeptFrame, candump_lines, save

FAULT = "node 3 (left_drive)"


def record(name="story", seconds=4, power_off_after=2.0, velocity=(4.0, 4.0)):
    """Return a `FlightFile` of `seconds`, the drive off after `power_off_after` (None: never)."""
    bench = Bench(name)
    bench.api = ApiServer(bench.robot)
    bench.start()
    client = Client(bench)
    layout = convert(client.ask("layout")["result"], Layout)
    status = convert(client.ask("status")["result"], Status)
    client.ask("subscribe", state_rate=10.0, events=True)
    port, offset = open_port(bench.channel, label="listener"), bench.robot.wall_offset_ns
    buses = {"can": bench.channel}
    file = FlightFile(FlightMeta(robot="robby", reason=NO_FAULT, buses=buses, layout=layout, status=status))
    file.events = list(status.events)
    messages = client.messages()
    for ms in range(0, round(seconds * 1000), 2):
        off = power_off_after is not None and ms >= power_off_after * 1000
        if off and LEFT in bench.drives:
            bench.power_off(LEFT)
        if ms % 100 == 0 and not off:
            bench.robot.command(FORWARD, list(velocity), "test")
        bench.run(2)
        now = bench.reactor.now() + offset
        file.frames += [(now, "can", frame) for frame in frames_of(port.receive())]
        messages += client.messages()
    file.states = [convert(message["state"], TimedSnapshot) for message in messages if "state" in message]
    file.events += [convert(message["event"], RobotEvent) for message in messages if "event" in message]
    file.eds = {"TMCM-1270.eds": bench.setup.bus.eds_paths["left_drive"].read_bytes()}
    assert RIGHT in bench.drives
    for closed in (port, client, bench.api, bench):
        closed.close()
    return file


def saved(file, folder):
    """Write it as the recorder would; return the path."""
    frames = (KeptFrame(time, 0, pack_records([frame])) for time, _, frame in file.frames)
    lines = [[text_of(entry) for entry in part] for part in (file.events, file.states)]
    reason = next(event for event in file.events if event.level == "error")
    meta = replace(file.meta, reason=reason, written=file.states[-1].time)
    return save(folder, meta, candump_lines(frames, ["can"], 0), *lines)
