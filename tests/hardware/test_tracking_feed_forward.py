"""Feed-forward with positions: values of 0x60B1 and 0x60B2, and their reset."""

import pytest
from support.arm6 import ENDS, JOINTS, copy_arm, planned
from support.robots import Bench

from canopen_control.controllers.command_timeout import GoalState
from canopen_control.controllers.trajectory.goal import TrajectoryGoal
from canopen_control.errors import CanopenError
from canopen_control.hardware.axis_statechart import Action

NODES = (2, 3, 4, 5, 6, 7)
POSITION_COMMAND = '<command_interface name="position"/>'


def fed_arm(folder, asked="[velocity]", interfaces=("position", "velocity"), mode=8):
    """Copy arm6 with a trajectory controller that gives these interfaces."""
    config = copy_arm(folder)
    edits = {
        "bus.yml": ("  position_mode: 8 ", f"  feed_forward: {asked}\n  position_mode: {mode} "),
        "arm6.urdf": (
            POSITION_COMMAND,
            "".join(f'<command_interface name="{interface}"/>' for interface in interfaces),
        ),
        "ros2_controllers.yaml": ("command_interfaces: [position]", f"command_interfaces: [{', '.join(interfaces)}]"),
    }
    for name, (old, new) in edits.items():
        path = config / name
        text = path.read_text()
        assert old in text, old
        path.write_text(text.replace(old, new))
    return config


@pytest.fixture(scope="module")
def config(tmp_path_factory):
    return fed_arm(tmp_path_factory.mktemp("fed"))


@pytest.fixture
def arm(config):
    bench = Bench("fed", config=config, drives=NODES)
    bench.start()
    bench.until(lambda: all(joint.enabled for joint in bench.robot.joints.values()))
    bench.run(100)
    yield bench
    bench.close()


def send(arm, end=ENDS, seconds=2.0):
    begin = [arm.robot.registry.state(f"{joint}/position").value for joint in JOINTS]
    goal = TrajectoryGoal(planned(begin, end, seconds))
    arm.robot.manager.get("arm_controller").send_goal(goal, arm.reactor.now())
    return goal


def offsets(arm):
    return [arm.joint(node).axis.velocity_offset.value for node in NODES]


@pytest.mark.rest
def test_the_planned_velocity_goes_to_the_drive_in_its_units_and_is_gone_at_the_end(arm):
    goal, most = send(arm), 0.0
    while not goal.ended:
        arm.run(20)
        joint = arm.robot.joints["joint_1"]
        velocity = joint.commands["velocity"].value
        assert joint.axis.velocity_offset.value == round(velocity * joint.axis.scale.vel_to_dev)
        most = max(most, velocity)
        assert arm.drives[2].get(0x60B1) == pytest.approx(velocity * joint.axis.scale.vel_to_dev, abs=1e5)
    assert goal.state is GoalState.SUCCEEDED
    assert most == pytest.approx(1.875 * ENDS[0] / 2.0, rel=0.01)
    arm.run(100)
    assert offsets(arm) == [0] * 6
    assert [arm.drives[node].get(0x60B1) for node in NODES] == [0] * 6


@pytest.mark.rest
@pytest.mark.parametrize("ends", ["stop", "disable", "halt", "quick-stop", "lost"])
def test_whatever_ends_the_motion_takes_it_away_in_the_same_cycle(arm, ends):
    send(arm)
    arm.run(1000)
    assert all(offsets(arm))
    joint = arm.robot.joints["joint_1"]
    if ends == "stop":
        arm.robot.stop(lambda _error: None)
    elif ends == "lost":
        arm.power_off(3)
        arm.until(lambda: not arm.joint(3).node.ready)
    else:
        arm.robot.axis(Action(ends), "all", lambda _error: None)
    arm.run(41)
    assert joint.axis.velocity_offset.value == 0
    assert arm.drives[2].get(0x60B1) == 0
    arm.run(2000)
    assert offsets(arm) == [0] * 6


@pytest.mark.rest
def test_a_stream_that_is_at_standstill_ends_it(arm):
    joint = arm.robot.joints["joint_1"]
    send(arm)
    arm.run(1000)
    feed, position = joint.targets.feed_forward, joint.commands["position"]
    joint.commands["velocity"].value = 0.5
    for cycle in range(8):
        feed.follow(position, 0.02)
        assert bool(joint.axis.velocity_offset.value) == (cycle <= 2), cycle
    position.value += 0.001
    feed.follow(position, 0.02)
    assert joint.axis.velocity_offset.value != 0


@pytest.mark.rest
def test_what_another_controller_gives_is_not_sent_and_that_is_reported_once(arm):
    joint = arm.robot.joints["joint_1"]
    send(arm)
    arm.run(1000)
    joint.commands["velocity"].owner = "somebody_else"
    arm.run(500)
    assert joint.axis.velocity_offset.value == 0
    (text,) = arm.texts("feed_forward")
    assert "its velocity is commanded by somebody_else but its position by arm_controller" in text


@pytest.mark.rest
def test_a_velocity_beyond_the_drive_is_cut_and_none_that_does_not_fit_is_sent(arm):
    joint = arm.robot.joints["joint_1"]
    send(arm)
    arm.run(1000)
    position, feed = joint.commands["position"], joint.targets.feed_forward
    joint.axis.limits.take_velocity(1000.0, joint.axis.scale)
    joint.commands["velocity"].value = 2.0
    position.value += 0.001
    feed.follow(position, 0.02)
    assert joint.axis.velocity_offset.value == 1000
    for bad in (float("nan"), 1e12):
        joint.commands["velocity"].value = bad
        position.value += 0.001
        feed.follow(position, 0.02)
        assert joint.axis.velocity_offset.value == 0


def test_torque_feed_forward_is_zero_when_the_positions_end(tmp_path):
    config = fed_arm(tmp_path, asked="[effort]", interfaces=("position", "effort"))
    path = config / "ros2_controllers.yaml"
    path.write_text(
        path.read_text().replace("command_interfaces: [position, effort]", "command_interfaces: [position]")
    )
    bench = Bench("torque", config=config, drives=NODES)
    bench.start()
    joint = bench.robot.joints["joint_1"]
    joint.targets.claim("position", ["effort"])
    joint.commands["position"].value, joint.commands["effort"].value = 0.1, 2.0
    joint.commands["effort"].owner = joint.commands["position"].owner
    joint.targets.feed_forward.follow(joint.commands["position"], 0.02)
    assert joint.axis.torque_offset.value == round(2.0 * joint.axis.scale.eff_to_dev)
    joint.targets.hold()
    assert joint.axis.torque_offset.value == 0
    bench.close()


@pytest.mark.rest
@pytest.mark.parametrize(
    ("requested", "mode", "why"),
    [
        ("[]", 8, r"map 0x60FF, or set feed_forward: \[velocity\] for use"),
        ("[velocity]", 1, "only in mode CSP, but position is commanded in PP"),
    ],
)
def test_where_it_cannot_be_the_claim_is_refused_with_what_to_do(tmp_path, requested, mode, why):
    config = fed_arm(tmp_path, asked=requested, mode=mode)
    with pytest.raises(CanopenError, match=why):  # noqa: PT012 - it may fail when it is made, or when it starts
        bench = Bench("refused", config=config, drives=NODES)
        try:
            bench.robot.start()
            bench.until(lambda: bench.robot.failure is not None)
            raise CanopenError(bench.robot.failure)
        finally:
            bench.close()
