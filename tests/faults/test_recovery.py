"""Settings of bus.yml for the recovery, and for the joints that stop together."""

import pytest
from support.faultbench import CYCLE_MS, LEFT, RAMP_MS, RIGHT
from support.generic import write_generic
from support.observers import Observer
from support.robots import copy_robby

from canopen_control.cia301.nmt import NmtCommand
from canopen_control.errors import NotEnabled
from canopen_control.hardware.axis_statechart import Action

BASE = "robby_base_controller"
RECOVERY = {"  position_mode": "  recovery: enable\n  position_mode"}


@pytest.fixture
def recovering(bench, tmp_path):
    """Return a robot that enables again by itself what a lost node has stopped."""
    return bench(config=copy_robby(tmp_path, bus=RECOVERY)).turning()


def test_with_recovery_enable_a_node_that_is_back_is_enabled_again(recovering):
    recovering.switch("spontaneous_reset")
    recovering.stopped_after()
    recovering.until(lambda: recovering.found("recovered"))
    assert "recovery: enable" in recovering.found("recovered")[0].text
    recovering.hold(10.0, 10.0, ms=1000)
    assert not recovering.standing()
    assert recovering.speed(LEFT) == -recovering.speed(RIGHT)


def test_a_users_stop_in_between_ends_the_matter(recovering):
    recovering.switch("silent")
    recovering.collected("stop")
    recovering.robot.stop(lambda _error: None)
    recovering.run(1000)
    recovering.switch("silent", on=False)
    recovering.until(lambda: recovering.robot.nodes["left_drive"].ready, ms=4000)
    recovering.axis(Action.FAULT_RESET)
    recovering.expect_stays_down(2000)
    assert not recovering.found("recovered")


def test_a_node_that_nmt_stop_has_taken_out_of_use_is_not_enabled_again(bench, tmp_path):
    config = write_generic(tmp_path, modes="velocity_mode: 3", extra="recovery: enable")
    made = bench(config=config, drives=(2, 3), controllers=["velocity"])
    made.start()
    made.drives[2].store.set(0x6007, 0, 2)  # disable voltage: it does not return in a fault
    node = made.robot.nodes["drive_one"]
    node.stop_as_last_resort(made.reactor.now())
    made.run(2000)
    assert made.texts("stop")[0].endswith(
        "nmt start drive_one, then canopen-control axis fault-reset all if a drive "
        "is in fault, then canopen-control axis enable all"
    )
    node.command(NmtCommand.START, made.reactor.now())
    made.until(lambda: node.ready, ms=4000)
    made.run(2000)
    assert not made.joint(2).machine.fault
    assert not made.texts("recovered")
    assert not made.joint(2).enabled


def test_a_fault_is_never_recovered_from_by_itself(recovering):
    recovering.switch("drive_fault")
    recovering.disabled_after()
    recovering.switch("drive_fault", on=False)
    assert recovering.axis(Action.FAULT_RESET) is None
    recovering.expect_stays_down(2000)


def test_without_the_policy_the_drive_waits(turning):
    turning.switch("spontaneous_reset")
    turning.collected("stop")
    turning.until(lambda: turning.robot.nodes["left_drive"].ready)
    turning.stopped_after()
    turning.expect_stays_down(2000)


def test_controllers_stay_loaded_and_active_through_it_all(turning):
    before = {info.name: info.state for info in turning.robot.manager.list()}
    turning.switch("spontaneous_reset")
    turning.collected("stop")
    turning.until(lambda: turning.robot.nodes["left_drive"].ready)
    assert {info.name: info.state for info in turning.robot.manager.list()} == before
    turning.goes_on()


def test_drives_stop_and_are_disabled_in_the_same_cycle(turning):
    observed = []
    turning.robot.observers.append(
        Observer(
            after_cycle=lambda _now: observed.append(
                tuple(joint.axis.controlword.value for joint in turning.robot.joints.values())
            )
        )
    )
    turning.robot.stop(lambda _error: None)
    turning.disabled_after()
    assert all(left == right for left, right in observed)
    assert (0x0F, 0x0F) in observed
    assert (0x07, 0x07) in observed


def test_drives_are_enabled_in_the_same_cycle_however_long_each_takes(bench):
    robby = bench()
    robby.start()
    assert robby.axis(Action.DISABLE) is None
    robby.run(200)
    robby.drives[LEFT].drives[0].power.transition_delay_ns.inject(300_000_000)
    observed = []
    robby.robot.observers.append(
        Observer(
            after_cycle=lambda _now: observed.append(
                tuple(joint.axis.controlword.value for joint in robby.robot.joints.values())
            )
        )
    )
    assert robby.axis(Action.ENABLE) is None
    assert all(left == right for left, right in observed if 0x0F in (left, right))


