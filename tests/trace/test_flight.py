"""The recorder in this process, with a robot on mock hardware and on a separate bus."""

import json
import os
import time
from types import SimpleNamespace

import pytest
from msgspec.structs import replace
from support.host import TIMEOUT_S, eventually
from support.mockrobot import running

from canopen_control.bus.channel import open_port
from canopen_control.bus.port_abilities import Arrivals
from canopen_control.errors import BusError
from canopen_control.frame import CanFrame, pack_records
from canopen_control.host.reactor import Reactor
from canopen_control.master.event_log import Event, Level
from canopen_control.rpc.messages.state import RobotEvent
from canopen_control.trace import flight
from canopen_control.trace.flight import FlightRecorder, flight_folder, main
from canopen_control.trace.flight_file import AFTER_NS, newest, read_flight

SECOND = 1_000_000_000
LONG_NS = round(TIMEOUT_S * SECOND)
FAULT = RobotEvent(time=1.0, kind="fault", node=None, level="error", text="x")


@pytest.fixture
def reactor():
    reactor = Reactor()
    errors = []
    reactor.on_error = errors.append
    yield reactor
    reactor.close()
    assert errors == []


@pytest.fixture
def robot():
    with running("flight", real_time=True) as robot:
        yield robot


def fail(robot, text="it broke"):
    session = robot._background._session
    core, reactor = session.robot, session.reactor
    reactor.call_threadsafe(lambda: core.report(Event(reactor.now(), "fault", "left_drive", text, Level.ERROR)))


def events_of(recorder):
    return [json.loads(line) for line in recorder._events.lines()]


def hear(reactor, recorder, text):
    assert reactor.run_until(lambda: any(event["text"] == text for event in events_of(recorder)), LONG_NS)


def test_events_and_states_of_the_robot_are_in_the_file_and_the_robot_reports_where_it_is(reactor, robot):
    recorder = FlightRecorder(reactor, "flight", {})
    recorder.start()
    fail(robot)
    hear(reactor, recorder, "it broke")
    assert reactor.run_until(lambda: recorder._states.size > 0, LONG_NS)
    recorder.finish()
    file = read_flight(newest(flight_folder("flight")))
    assert file.meta.reason.text == "it broke"
    assert file.meta.status.robot == "flight"
    assert file.states[-1].joints
    assert "flight runs" in " ".join(event.text for event in file.events)  # from before the recorder was there
    reported = [event for event in robot.status().events if event.kind == "flight"]
    assert len(reported) <= 1
    assert recorder.unsent == [] or reported == []


@pytest.mark.rest
def test_no_event_is_taken_twice(reactor, robot):
    recorder = FlightRecorder(reactor, "flight", {})
    recorder.start()
    fail(robot, "once")
    hear(reactor, recorder, "once")
    recorder._robot.close()
    recorder._read()  # the connection is gone, and comes again
    fail(robot, "twice")
    hear(reactor, recorder, "twice")
    texts = [event["text"] for event in events_of(recorder)]
    assert len(texts) == len(set(texts))
    recorder.finish()


@pytest.mark.process
def test_a_copy_writes_while_the_recorder_continues(reactor, robot, monkeypatch):
    recorder = FlightRecorder(reactor, "flight", {})
    recorder.start()
    recorder._write_aside(replace(FAULT, text="aside"))
    assert reactor.run_until(lambda: recorder._writer is None, LONG_NS)
    path = newest(flight_folder("flight"))
    assert read_flight(path).meta.reason.text == "aside"
    hear(reactor, recorder, f"flight recording: {path} (show it with canopen-control report)")
    assert recorder.unsent == []
    recorder.finish()


@pytest.mark.process
def test_a_copy_that_dies_is_reported(reactor, monkeypatch):
    recorder = FlightRecorder(reactor, "nobody", {})
    monkeypatch.setattr(FlightRecorder, "write", lambda *_: os._exit(3))
    recorder._write_aside(FAULT)
    assert reactor.run_until(lambda: recorder._writer is None, LONG_NS)
    assert "could not write" in recorder.unsent[0]
    recorder.finish()


def test_a_folder_that_cannot_be_written_costs_a_sentence(reactor, monkeypatch, private_folders):
    (private_folders / "state").write_text("a file where a folder should be")
    recorder = FlightRecorder(reactor, "nobody", {})
    recorder._on_event(FAULT)
    recorder.finish()
    assert "could not write" in recorder.unsent[0]
    recorder.finish()
    assert len(recorder.unsent) == 1


