"""joint_trajectory_controller sections as public robots have them load unmodified, and move the joints they name."""

from pathlib import Path

import pytest
import yaml
from canopen_control_bench.arm import planned

from canopen_control.check.checker import CheckOptions, check_robot
from canopen_control.controllers.command_timeout import GoalState
from canopen_control.controllers.trajectory.goal import TrajectoryGoal
from canopen_control.controllers.trajectory.point import JointTrajectory
from canopen_control.host.reactor import Reactor
from canopen_control.host.timer import ManualClock
from canopen_control.od.issues import Severity
from canopen_control.runtime.core import RobotCore, RobotState
from canopen_control.runtime.robot_files import find_robot
from canopen_control.runtime.setup import read_robot

SHAPES = yaml.safe_load((Path(__file__).parents[1] / "data" / "trajectory_shapes.yaml").read_text())
S = 1_000_000_000


def write_robot(folder, section):
    """Write a robot on mock hardware with this section, and the joints that it names."""
    joints, kinds = section["joints"], section["command_interfaces"]
    links = "".join(f"<link name='to_{joint}'/>" for joint in joints)
    limits = "<limit lower='-3' upper='3' velocity='3' effort='9'/>"
    moving = "".join(
        f"<joint name='{joint}' type='revolute'><parent link='base'/><child link='to_{joint}'/>"
        f"<axis xyz='0 0 1'/>{limits}</joint>"
        for joint in joints
    )
    commands = "".join(f"<command_interface name='{kind}'/>" for kind in kinds)
    states = "<state_interface name='position'/><state_interface name='velocity'/>"
    control = "".join(f"<joint name='{joint}'>{commands}{states}</joint>" for joint in joints)
    integrates = f"<param name='calculate_dynamics'>{str('position' not in kinds).lower()}</param>"
    plugin = f"<plugin>mock_components/GenericSystem</plugin>{integrates}"
    system = f"<ros2_control name='shape' type='system'><hardware>{plugin}</hardware>{control}</ros2_control>"
    (folder / "shape.urdf").write_text(f"<robot name='shape'><link name='base'/>{links}{moving}{system}</robot>")
    arm = {"type": "joint_trajectory_controller/JointTrajectoryController"}
    broadcaster = {"type": "joint_state_broadcaster/JointStateBroadcaster"}
    manager = {"update_rate": 100, "arm": arm, "joint_state_broadcaster": broadcaster}
    result = {"controller_manager": {"ros__parameters": manager}, "arm": {"ros__parameters": section}}
    (folder / "ros2_controllers.yaml").write_text(yaml.safe_dump(result, sort_keys=False))
    return find_robot(str(folder))


@pytest.mark.parametrize("name", SHAPES)
def test_it_loads_unmodified_and_follows_a_goal(tmp_path, name):
    section = {key: value for key, value in SHAPES[name].items() if key != "told"}
    with Reactor(ManualClock(S)) as reactor:
        robot = RobotCore(read_robot(write_robot(tmp_path, section)), reactor)
        robot.start()
        reactor.run_for(S)
        assert robot.state is RobotState.RUNNING, [event.text for event in robot.events.recent]
        joints = section["joints"]
        path = planned([0.0] * len(joints), [0.2] * len(joints), 1.0, 20)
        goal = TrajectoryGoal(JointTrajectory(joints, path.points))
        robot.send_goal("arm", goal, "test")
        reactor.run_for(3 * S)
        assert goal.state is GoalState.SUCCEEDED, goal.text
        places = [robot.registry.state(f"{joint}/position").value for joint in joints]
        robot.close()
    assert places == pytest.approx([0.2] * len(joints), abs=0.02)


@pytest.mark.parametrize("name", SHAPES)
def test_keys_without_effect_are_reported_and_no_others(tmp_path, name):
    section = dict(SHAPES[name])
    reported = section.pop("told", [])
    findings = check_robot(write_robot(tmp_path, section), CheckOptions()).findings
    assert not [str(finding) for finding in findings if finding.severity is Severity.ERROR]
    warnings = [str(finding) for finding in findings if "ros2_controllers.yaml" in str(finding)]
    for key in reported:
        assert any(f"{key!r}" in warning or f" {key} " in warning for warning in warnings), (key, warnings)
    assert bool(warnings) is bool(reported), warnings


def test_there_are_as_many_as_public_robots():
    assert len(SHAPES) == 13