def test_a_group_of_its_own_does_not_stop_the_others(bench, tmp_path):
    robby = bench(config=write_generic(tmp_path, groups=True), drives=(2, 3), controllers=["velocity"])
    robby.victim = 2
    robby.start()
    robby.robot.command("velocity", [2.0, 2.0], "test")
    robby.run(500)
    robby.switch("drive_fault")
    robby.collected("stop")
    robby.run(1000)
    assert robby.standing(2)
    assert not robby.standing(3)
    assert robby.joint(3).enabled
    robby.robot.command("velocity", [3.0, 3.0], "test")  # the other one continues, and a disabled joint blocks nothing
    robby.run(300)
    assert robby.velocity(3) == pytest.approx(3.0, rel=0.02)
    robby.switch("drive_fault", on=False)
    assert robby.axis(Action.FAULT_RESET) is None
    assert robby.axis(Action.ENABLE) is None
    robby.run(300)
    assert robby.standing(2)


@pytest.mark.parametrize(("action", "stops"), [("stop", True), ("warn", False), ("ignore", False)])
def test_a_following_error_leads_to_what_bus_yml_specifies(bench, tmp_path, action, stops):
    config = write_generic(tmp_path, extra=f"following_error_action: {action}")
    robby = bench(config=config, drives=(2, 3), controllers=["position"])
    robby.start()
    robby.events.clear()
    robby.drives[2].drives[0].readings.statusword.forced.inject(1 << 13)
    robby.hosts[2].wake(robby.drives[2])
    robby.run(200)
    reported = robby.found("following_error")
    assert bool(reported) is (action != "ignore")
    assert bool(robby.found("stop")) is stops


def test_guarding_watches_a_drive_without_a_heartbeat(bench, tmp_path):
    edits = {
        "  heartbeat_producer: 100         # ms\n": "  guard_time: 100\n  life_time_factor: 3\n",
        "  heartbeat_consumer: true        # 0x1016": "  allow_unsupervised: true        # 0x1016",
    }
    robby = bench(config=copy_robby(tmp_path, bus=edits)).turning()
    assert robby.robot.nodes["left_drive"].config.supervision.guarded
    assert robby.robot.nodes["left_drive"].nmt_state is not None
    robby.switch("silent")
    event, after = robby.collected("guarding_lost")
    assert "no answer to node guarding" in event.text
    assert 200 <= after <= 300 + 100 + CYCLE_MS
    assert robby.stopped_after(RIGHT) <= after + RAMP_MS + 2 * CYCLE_MS


@pytest.mark.parametrize("position_feedback", ["true", "false"])
def test_a_base_waits_for_a_lost_drive_and_continues_once_it_is_enabled(bench, tmp_path, position_feedback):
    """Its feedback is unknown meanwhile: it stands, its pose does not jump, and no switch of controllers is needed."""
    edits = {"    position_feedback: true": f"    position_feedback: {position_feedback}"}
    config = copy_robby(tmp_path, controllers=edits)
    robby = bench(config=config, controllers=["joint_state_broadcaster", BASE])
    robby.start()
    rolling(robby)
    robby.switch("spontaneous_reset")
    robby.collected("stop")
    robby.until(lambda: robby.robot.nodes["left_drive"].ready)
    robby.run(500)
    base = robby.robot.manager.get(BASE)
    at = base.odometry.x
    assert BASE in robby.robot.manager.active
    assert not robby.found("error")
    with pytest.raises(NotEnabled, match="canopen-control axis enable all"):
        robby.robot.command(BASE, [0.3, 0.0], "test")
    assert robby.axis(Action.ENABLE) is None
    robby.run(500)
    assert robby.standing()
    assert base.odometry.x == pytest.approx(at, abs=0.01)
    rolling(robby)
    assert base.odometry.x > at + 0.1
    assert base.odometry.linear == pytest.approx(0.3, rel=0.05)


def test_a_base_resumes_by_itself_if_bus_yml_permits_it_for_the_drive(bench, tmp_path):
    robby = bench(config=copy_robby(tmp_path, bus=RECOVERY), controllers=["joint_state_broadcaster", BASE])
    robby.start()
    rolling(robby)
    robby.switch("spontaneous_reset")
    robby.collected("stop")
    robby.until(lambda: robby.found("recovered"))
    assert BASE in robby.robot.manager.active
    robby.run(300)
    assert robby.standing()  # the twist of before is forgotten
    rolling(robby)


def rolling(robby):
    for _ in range(10):
        robby.robot.command(BASE, [0.3, 0.0], "test")
        robby.run(100)
    assert not robby.standing()
