"""The observer of the campaign with hand-made traces: violations are detected, permitted delays are not."""

import struct
from pathlib import Path

import pytest
from campaigner.observer import GRACE_S, MOTOR_S, Command, Enable, Observer, Reason
from campaigner.wire import read_wire

ROOT = Path(__file__).parents[2]
LEFT, RIGHT = 3, 2
SCALE = 254.64790894703253
TOP = 10.0
RAMP = TOP * SCALE / 16000
LATE = GRACE_S + RAMP + MOTOR_S  # the latest that a shaft may still turn
ON, OFF, HALTED = 0x000F, 0x0007, 0x010F


@pytest.fixture
def observer():
    return Observer(read_wire(ROOT / "config" / "robby" / "bus.yml"), TOP)


def turn(observer, begin, end, speed=10.0, node=RIGHT):
    """Let a shaft turn, seen every 20 ms."""
    for step in range(round((end - begin) / 0.02)):
        at = begin + step * 0.02
        observer.on_frame(at, at + 0.005, 0x180 + node, struct.pack("<Hb", 0x0627, 3))
        observer.on_frame(at, at + 0.005, 0x280 + node, struct.pack("<ii", 0, round(speed * SCALE)))


def drive(observer, at, speed=10.0, word=ON, node=RIGHT):
    observer.on_frame(at, at + 0.005, 0x200 + node, struct.pack("<Hb", word, 3))
    observer.on_frame(at, at + 0.005, 0x300 + node, struct.pack("<ii", 0, round(speed * SCALE)))


def rules(observer):
    return [breach.rule for breach in observer.breaches]


def commanded(observer, at, speed=10.0, life=2.0, **more):
    command = Command("a client", speed, at, life, done=at + 0.01, **more)
    observer.add(command)
    return command


def enabled(observer, at=0.0):
    observer.add(Enable(at, at + 0.1))


def test_motion_after_an_enable_and_a_command_is_not_a_breach(observer):
    enabled(observer)
    commanded(observer, 1.0)
    drive(observer, 1.01)
    turn(observer, 1.02, 3.0 + LATE - 0.05)
    assert rules(observer) == []
    assert observer.moved_s > 1.9


def test_motion_without_a_command_is_a_violation(observer):
    enabled(observer)
    drive(observer, 1.0)
    turn(observer, 1.02, 1.1)
    assert rules(observer) == ["target"]
    assert "no command newer than an enable" in observer.breaches[0].text
    assert "node 2 (right_drive)" in observer.breaches[0].text


def test_a_command_older_than_the_enable_moves_nothing(observer):
    commanded(observer, 1.0)
    enabled(observer, 1.5)
    drive(observer, 1.6)
    turn(observer, 1.6, 1.7)
    assert rules(observer) == ["target"]


def test_a_command_that_outlives_its_time_is_a_breach(observer):
    enabled(observer)
    commanded(observer, 1.0)
    turn(observer, 1.1, 3.01 + LATE + 0.1)
    assert rules(observer) == ["stop"]
    assert "the last command (of a client) had expired" in observer.breaches[0].text


def test_a_stop_ends_what_was_enabled_and_commanded(observer):
    enabled(observer)
    observer.add(Command("a stream", 10.0, 1.0, 2.0))  # goes on
    observer.add(Reason("STOP", 2.0, 2.3))
    turn(observer, 1.1, 2.3 + LATE - 0.05)
    assert rules(observer) == []
    turn(observer, 2.3 + LATE + 0.05, 3.0)
    assert rules(observer) == ["stop"]
    assert "after STOP" in observer.breaches[0].text


def test_a_shaft_is_judged_where_the_bus_is_silent(observer):
    assert observer.silent(RIGHT, 1.0)
    turn(observer, 1.0, 1.1, speed=0)
    assert not observer.silent(RIGHT, 1.1)
    observer.on_shaft(2.0, 2.01, RIGHT, 2000.0)
    assert rules(observer) == ["motion"]
    assert "under power" in observer.breaches[0].text
