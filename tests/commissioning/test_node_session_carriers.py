"""One session interface over three carriers: a running robot, a bare bus, and a robot in virtual time."""

import contextlib
import threading
import time

import pytest
from support.generic import write_generic
from support.lockstep import lockstep
from support.onbus import GENERIC, OnBus

from canopen_control import Robot
from canopen_control.cia301.nmt import NmtState
from canopen_control.cli.support.target import BusTarget
from canopen_control.client import RobotClient
from canopen_control.commissioning.node_session import dictionary_of, session_with
from canopen_control.data_files import data_path
from canopen_control.errors import CanopenError, RemoteError, SdoCancelled
from canopen_control.rpc.messages.robot import GetNodes
from canopen_control.runtime.robot_files import find_robot
from canopen_control.runtime.setup import read_robot
from canopen_control.testing.tested_robot import TestedRobot
from canopen_control.virtual.quirks import switches_of

LONG = (0x2000, 0)  # takes a file of any size
DATA = bytes(n % 251 for n in range(300_000))


def answer_late(drives):
    """Let the node answer 2 ms late: on the memory bus a transfer would take no time at all."""
    drives.call(lambda: switches_of(drives.nodes[2]).set("sdo_late=0.002", on=True, now=drives.reactor.now()))


@contextlib.contextmanager
def through_a_robot(folder):
    with (
        lockstep(),
        OnBus("memory:carrier", {2: GENERIC, 3: GENERIC}) as drives,
        Robot.from_config(str(folder), name="carrier", can="memory:carrier", drives=False),
        RobotClient.connect("carrier") as client,
    ):
        answer_late(drives)
        place = client.ask(GetNodes()).nodes[0]
        with session_with(client, place, dictionary_of(place)) as session:
            yield session


@contextlib.contextmanager
def on_a_bare_bus(_folder):
    with (
        OnBus("memory:carrier", {2: GENERIC}) as drives,
        BusTarget("memory:carrier", data_path("eds", GENERIC)) as target,
    ):
        answer_late(drives)
        yield target.session("2")


@contextlib.contextmanager
def in_virtual_time(folder):
    robot = TestedRobot(read_robot(find_robot(str(folder))))
    try:
        yield robot.session("drive_one")
    finally:
        robot.close()


@pytest.fixture(params=[through_a_robot, on_a_bare_bus, in_virtual_time])
def session(request, tmp_path):
    with request.param(write_generic(tmp_path)) as session:
        yield session


def test_a_session_reads_writes_and_identifies_whatever_carries_it(session):
    entry = session.dictionary[0x6083, 0]
    session.write_value(entry, 4000)
    assert session.read_value(entry) == 4000
    assert session.identity().device_type == 0x00020192
    assert session.identity_differences() == []
    assert session.nmt_state() in (NmtState.OPERATIONAL, None), "None without heartbeats, on the bare bus"
    assert session.transfers.progress() == (0, None)


def test_a_long_transfer_reports_its_progress_and_can_be_cancelled(session):
    errors, progress = [], (0, None)

    def write():
        try:
            session.write(*LONG, DATA)
        except CanopenError as error:
            errors.append(error)

    thread = threading.Thread(target=write)
    thread.start()
    while not progress[0] and thread.is_alive():
        time.sleep(0.001)  # time passes for the drive
        progress = session.transfers.progress()
    session.transfers.cancel()
    thread.join()
    assert 0 < progress[0] < progress[1] == len(DATA)
    (error,) = errors
    assert isinstance(error, SdoCancelled) or (isinstance(error, RemoteError) and error.kind == "SdoCancelled")
    assert "0x2000:00: the transfer was cancelled" in str(error)
    assert session.read(*LONG) == b"", "the node has dropped it"
    session.write(*LONG, DATA[:1000])
    assert session.read(*LONG) == DATA[:1000]


def test_a_cancel_leaves_what_is_short_alone(session):
    session.transfers.cancel()
    session.write_value(session.dictionary[0x6083, 0], 5000)
    assert session.read_value(session.dictionary[0x6083, 0]) == 5000
