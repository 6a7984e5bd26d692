import contextlib
import sys

import pytest
from support.physicsbench import ROBBY, world_of
from support.physicsrobot import PhysicsRobot

from canopen_control.errors import ConfigError, NotEnabled
from canopen_control.physics import engine
from canopen_control.physics.physics_file import PhysicsError
from canopen_control.rpc.messages.drive import AddPayload


@pytest.fixture
def state_home(tmp_path, monkeypatch):
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path))
    return tmp_path


@pytest.fixture
def robot(request, state_home):
    physics_robot = PhysicsRobot(f"physics-{request.node.name[:20]}", **getattr(request, "param", {}))
    yield physics_robot
    physics_robot.close()


def test_without_mujoco_it_is_reported_with_what_to_install(tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "mujoco", None)
    monkeypatch.setattr("importlib.util.find_spec", lambda _name: None)
    with pytest.raises(ConfigError, match=r"pip install 'canopen-control\[physics\]'"):
        engine.make(tmp_path / "physics.yml")


def test_a_joint_that_is_not_there_is_reported_with_its_line_and_the_nearest(tmp_path):
    with pytest.raises(PhysicsError) as caught:
        world_of(tmp_path, ROBBY.replace("joint: left_wheel_joint", "joint: left_weel_joint"))
    assert "physics.yml:5:8: " in str(caught.value)
    assert "has no joint 'left_weel_joint' (did you mean 'left_wheel_joint'?)" in str(caught.value)


def test_a_joint_that_no_drive_moves_is_reported(tmp_path):
    with pytest.raises(PhysicsError, match="joint caster_joint is fixed"):
        world_of(tmp_path, ROBBY.replace("joint: left_wheel_joint", "joint: caster_joint"))


def test_a_robot_drives_and_has_its_true_pose(robot):
    robot.start()
    robot.hold(5.0, 5.0, ms=1500)
    base = robot.world.describe().base
    wheel = robot.joint(2).states["position"].value
    assert wheel > 5.0
    assert base.x == pytest.approx(0.035 * wheel, rel=0.03)  # the last report is up to a cycle old
    assert robot.texts("fault") == []


def test_the_torque_of_a_drive_is_read_on_the_bus(robot):
    robot.start()
    robot.hold(5.0, 5.0, ms=800)
    robot.plant(2).external = -500.0
    robot.hold(5.0, 5.0, ms=600)
    assert robot.plant(2).torque == pytest.approx(500.0, rel=0.2)


@pytest.mark.rest
@pytest.mark.parametrize(
    "robot", [{"config": "diffbot_sim", "controllers": ["diff_drive_base_controller"]}], indirect=True
)
def test_a_blocked_wheel_stops_its_base_before_its_drive_reports_a_fault(robot):
    robot.start()
    twist(robot, 0.3, ms=1500)
    assert robot.texts("fault") == []
    robot.plant(3).stalled = True
    twist(robot, 0.3, ms=2500)
    assert any(
        "although a motion is commanded, so the base would leave its path" in event.text for event in robot.events
    )
    assert robot.texts("fault") == []
    assert abs(robot.plant(2).velocity) < 100.0  # the other wheel was stopped too
    assert not robot.joint(2).following


@pytest.mark.rest
def test_a_blocked_wheel_without_a_base_is_a_fault_of_its_drive_an_emcy_and_a_stop_of_the_robot(robot):
    robot.start()
    robot.hold(5.0, 5.0, ms=1500)
    assert robot.texts("fault") == []
    robot.plant(3).stalled = True
    robot.hold(5.0, 5.0, ms=6000)
    assert robot.drives[3].emcy.active
    assert any("0x8611" in text or "0x2310" in text for text in [event.text for event in robot.events])
    assert abs(robot.plant(2).velocity) < 100.0  # the other wheel was stopped too
    assert not robot.joint(2).following


@pytest.mark.rest
def test_a_payload_five_times_the_robot_on_a_ramp_is_too_much_for_its_motors(state_home):
    hall = state_home / "hall.yml"
    hall.write_text("ramps: [{at: [0.15, 0], angle: 18, length: 3, width: 2}]")
    robot = PhysicsRobot("physics-payload", hall=hall)
    try:
        robot.start()
        robot.hold(6.0, 6.0, ms=2500)
        alone = robot.world.describe().base
        assert alone.z > 0.03  # it climbs, as it is
        assert robot.texts("fault") == []
        robot.world.act(AddPayload(mass=5 * 3.3, position=(0.0, 0.0, 0.05)))
        robot.hold(6.0, 6.0, ms=3500)
        assert any("EMCY 0x2310 (continuous over-current)" in event.text for event in robot.events)
        assert any(event.text.startswith("stopping left_wheel_joint, right_wheel_joint") for event in robot.events)
        assert not robot.joint(2).following
    finally:
        robot.close()


def twist(robot, speed, ms):
    """Command a twist again every 100 ms, whether or not the robot takes it."""
    for _ in range(ms // 100):
        with contextlib.suppress(NotEnabled):
            robot.robot.command("diff_drive_base_controller", [speed, 0.0], "test")
        robot.run(100)
