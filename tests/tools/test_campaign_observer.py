"""The campaign's observer, by hand-made traces: what must be a breach is one, what may be late is none."""

import math
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


def test_the_limits_are_those_of_the_bus_file(observer):
    wire = observer.wire
    assert wire.limits.sync == 0.02
    assert wire.limits.consumer == 0.5
    assert wire.limits.feedback == pytest.approx(0.2)
    assert wire.ramp(10) == pytest.approx(0.159, abs=0.001)
    assert set(wire.fields) == {0x183, 0x283, 0x203, 0x303, 0x182, 0x282, 0x202, 0x302}
    assert wire.values(0x302, struct.pack("<ii", 7, -8)) == [(2, 0x607A, 7), (2, 0x60FF, -8)]
    assert wire.values(0x302, bytes(6)) == [(2, 0x607A, 0)]
    assert wire.values(0x123, bytes(8)) == []


def test_motion_after_an_enable_and_a_command_is_no_breach(observer):
    enabled(observer)
    commanded(observer, 1.0)
    drive(observer, 1.01)
    turn(observer, 1.02, 3.0 + LATE - 0.05)
    assert rules(observer) == []
    assert observer.moved_s > 1.9


def test_motion_that_nobody_commanded_is_a_breach(observer):
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


def test_a_command_that_may_have_come_after_the_enable_is_given_the_benefit_of_the_doubt(observer):
    observer.add(Command("a client", 10.0, 1.0, 2.0, done=1.2))
    observer.add(Enable(1.1, 1.3))
    drive(observer, 1.25)
    turn(observer, 1.3, 1.4)
    assert rules(observer) == []


def test_motion_without_any_enable_is_a_breach(observer):
    commanded(observer, 1.0)
    turn(observer, 1.1, 1.2)
    assert rules(observer) == ["motion"]


def test_a_command_that_outlives_its_time_is_a_breach(observer):
    enabled(observer)
    commanded(observer, 1.0)
    turn(observer, 1.1, 3.01 + LATE + 0.1)
    assert rules(observer) == ["stop"]
    assert "the life of the last command (of a client) was over" in observer.breaches[0].text


def test_a_command_that_outlives_its_source_is_a_breach(observer):
    enabled(observer)
    commanded(observer, 1.0, gone=1.5)
    turn(observer, 1.1, 1.5 + LATE - 0.05)
    assert rules(observer) == []
    turn(observer, 1.5 + LATE + 0.05, 1.5 + LATE + 0.1)
    assert rules(observer) == ["stop"]
    assert "the connection of a client ended" in observer.breaches[0].text


def test_a_target_left_on_the_wire_is_a_breach_while_the_shaft_stands(observer):
    enabled(observer)
    commanded(observer, 1.0, gone=1.5)
    drive(observer, 1.5 + GRACE_S + RAMP + 0.05)
    assert rules(observer) == ["target"]


@pytest.mark.parametrize(("word", "speed"), [(OFF, 10.0), (HALTED, 10.0), (ON, 0.0)])
def test_a_target_that_drives_nothing_is_none(observer, word, speed):
    drive(observer, 1.0, speed, word)
    assert rules(observer) == []


def test_a_stop_ends_what_was_enabled_and_commanded(observer):
    enabled(observer)
    observer.add(Command("a stream", 10.0, 1.0, 2.0))  # goes on
    observer.add(Reason("STOP", 2.0, 2.3))
    turn(observer, 1.1, 2.3 + LATE - 0.05)
    assert rules(observer) == []
    turn(observer, 2.3 + LATE + 0.05, 3.0)
    assert rules(observer) == ["stop"]
    assert "after STOP" in observer.breaches[0].text


def test_what_moves_again_after_a_stop_without_an_enable_is_motion_and_not_a_late_stop(observer):
    enabled(observer)
    observer.add(Command("a stream", 10.0, 1.0, 2.0))
    observer.add(Reason("STOP", 2.0, 2.1))
    turn(observer, 1.1, 2.2)
    turn(observer, 2.2, 4.0, speed=0.0)
    turn(observer, 4.0, 4.2)
    assert rules(observer) == ["motion"]


def test_an_enable_after_the_stop_allows_motion_again_by_a_newer_command_only(observer):
    enabled(observer)
    commanded(observer, 1.9)
    observer.add(Reason("STOP", 2.0, 2.1))
    enabled(observer, 3.0)
    turn(observer, 3.2, 3.3)
    assert rules(observer) == ["motion"]
    observer.breaches.clear()
    commanded(observer, 10.0)
    turn(observer, 10.1, 10.5)
    assert rules(observer) == []


