"""Whatever makes the state of a node unknown stops its group at once, judged by frames on the bus and by shafts."""

import pytest
from support.faultbench import CYCLE_MS, LEFT, RAMP_MS, RIGHT, SPEED
from support.robots import copy_robby

from canopen_control.frame import CanFrame
from canopen_control.runtime.core import RobotState

QUICK_STOP = 0x0002


def sent(bench, can_id):
    """The data that the master sent with an identifier since the history was cleared."""
    return [frame.data for label, frame in bench.bus.history if label == "master" and frame.can_id == can_id]


def inject(bench, text):
    can_id, data = text.split("#")
    bench.bus.clear_history()
    bench.began = bench.reactor.now()
    bench.bus.inject(CanFrame(int(can_id, 16), bytes.fromhex(data)))


@pytest.fixture(params=["answers", "silent"])
def victim(turning, request):
    """Return a turning robot whose right drive answers SDO, or no longer does."""
    turning.victim = RIGHT
    if request.param == "silent":
        turning.switch("sdo_silent")
    return turning


@pytest.mark.parametrize("frame", ["702#00", "702#7F", "702#04", "702#33"])
def test_an_unexpected_boot_up_or_nmt_state_stops_all_in_the_same_cycle(victim, frame):
    inject(victim, frame)
    victim.run(CYCLE_MS)
    assert int.from_bytes(sent(victim, 0x202)[-1][:2], "little") == QUICK_STOP, "the drive itself"
    assert int.from_bytes(sent(victim, 0x303)[-1][4:8], "little") == 0, "the target of the other one"
    assert victim.stopped_after() <= CYCLE_MS + RAMP_MS + CYCLE_MS
    assert victim.disabled_after() <= CYCLE_MS + RAMP_MS + 100
    victim.expect_stays_down(500)


def test_after_such_a_boot_up_the_robot_continues_with_a_new_enable(turning):
    turning.victim = RIGHT
    inject(turning, "702#00")
    turning.stopped_after()
    turning.until(lambda: turning.robot.nodes["right_drive"].ready)
    turning.run(3000)  # longer than the time after which a lost drive is stopped
    turning.goes_on()
    turning.run(3000)
    assert sent(turning, 0x202), "its process data go on"
    assert turning.robot.state is RobotState.RUNNING
    assert abs(turning.speed(RIGHT)) <= SPEED


def test_the_state_of_a_node_counts_without_a_heartbeat_that_is_waited_for(turning):
    """A heartbeat nobody has to send still tells that a node is not operational."""
    turning.victim = RIGHT
    turning.robot.buses["can"].network._consumer.unwatch(RIGHT)
    inject(turning, "702#7F")
    turning.collected("nmt")
    assert turning.stopped_after() <= CYCLE_MS + RAMP_MS + CYCLE_MS


@pytest.mark.parametrize("fault", ["spontaneous_reset", "second_node", "leaves_operational", "undefined_statusword"])
def test_the_others_stand_within_their_ramp_and_a_cycle_of_the_word(turning, fault):
    turning.victim = RIGHT
    turning.switch(fault)
    after = turning.collected("stop")[1]
    assert turning.stopped_after(LEFT) <= after + RAMP_MS + CYCLE_MS


def test_a_wrong_toggle_bit_of_node_guarding_stops_all(bench, tmp_path):
    edits = {
        "  heartbeat_producer: 100         # ms\n": "  guard_time: 100\n  life_time_factor: 3\n",
        "  heartbeat_consumer: true        # 0x1016": "  allow_unsupervised: true        # 0x1016",
    }
    robby = bench(config=copy_robby(tmp_path, bus=edits)).turning()
    robby.victim = RIGHT
    answers = [frame.data for label, frame in robby.bus.history if label == "drive 2" and frame.can_id == 0x702]
    inject(robby, f"702#{answers[-1].hex()}")
    event, after = robby.collected("guarding_toggle")
    assert "node 2 (right_drive)" in event.text
    assert after <= CYCLE_MS
    assert robby.stopped_after() <= after + CYCLE_MS + RAMP_MS + CYCLE_MS
    robby.until(lambda: robby.robot.nodes["right_drive"].ready, ms=4000)
    robby.goes_on()
