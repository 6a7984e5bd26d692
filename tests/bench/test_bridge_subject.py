"""The runtime that notes when commands arrive."""

import time
from types import SimpleNamespace

import pytest
from canopen_control_bench.bridge_subject import BridgeSubject


def test_a_command_is_timed_by_what_it_holds_and_taken_as_standstill():
    taken, readers = [], []
    robot = SimpleNamespace(command=lambda *command, holder: taken.append(command), on_running=None, name="robby")
    api = SimpleNamespace(_robot=robot)
    reactor = SimpleNamespace(add_reader=lambda fd, callback: readers.append(fd))
    subject = BridgeSubject(SimpleNamespace(robot=robot, reactor=reactor, api=api))
    api._robot.command("base", [time.monotonic() - 2.0, 0.0], "ros", 12.5)
    assert subject.latencies == [pytest.approx(2.0, abs=0.5)]
    assert taken == [("base", [0.0, 0.0], "ros", 12.5)]
    assert api._robot.name == "robby"
    assert readers == [0]