def test_an_enable_that_may_have_come_after_the_stop_counts(observer):
    observer.add(Reason("STOP", 2.0, 2.5))
    observer.add(Enable(1.9, 2.2))
    commanded(observer, 2.6)
    turn(observer, 2.7, 4.0)
    assert rules(observer) == []


def test_a_reason_has_the_time_that_its_detection_takes(observer):
    enabled(observer)
    observer.add(Command("a stream", 10.0, 1.0, 2.0))
    observer.add(Reason("heartbeat_lost of node 2", 2.0, 2.0, detect=0.5))
    turn(observer, 1.1, 2.5 + LATE - 0.05)
    assert rules(observer) == []
    turn(observer, 2.5 + LATE + 0.05, 3.2)
    assert rules(observer) == ["stop"]


def test_zero_from_whomever_ends_an_older_command(observer):
    enabled(observer)
    commanded(observer, 1.0)
    commanded(observer, 1.2, speed=0.0)
    turn(observer, 1.1, 1.21 + LATE + 0.1)
    assert rules(observer) == ["stop"]
    assert "was replaced" in observer.breaches[0].text


def test_a_value_that_is_none_ends_the_older_command_also_when_it_is_refused(observer):
    enabled(observer)
    commanded(observer, 1.0)
    commanded(observer, 1.2, speed=math.nan, refused=True)
    turn(observer, 1.1, 1.21 + LATE + 0.1)
    assert rules(observer) == ["stop"]


def test_a_refused_command_moves_nothing_and_ends_nothing(observer):
    enabled(observer)
    commanded(observer, 1.0)
    commanded(observer, 1.2, speed=3.0, refused=True)
    turn(observer, 1.1, 2.5)
    assert rules(observer) == []
    turn(observer, 5.0, 5.1, speed=0.0)
    commanded(observer, 10.0, refused=True)
    turn(observer, 10.0 + LATE + 0.1, 11.0)
    assert rules(observer) == ["motion"]


def test_deadlines_run_longer_by_what_was_excused_and_no_more(observer):
    enabled(observer)
    commanded(observer, 1.0, gone=1.5)
    observer.excuse(1.5, 1.8)
    turn(observer, 1.1, 1.8 + LATE - 0.05)
    assert rules(observer) == []
    turn(observer, 1.8 + LATE + 0.05, 2.5)
    assert rules(observer) == ["stop"]


def test_an_excuse_of_one_node_is_none_for_the_other(observer):
    enabled(observer)
    commanded(observer, 1.0, gone=1.5)
    observer.excuse(1.5, 2.5, RIGHT)
    turn(observer, 1.5 + LATE + 0.05, 2.2, node=RIGHT)
    assert rules(observer) == []
    turn(observer, 1.2, 2.2, node=LEFT)
    assert rules(observer) == ["stop"]


def test_one_motion_is_one_breach(observer):
    turn(observer, 1.0, 9.0)
    assert rules(observer) == ["motion"]


def test_a_shaft_is_judged_where_the_bus_is_silent(observer):
    assert observer.silent(RIGHT, 1.0)
    turn(observer, 1.0, 1.1, speed=0)
    assert not observer.silent(RIGHT, 1.1)
    observer.on_shaft(2.0, 2.01, RIGHT, 2000.0)
    assert rules(observer) == ["motion"]
    assert "under power" in observer.breaches[0].text


def test_standing_is_no_motion(observer):
    turn(observer, 1.0, 3.0, speed=0.02)
    assert rules(observer) == []
    assert observer.moved_s == 0.0


def test_what_is_forgotten_changes_no_judgement(observer):
    enabled(observer)
    observer.add(Reason("STOP", 2.0, 2.1))
    commanded(observer, 1.5)
    enabled(observer, 3.0)
    observer.add(Command("a stream", 10.0, 4.0, 2.0))
    for now in range(100):
        observer.prune(float(now))
    turn(observer, 100.0, 100.1)
    assert rules(observer) == []
    observer.add(Reason("STOP", 101.0, 101.0))
    turn(observer, 101.0, 101.5, speed=0.0)
    turn(observer, 102.0, 102.1)
    assert rules(observer) == ["motion"]
