"""The flight recorder on a real kernel's CAN: it receives everything, sends nothing, and has the kernel's times."""

import time

import pytest

from canopen_control.bus.channel import open_port
from canopen_control.frame import RECORD_SIZE, CanFrame, pack_records
from canopen_control.host.reactor import Reactor
from canopen_control.rpc.messages.state import RobotEvent
from canopen_control.trace.flight import FlightRecorder, flight_folder
from canopen_control.trace.flight_file import newest, read_flight

pytestmark = pytest.mark.socketcan
SECOND = 1_000_000_000
KEPT_SIZE = RECORD_SIZE + 8  # of a frame with its time


def test_frames_have_the_kernels_times_however_late_they_are_read(vcan):
    with Reactor() as reactor:
        other = open_port(vcan, label="other")
        recorder = FlightRecorder(reactor, "nobody", {"can": vcan})
        recorder.start()
        reactor.run_until(lambda: False, SECOND // 20)  # the first reading asks the kernel for its times
        other.send(pack_records([CanFrame(0x080)]))
        assert reactor.run_until(lambda: recorder._frames.size > 0, 20 * SECOND)
        before = time.time_ns()
        other.send(pack_records([CanFrame(0x181, b"\x01"), CanFrame(0x182)]))
        after = time.time_ns()
        time.sleep(0.2)  # the recorder is busy: what it hears next is old by then
        observed = recorder._frames.size
        assert reactor.run_until(lambda: recorder._frames.size >= observed + 2 * KEPT_SIZE, 20 * SECOND)
        recorder._on_event(RobotEvent(kind="fault", level="error", text="x", time=time.time(), node=None))
        recorder.finish()
        frames = read_flight(newest(flight_folder("nobody"))).frames
        assert [str(frame) for _, _, frame in frames] == ["080#", "181#01", "182#"]
        slack = 2_000_000
        assert all(before - slack <= stamp <= after + slack for stamp, _, _ in frames[1:])
        assert other.receive() == b""
        other.close()