@pytest.mark.process
def test_frames_of_every_bus_are_recorded_and_nothing_is_sent(reactor):
    first, second = open_port("local:one", label="a"), open_port("local:two", label="b")
    recorder = FlightRecorder(reactor, "nobody", {"left": "local:one", "right": "local:two", "in": "memory:x"})
    recorder.start()
    first.send(pack_records([CanFrame(0x181, b"\x01\x02"), CanFrame(0x80)]))
    second.send(pack_records([CanFrame(0x702, b"\x05")]))
    assert reactor.run_until(lambda: recorder._frames.size == 3 * (16 + 8), LONG_NS)
    recorder._on_event(FAULT)
    recorder.finish()
    file = read_flight(newest(flight_folder("nobody")))
    assert sorted((bus, str(frame)) for _, bus, frame in file.frames) == [
        ("left", "080#"),
        ("left", "181#0102"),
        ("right", "702#05"),
    ]
    assert file.meta.unheard == ("in",)
    assert first.receive() == second.receive() == b""
    for port in (first, second):
        port.close()


def test_a_bus_that_goes_is_left_and_the_recorder_stays(reactor, monkeypatch):
    class Gone:
        def __init__(self):
            self.read, self.write = os.pipe()
            self.closed = 0
            self.stats = type("Stats", (), {"lost": 0})

        def fileno(self):
            return self.read

        def receive(self):
            raise BusError("gone")

        def close(self):
            self.closed += 1

    port = Gone()
    monkeypatch.setattr(flight, "open_port", lambda *_, **__: port)
    recorder = FlightRecorder(reactor, "nobody", {"can": "local:gone"})
    recorder.start()
    os.write(port.write, b"x")
    assert reactor.run_until(lambda: port.closed == 1, LONG_NS)
    recorder.finish()
    for fd in (port.read, port.write):
        os.close(fd)


@pytest.mark.process
def test_without_its_robot_it_waits_for_the_reaction_and_ends(reactor, monkeypatch):
    assert flight.AFTER_NS == AFTER_NS == 3 * SECOND
    monkeypatch.setattr(flight, "AFTER_NS", SECOND // 10)  # what follows needs no three seconds
    recorder = FlightRecorder(reactor, "nobody", {})
    begin, ended = reactor.now(), []
    recorder.orphaned(lambda: ended.append(reactor.now()))
    assert reactor.run_until(lambda: bool(ended), LONG_NS)
    assert ended[0] - begin >= SECOND // 10
    recorder.finish()
    assert eventually(lambda: newest(flight_folder("nobody")) is not None)
    assert read_flight(newest(flight_folder("nobody"))).meta.reason.kind == "died"


def test_the_arguments_are_checked(capsys):
    with pytest.raises(SystemExit):
        main([])
    assert "--name" in capsys.readouterr().err


def test_a_storm_of_faults_costs_bounded_memory_and_one_file(reactor):
    recorder = FlightRecorder(reactor, "nobody", {})
    event = replace(FAULT, node="left_drive")
    for number in range(20_000):
        recorder._on_event(replace(event, text=f"storm {number} " + "x" * 80))
    assert recorder._events.size <= flight.EVENT_BYTES
    recorder.finish()
    (file,) = (read_flight(path) for path in flight_folder("nobody").iterdir())
    assert file.meta.reason.text.startswith("storm 0 ")
    assert file.events[-1].text.startswith("storm 19999 ")


def stamped(*stamps):
    """Return a port that has received a frame for each stamp of the kernel."""
    records = pack_records([CanFrame(0x181)] * len(stamps))
    return SimpleNamespace(
        stats=SimpleNamespace(lost=0), ask_stamps=lambda: None, receive_stamped=lambda: (records, list(stamps))
    )


def test_the_time_of_a_frame_is_the_kernels_stamp_if_it_has_one(reactor):
    recorder = FlightRecorder(reactor, "nobody", {"can": "can0"})
    base = reactor.now() - SECOND
    recorder._take_frames(0, Arrivals(stamped(base + 1_000_000, base + 2_500_000), reactor.now))
    recorder._on_event(FAULT)
    recorder.finish()
    times = [time for time, _, _ in read_flight(newest(flight_folder("nobody"))).frames]
    assert times[1] - times[0] in (1_500_000, 1_499_000, 1_501_000)  # the file has microseconds
    assert abs(times[0] - recorder._wall_offset_ns - base - 1_000_000) <= 100_000_000


def test_a_clock_that_is_set_while_it_records_is_followed(reactor, monkeypatch):

    recorder = FlightRecorder(reactor, "nobody", {"can": "can0"})
    now = time.time_ns
    monkeypatch.setattr("canopen_control.trace.flight.time.time_ns", lambda: now() + 3600 * SECOND)
    recorder._take_frames(0, Arrivals(stamped(reactor.now() - 1_000_000), reactor.now))
    recorder._on_event(FAULT)
    recorder.finish()
    file = read_flight(newest(flight_folder("nobody")))
    assert abs(file.frames[0][0] - now() - 3600 * SECOND) < 60 * SECOND
    assert abs(file.meta.written * 1e9 - file.frames[0][0]) < 60 * SECOND
