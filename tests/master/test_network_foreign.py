"""Another master on the bus is reported within a second, once, with the frames it sends."""

import contextlib

import pytest
from support.faultbench import LEFT, RIGHT, FaultBench

from canopen_control.frame import CanFrame
from canopen_control.master.event_log import Level
from canopen_control.runtime.core import RobotState


@pytest.fixture
def robby(request):
    bench = FaultBench(f"foreign{abs(hash(request.node.nodeid)) % 10**9}")
    bench.start()
    bench.events.clear()
    yield bench
    bench.close()


def say(bench, *frames):
    for text in frames:
        can_id, data = text.split("#")
        bench.bus.inject(CanFrame(int(can_id, 16), bytes.fromhex(data)))


def master_like(bench, seconds, *frames):
    """Send frames every 20 ms, as a master does."""
    for _ in range(round(seconds * 50)):
        say(bench, *frames)
        bench.run(20)


def collected(bench):
    return [event for event in bench.events if event.kind in ("other_master", "other_sdo_client")]


@pytest.mark.parametrize(
    ("frame", "words"),
    [
        ("080#", "SYNC 0x080 (2"),
        ("701#05", "heartbeat 0x701 of this master's own node-ID"),
        ("77F#05", "heartbeat 0x77F of node 127"),
        ("202#060003", "RPDO 0x202 of node 2 (right_drive)"),
        ("303#0000000000000000", "RPDO 0x303 of node 3 (left_drive)"),
    ],
)
def test_each_sign_of_a_master_is_reported_within_a_second_and_once(robby, frame, words):
    master_like(robby, 1.0, frame)
    (event,) = collected(robby)
    assert (event.kind, event.level) == ("other_master", Level.WARNING)
    assert "bus can: another master is active: " in event.text
    assert words in event.text
    assert event.details.identifiers == (f"0x{frame[:3]}",)
    master_like(robby, 5.0, frame)
    assert len(collected(robby)) == 1


@pytest.mark.rest
def test_all_that_it_sends_is_one_sentence(robby):
    say(robby, "000#8205", "000#8206")
    master_like(robby, 8.0, "080#", "203#060003", "603#4000100000000000", "701#05")
    (event,) = collected(robby)
    for words in ("NMT 0x000 (reset communication, node 5, ", "SYNC 0x080", "RPDO 0x203", "SDO 0x603", "0x701"):
        assert words in event.text
    assert event.details.identifiers == ("0x000", "0x080", "0x203", "0x603", "0x701")


def test_a_tool_is_reported_as_one_and_a_master_after_it_as_one(robby):
    say(robby, "603#4000100000000000")
    robby.run(1000)
    assert [(event.kind, event.level) for event in collected(robby)] == [("other_sdo_client", Level.INFO)]
    say(robby, "000#0103")
    robby.run(1000)
    assert "NMT 0x000 (start, node 3)" in collected(robby)[-1].text
    assert "unless it is your tool" in collected(robby)[-1].text
    master_like(robby, 1.0, "080#")
    say(robby, "603#4000100000000000", "000#0103")
    robby.run(1000)
    assert [event.kind for event in collected(robby)] == ["other_sdo_client", "other_master", "other_master"]


def test_checking_an_unused_node_id_leaves_no_member(robby):
    robby.power_off(LEFT)
    robby.run(1000)
    say(robby, "603#4000100000000000")
    robby.run(1000)
    assert collected(robby) == []


@pytest.mark.rest
def test_after_a_minute_without_it_is_reported_again(robby):
    master_like(robby, 1.0, "080#")
    robby.run(61_000)
    master_like(robby, 1.0, "080#")
    assert len(collected(robby)) == 2


def test_only_this_master_has_these_boots_and_faults(robby):
    robby.hold(10.0, 10.0, ms=500)
    robby.switch("second_node", node=LEFT)
    robby.run(3000)
    robby.switch("spontaneous_reset", node=RIGHT)
    robby.run(3000)
    assert collected(robby) == []


def test_nmt_frames_of_any_length_are_reported_as_they_are(robby):
    say(robby, "000#", "000#01", "000#0100", "000#5503", "000#0102030405060708")
    robby.run(600)
    (event,) = collected(robby)
    assert "empty, 01, start, all nodes, 0x55, node 3" in event.text


def test_two_robots_on_one_bus_name_each_other(robby):
    with contextlib.closing(FaultBench(f"{robby.channel.partition(':')[2]}", drives=())) as other:
        other.robot.start()
        for _ in range(100):
            other.run(10)
            robby.run(10)
        assert len(collected(robby)) == 1
        assert len(collected(other)) == 1
        assert robby.robot.state is not RobotState.STOPPED


def _own(bench, can_id):
    """Return the data of the master's last frame with an identifier."""
    return [frame.data for label, frame in bench.bus.history if label == "master" and frame.can_id == can_id][-1]


@pytest.fixture
def driving(robby):
    robby.hold(5.0, 5.0, ms=600)
    robby.events.clear()
    return robby


def test_a_foreign_rpdo_is_overwritten_in_the_next_cycle_and_one_of_them_stops_nothing(driving):
    own = _own(driving, 0x303)
    driving.bus.clear_history()
    driving.bus.inject(CanFrame(0x303, own[:4] + bytes(4)))
    driving.run(21)
    assert _own(driving, 0x303) == own
    driving.hold(5.0, 5.0, ms=2000)
    assert driving.found("stop") == []
    assert abs(driving.speed(LEFT)) > 1000


def test_a_program_that_goes_on_sending_other_rpdos_stops_the_robot_within_two_cycles(driving):
    own, driving.began = _own(driving, 0x303), driving.reactor.now()
    for _ in range(2):
        driving.bus.inject(CanFrame(0x303, own[:4] + bytes(4)))
        driving.run(20)
    event, after = driving.collected("contradicted", ms=1)
    assert after <= 3 * 20
    assert "another program on the bus sends its RPDOs with other values" in event.text
    assert "canopen-control axis enable all" in driving.texts("stop")[-1]
    driving.disabled_after()


def test_an_echo_of_its_own_rpdos_stops_nothing_also_ten_cycles_late(driving):
    sent = []
    for cycle in range(40):
        sent.append(_own(driving, 0x303))
        driving.bus.inject(CanFrame(0x303, sent[max(0, cycle - 10)]))
        driving.publish(5.0 + 0.02 * cycle, 5.0 + 0.02 * cycle)
        driving.run(20)
    assert len(set(sent)) > 30
    assert driving.found("contradicted") == []
    assert driving.found("stop") == []
