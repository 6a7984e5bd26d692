"""Rows 32 to 38: set-points, targets, limits, homing and positions."""

import math

import pytest
from support.faultbench import CYCLE_MS, LEFT, RAMP_MS, RIGHT, SPEED
from support.generic import write_generic
from support.observers import Observer

from canopen_control.hardware.axis_statechart import Action

PP, CSP, CSV, HM = 1, 8, 9, 6


@pytest.fixture
def servo(bench, tmp_path):
    """Return what starts the robot of two servo drives under a controller."""

    def start(controller, **how):
        robby = bench(config=write_generic(tmp_path, **how), drives=(2, 3), controllers=[controller])
        robby.victim = 2
        robby.start()
        robby.events.clear()
        return robby

    return start


def positions(robby, value, ms):
    for _ in range(ms // 10):
        robby.robot.command("position", [value, value], "test")
        robby.run(10)


def controlwords(robby, node):
    master = [frame for label, frame in robby.bus.history if label == "master" and frame.can_id == 0x200 + node]
    return [frame.data[0] | frame.data[1] << 8 for frame in master]


def test_row_32_without_an_acknowledgement_bit_4_goes_back_and_the_set_point_is_given_up(servo):
    robby = servo("position", modes="position_mode: 1")
    robby.switch("pp_ack_missing")
    positions(robby, 1.0, 1500)
    event, after = robby.collected("set_point")
    while "not acknowledged" not in event.text:
        robby.events.remove(event)
        event, after = robby.collected("set_point")
    assert "node 2 (drive_one)" in event.text
    assert 1000 <= after <= 1200
    assert controlwords(robby, 2)[-1] & 0x10 == 0
    assert robby.joint(3).states["position"].value == pytest.approx(1.0, abs=0.001)


@pytest.mark.rest
def test_row_32_an_acknowledgement_that_is_set_already_is_waited_for_to_fall(servo):
    robby = servo("position", modes="position_mode: 1")
    robby.switch("pp_ack_stuck")
    robby.bus.clear_history()
    positions(robby, 1.0, 6000)
    assert robby.joint(2).states["position"].value == pytest.approx(0.0, abs=0.001), (
        "no target before bit 12 was seen 0"
    )
    assert any("stayed 1 before the set-point" in event.text for event in robby.found("set_point"))


def test_row_33_reached_counts_only_after_the_acknowledgement_of_this_set_point(servo):
    robby = servo("position", modes="position_mode: 1")
    robby.switch("target_reached_stale")
    robby.robot.command("position", [3.0, 3.0], "test")
    robby.until(lambda: any("reached" in event.text for event in robby.found("set_point") if "drive_one" in event.text))
    texts = [event.text for event in robby.found("set_point") if "drive_one" in event.text]
    assert "acknowledged" in texts[0]
    times = [event.time for event in robby.found("set_point") if "drive_one" in event.text]
    assert times[1] - times[0] >= 3 * 10_000_000, "some SYNCs at least"


def test_row_34_the_targets_are_the_actual_position_when_it_is_enabled(servo):
    robby = servo("position")
    positions(robby, 0.5, 1500)
    assert robby.axis(Action.DISABLE) is None
    robby.switch("hand_moved")
    robby.run(100)
    moved = robby.drives[2].get(0x6064)
    assert abs(moved - robby.drives[3].get(0x6064)) >= 400
    robby.robot.switch([], ["position"], strict=True)
    assert robby.axis(Action.ENABLE) is None
    robby.run(500)
    assert robby.drives[2].get(0x607A) == moved
    assert robby.drives[2].get(0x6064) == moved, "it did not jump back"
    assert not robby.found("fault")


def test_row_35_no_velocity_is_left_in_the_drive_after_a_disable(turning):
    turning.hold(0.0, 0.0, ms=100)
    assert turning.axis(Action.DISABLE) is None
    turning.run(200)
    assert turning.drives[LEFT].get(0x60FF) == turning.drives[RIGHT].get(0x60FF) == 0
    turning.drives[LEFT].store.set(0x60FF, 0, 3000)  # left by an earlier master
    fastest = []
    turning.robot.observers.append(Observer(after_cycle=lambda _now: fastest.append(abs(turning.speed(LEFT)))))
    assert turning.axis(Action.ENABLE) is None
    turning.run(300)
    assert max(fastest) < 1


def test_row_36_wheels_stop_together_at_a_limit_switch_and_only_the_other_direction_is_followed(turning):
    turning.victim = RIGHT  # it turns in its positive direction
    turning.switch("limit_switch")
    event, after = turning.collected("limit")
    assert after <= 3 * CYCLE_MS
    assert "positive side" in event.text
    assert "0xFF01" in turning.texts("emcy")[0]
    turning.hold(10.0, 10.0, ms=1000)
    assert turning.standing()
    assert len(turning.found("limit")) == 1
    turning.run(2500)
    assert turning.axis(Action.ENABLE) is None
    turning.hold(-10.0, -10.0, ms=1000)
    assert turning.speed(RIGHT) < 0
    assert turning.speed(LEFT) > 0
    assert len(turning.found("limit")) == 1
    assert turning.found("limit_left")


def test_row_36_a_position_axis_at_its_limit_lets_the_others_continue(servo):
    robby = servo("position")
    positions(robby, 20.0, 300)
    robby.switch("limit_switch", node=2)
    positions(robby, 20.0, 300)
    (event,) = robby.found("limit")
    assert "only motion in the other direction is permitted" in event.text
    robby.run(500)
    assert not robby.found("stop")
    assert robby.joint(2).enabled
    assert robby.joint(3).enabled


def test_row_36_software_limits_are_read_and_respected(servo):
    limits = "- {index: 0x607D, sub_index: 1, value: -1000}\n    - {index: 0x607D, sub_index: 2, value: 5000}"
    robby = servo("position", sdo=limits)
    positions(robby, 1.0, 1500)  # 10430 counts
    assert robby.drives[2].get(0x607A) == 5000
    assert robby.drives[2].get(0x6064) == pytest.approx(5000, abs=5)
    positions(robby, -1.0, 1500)
    assert robby.drives[2].get(0x6064) == pytest.approx(-1000, abs=5)


def test_row_36_the_largest_velocity_is_read_and_respected(servo):
    robby = servo("velocity", sdo="- {index: 0x607F, sub_index: 0, value: 8000}")
    robby.robot.command("velocity", [5.0, 5.0], "test")
    robby.run(500)
    assert robby.drives[2].get(0x60FF) == 8000
    assert robby.speed(2) == pytest.approx(8000, rel=0.01)


def test_row_36_torque_limits_are_read_and_respected(servo):
    robby = servo(
        "effort", sdo="- {index: 0x60E0, sub_index: 0, value: 300}\n    - {index: 0x60E1, sub_index: 0, value: 200}"
    )
    robby.robot.command("effort", [900.0, -900.0], "test")
    robby.run(100)
    assert robby.drives[2].get(0x6071) == 300
    assert robby.drives[3].get(0x6071) == -200


def test_row_37_a_homing_that_fails_reports_this_and_gives_the_mode_back(servo):
    robby = servo("velocity")
    robby.switch("homing_fails")
    reason = robby.axis_refused(Action.HOME, "2", method=17)
    assert "the drive reports a homing error" in reason
    robby.run(50)
    joint = robby.joint(2)
    assert not joint.homed
    assert joint.machine.mode == robby.drives[2].get(0x6061) == CSV
    assert controlwords(robby, 2)[-1] & 0x10 == 0
    assert joint.enabled, "as it was before"


@pytest.mark.rest
def test_row_37_a_homing_without_end_is_ended_by_its_time(servo):
    robby = servo("velocity", extra="homing_timeout_seconds: 3.0")
    robby.switch("homing_endless")
    reason = robby.axis_refused(Action.HOME, "2", method=17)
    assert "not done in time" in reason
    assert 3000 <= (robby.reactor.now() - robby.began) / 1e6 <= 3500
    robby.run(1500)
    assert robby.standing()
    assert robby.joint(2).machine.mode == CSV


def test_row_37_a_homing_that_is_interrupted_leaves_the_axis_not_homed(servo):
    robby = servo("velocity", extra="homing_timeout_seconds: 30.0")
    robby.switch("homing_endless")
    answers = []
    robby.robot.axis(Action.HOME, "2", answers.append, method=17)
    robby.run(500)
    assert not robby.standing(2)
    robby.robot.stop(lambda _error: None)
    robby.until(lambda: answers)
    assert "stopped" in answers[0]
    robby.disabled_after()
    assert not robby.joint(2).homed


def test_row_37_homing_ends_at_home_and_counts_from_there(servo):
    robby = servo("velocity")
    assert robby.axis(Action.HOME, "all", method=17) is None
    robby.run(100)
    for node in (2, 3):
        joint = robby.joint(node)
        assert joint.homed
        assert joint.states["position"].value == pytest.approx(robby.drives[node].get(0x6064) * math.tau / 65536)
        assert joint.machine.mode == CSV
        assert robby.drives[node].get(0x6098) == 17


def test_row_37_methods_and_modes_that_a_drive_lacks_are_refused_before_it_is_touched(servo):
    robby = servo("velocity")
    robby.bus.clear_history()
    assert "0x60E3 lists" in robby.axis_refused(Action.HOME, "2", method=7)
    assert "CSTCA is not supported" in robby.axis_refused(Action.MODE, "2", mode="CSTCA")
    assert "no mode of operation" in robby.axis_refused(Action.MODE, "2", mode="XYZ")
    assert not [frame for _, frame in robby.bus.history if frame.can_id == 0x602]


def test_row_38_a_jump_of_the_position_is_an_error_and_no_odometry(turning):
    joint = turning.joint(LEFT)
    turning.switch("position_jump")
    before = joint.states["position"].value
    event, after = turning.collected("position_jump")
    assert after <= 3 * CYCLE_MS
    assert "jumped by" in event.text
    assert abs(joint.states["position"].value - before) < 1.0
    assert turning.stopped_after() <= after + RAMP_MS + 2 * CYCLE_MS
    turning.disabled_after()
    turning.goes_on()


def test_row_38_the_position_continues_where_32_bits_wrap(bench):
    robby = bench(drives=(LEFT,))
    robby.power_on(RIGHT, ["position_wrap"])
    robby.start()
    joint = robby.joint(RIGHT)
    robby.run(100)
    last, raws = joint.states["position"].value, set()
    for _ in range(100):
        robby.command(10.0, 10.0)
        robby.run(20)
        step = joint.states["position"].value - last
        last = joint.states["position"].value
        raws.add(joint.axis.raw_position > 0)
        assert -0.01 <= step <= 0.3
    assert raws == {True, False}, "the counter has wrapped"
    assert robby.speed(RIGHT) == pytest.approx(SPEED, rel=0.01)
    assert not robby.found("position_jump")


def test_row_38_a_drive_that_restarts_at_zero_does_not_move_the_joint(turning):
    joint = turning.joint(LEFT)
    turning.switch("spontaneous_reset")
    turning.collected("restarted")
    before = joint.axis.unwrap.count
    turning.until(lambda: joint.node.ready)
    turning.run(500)
    assert joint.axis.unwrap.count == before
    assert not turning.found("position_jump")
    assert joint.axis.raw_position != before
