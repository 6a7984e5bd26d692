import math

import mujoco
import pytest

from canopen_control.errors import ConfigError, ControlError
from canopen_control.hardware.driverless_system import SimulatedSystem
from canopen_control.physics.physics_file import PhysicsError
from canopen_control.physics.plugin_robot import (
    LidarScanner,
    LidarSettings,
    axes_of,
    camera_notes,
    make_simulated,
    sensors_of,
    tag_lidars,
)
from canopen_control.rpc.messages.drive import AddPayload, BlockJoint, PushRobot
from canopen_control.urdf.description import parse_description
from canopen_control.urdf.document import ElementPlace
from canopen_control.urdf.ros2_control import ControlJoint, Ros2ControlSystem

ANGLES = {"min_angle": "-1.5", "max_angle": "1.5", "angle_increment": "0.5"}


def found(parameters, **hardware):
    part = ControlJoint("lidar", parameters, place=ElementPlace(7, 5))
    return tag_lidars(Ros2ControlSystem("robot", "system", "plugin", hardware, (), (part,)), "base", "robot.urdf")


def test_everything_can_be_reported():
    more = {"frame_name": "laser", "range_min": "0.1", "range_max": "8", "laserscan_topic": "/front", "noise": "0.01",
            "seed": "3"}  # fmt: skip
    (lidar,) = found(ANGLES | more, lidar_publish_rate="20")
    assert (lidar.frame, lidar.topic, lidar.range_min, lidar.range_max) == ("laser", "/front", 0.1, 8.0)
    assert (lidar.rate, lidar.noise, lidar.seed) == (20.0, 0.01, 3)


@pytest.mark.parametrize(
    ("changed", "text"),
    [
        ({"min_angle": "left"}, "min_angle is 'left'; it must be a finite number"),
        ({"max_angle": "inf"}, "max_angle is 'inf'"),
        ({"max_angle": "-2"}, "max_angle -2 is below min_angle -1.5"),
        ({"angle_increment": "0"}, "angle_increment is 0; it must be above 0"),
        ({"angle_increment": "-0.1"}, "angle_increment is -0.1"),
        ({"angle_increment": "1e-5"}, "it has 300001 rays; at most 10000 are possible"),
        ({"angle_increment": "1e-320"}, "rays; at most 10000 are possible"),
        ({"range_min": "5", "range_max": "5"}, "range_min must be 0 or more, and below range_max"),
        ({"noise": "-1"}, "noise is -1; it must be 0 or more"),
        ({"seed": "0.5"}, "seed must be an integer of 0 or more"),
        ({"laserscan_topic": " "}, "laserscan_topic is empty"),
    ],
)
def test_what_is_wrong_is_reported_with_its_place(changed, text):
    with pytest.raises(PhysicsError) as reported:
        found(ANGLES | changed)
    assert str(reported.value).startswith("robot.urdf:7:5: sensor lidar: ")
    assert text in str(reported.value)


def test_all_that_is_missing_is_reported_at_once_and_a_rate_that_is_none():
    with pytest.raises(PhysicsError) as reported:
        found({"min_angle": "0"})
    assert [line.split(": ")[2].split(";")[0] for line in str(reported.value).splitlines()] == [
        "no max_angle",
        "no angle_increment",
    ]
    with pytest.raises(PhysicsError, match="lidar_publish_rate of its hardware is 0"):
        found(ANGLES, lidar_publish_rate="0")


def test_each_camera_is_reported_once():
    parts = [ControlJoint("eye", {"image_topic": "/eye"}), ControlJoint("other", {"mujoco_type": "camera"})]
    notes = camera_notes([*parts, ControlJoint("imu")], ["eye", "scene"])
    assert [note.split()[1] for note in notes] == ["eye", "other", "scene"]
    assert all("OpenGL" in note for note in notes)


SCENE_OF_LIDAR_SCAN = """<mujoco><worldbody>
  <geom name="wall" type="box" size="0.1 5 5" pos="3.1 0 0"/><geom type="box" size="0.5 0.5 5" pos="0 2.5 0"/>
  <body name="base"><freejoint/><geom type="sphere" size="0.2" mass="1"/><site name="laser" pos="0.5 0 0"/></body>
</worldbody></mujoco>"""


def scanner(frame="base", turned=0.0, low=-math.pi / 2, **more):
    model = mujoco.MjModel.from_xml_string(SCENE_OF_LIDAR_SCAN)
    data = mujoco.MjData(model)
    data.qpos[3:7] = [math.cos(turned / 2), 0.0, 0.0, math.sin(turned / 2)]
    mujoco.mj_forward(model, data)
    inputs = {"range_min": 0.1, "range_max": 10.0, "noise": 0.0, "seed": 0} | more
    settings = LidarSettings(
        "lidar", frame, "/scan", low, math.pi, math.pi / 2, rate=10.0, place="robot.urdf:7:5", **inputs
    )
    return LidarScanner(model, data, settings)


def test_each_ray_reports_how_far_it_reaches_and_minus_one_for_nothing():
    scan = scanner().scan(2.5)
    assert scan.ranges == pytest.approx([-1.0, 3.0, 2.0, -1.0])
    assert (scan.seconds, scan.topic, scan.frame_id, scan.scan_time) == (2.5, "/scan", "base", 0.1)


def test_it_turns_with_its_link_and_a_site_of_a_scene_is_a_frame_too():
    assert scanner(turned=math.pi / 2).scan(0.0).ranges == pytest.approx([3.0, 2.0, -1.0, -1.0])
    assert scanner("laser").scan(0.0).ranges == pytest.approx([-1.0, 2.5, -1.0, -1.0])


def test_noise_is_that_of_a_seed_and_restarts():
    lidar = scanner(noise=0.05, seed=1)
    first, second = lidar.scan(0.0).ranges, lidar.scan(0.0).ranges
    assert first[1] != second[1] != 3.0
    assert first[0] == -1.0
    lidar.begin()
    assert lidar.scan(0.0).ranges == first != scanner(noise=0.05, seed=2).scan(0.0).ranges


def test_a_frame_that_is_not_there_is_reported():
    message = r"robot\.urdf:7:5: sensor lidar: no link 'bse' for its frame_name \(did you mean 'base'\?\)"
    with pytest.raises(PhysicsError, match=message):
        scanner("bse")


ROBOT = """<robot name="arm">
  <link name="base"/>
  <joint name="swing" type="revolute"><parent link="base"/><child link="rod"/><origin xyz="0 0 2"/><axis xyz="0 1 0"/>
    <limit lower="-3" upper="3" effort="60" velocity="5"/></joint>
  <link name="rod"><inertial><origin xyz="0.3 0 0"/><mass value="2"/>
    <inertia ixx="0.01" iyy="0.05" izz="0.05" ixy="0" ixz="0" iyz="0"/></inertial></link>
  <ros2_control name="arm" type="system"><hardware><plugin>mujoco_ros2_control/MujocoSystemInterface</plugin></hardware>
    <joint name="swing"><command_interface name="position"/><command_interface name="velocity"/>
      <command_interface name="effort"/><state_interface name="position">
      <param name="initial_value">0.5</param></state_interface><state_interface name="velocity"/>
      <state_interface name="effort"/></joint>
    <sensor name="imu"><param name="frame_id">rod</param><state_interface name="orientation.w"/>
      <state_interface name="angular_velocity.y"/></sensor>
    <sensor name="other"><state_interface name="voltage"/></sensor>
  </ros2_control></robot>"""
MS = 1_000_000
SCENE = (
    '<mujoco><worldbody><body name="rod" pos="0 0 2"><joint name="swing" axis="0 1 0"/>'
    '<geom type="capsule" fromto="0 0 0 0.5 0 0" size="0.03" mass="2"/></body></worldbody></mujoco>'
)


class Moved:
    """A system on a simulated robot, stepped as a cycle does."""

    def __init__(self, interface, robot=ROBOT):
        self.description = parse_description(robot, "arm.urdf")
        self.tag = self.description.hardware[0]
        self.engine = make_simulated(self.description, self.tag)
        self.system = SimulatedSystem(self.tag, self.description.joints, engine=self.engine)
        self.system.configure()
        self.system.activate()
        self.system.perform_command_mode_switch([f"swing/{interface}"], [])
        self.command = next(item for item in self.system.command_interfaces if item.name == f"swing/{interface}")
        self.now = 0

    def go(self, value, seconds):
        for _ in range(round(seconds * 50)):
            self.command.value = value
            self.now += 20 * MS
            self.system.read(self.now, 0.02)
        return self.states()

    def states(self):
        return {interface.name: interface.value for interface in self.system.state_interfaces}


def test_a_position_is_gone_to_and_held_against_the_weight():
    moved = Moved("position")
    assert moved.engine.motor("swing").position == 0.5
    states = moved.go(0.6, 1.5)
    assert states["swing/position"] == pytest.approx(0.6, abs=2e-3)
    assert states["swing/effort"] == pytest.approx(-2.0 * 9.81 * 0.3 * 0.825, rel=0.05)  # cos 0.6


def test_a_velocity_is_kept_and_an_effort_moves_what_it_can():
    assert Moved("velocity").go(-0.5, 1.0)["swing/velocity"] == pytest.approx(-0.5, rel=0.02)
    states = Moved("effort").go(0.0, 0.3)
    assert states["swing/velocity"] > 0.5  # it falls


def test_a_reset_restores_the_start_to_the_bit_with_its_noise_and_clears_targets():
    moved = Moved("position", ROBOT.replace('name="frame_id">', 'name="noise">0.1</param><param name="frame_id">'))
    first = moved.go(0.9, 0.5)
    moved.system.reset("")
    assert moved.states()["swing/position"] == 0.5
    assert moved.states()["swing/velocity"] == 0.0
    assert moved.go(0.9, 0.5) == first


def test_a_payload_weighs_on_a_joint_until_the_reset():
    moved = Moved("position")
    light = moved.go(0.5, 0.5)["swing/effort"]
    moved.system.act(AddPayload(mass=2.0, on="rod", position=(0.3, 0.0, 0.0)))
    assert moved.go(0.5, 1.0)["swing/effort"] == pytest.approx(2.0 * light, rel=0.05)
    moved.system.reset("")
    assert moved.go(0.5, 0.5)["swing/effort"] == light


def test_a_push_is_felt_as_long_as_it_lasts():
    moved = Moved("position")
    light = moved.go(0.5, 0.5)["swing/effort"]
    moved.system.act(PushRobot(force=(0.0, 0.0, -20.0), on="rod", seconds=0.2))
    assert moved.go(0.5, 0.18)["swing/effort"] < 1.5 * light
    assert moved.go(0.5, 0.5)["swing/effort"] == pytest.approx(light, rel=0.05)


def test_a_joint_that_is_blocked_stays_and_is_released_again():
    moved = Moved("velocity")
    moved.go(0.0, 0.2)
    moved.system.act(BlockJoint(joint="swing"))
    before = moved.states()["swing/position"]
    assert moved.go(1.0, 0.5)["swing/position"] == pytest.approx(before, abs=0.02)
    moved.system.act(BlockJoint(joint="swing", on=False))
    assert moved.go(1.0, 0.5)["swing/position"] > before + 0.3
    moved.system.act(BlockJoint(joint="swing"))
    moved.system.reset("")
    assert moved.go(1.0, 0.5)["swing/velocity"] == pytest.approx(1.0, rel=0.05)


def test_what_is_not_there_is_reported_and_changes_nothing():
    moved = Moved("position")
    for act in (AddPayload(mass=1.0, on="rad"), PushRobot(force=(0.0, 1.0, 0.0), on="rad")):
        with pytest.raises(ConfigError, match=r"no link 'rad' \(did you mean 'rod'"):
            moved.system.act(act)
    with pytest.raises(ConfigError, match=r"no drive moves a joint 'sing' \(did you mean 'swing'"):
        moved.system.act(BlockJoint(joint="sing"))


def test_a_key_frame_is_where_its_model_specifies(tmp_path):
    scene = tmp_path / "scene.xml"
    scene.write_text(SCENE.replace("</mujoco>", '<keyframe><key name="up" qpos="-1.5"/></keyframe></mujoco>'))
    description = parse_description(ROBOT, "arm.urdf")
    engine = make_simulated(description, description.hardware[0], scene)
    engine.step(0.02)
    engine.reset("up")
    assert engine.motor("swing").position == -1.5
    with pytest.raises(ControlError, match=r"no key frame 'upp' \(did you mean 'up'"):
        engine.reset("upp")


def test_its_imu_measures_and_another_sensor_stays_as_it_was():
    moved = Moved("velocity")
    states = moved.go(0.5, 0.5)
    assert states["imu/angular_velocity.y"] == pytest.approx(0.5, rel=0.05)
    assert 0.5 < states["imu/orientation.w"] < 1.0
    assert states["other/voltage"] == 0.0


def test_what_is_simulated_is_read_of_the_tag():
    moved = Moved("position")
    assert list(axes_of(moved.tag)) == ["swing"]
    (imu,) = sensors_of(moved.description, moved.tag)
    assert (imu.name, imu.settings.kind, imu.settings.link) == ("imu", "imu", "rod")
    assert moved.engine.motor("nobody") is None
    assert moved.engine.sensed("other/voltage") is None


def test_the_step_does_not_depend_on_how_long_a_cycle_is():
    fast, slow = Moved("velocity"), Moved("velocity")
    fast.go(0.5, 0.4)
    for _ in range(4):
        slow.command.value = 0.5
        slow.now += 100 * MS
        slow.system.read(slow.now, 0.1)
    assert slow.states()["swing/position"] == pytest.approx(fast.states()["swing/position"], abs=1e-6)


@pytest.mark.parametrize("noise", ["much", "-1", "nan"])
def test_a_noise_that_is_none_is_reported(noise):
    text = ROBOT.replace('<param name="frame_id">', f'<param name="noise">{noise}</param><param name="frame_id">')
    with pytest.raises(PhysicsError, match="sensor imu: noise is"):
        make_simulated(parse_description(text), parse_description(text).hardware[0])


def test_a_scene_of_its_own_has_the_joints(tmp_path):
    scene = tmp_path / "scene.xml"
    scene.write_text(SCENE)
    description = parse_description(ROBOT, "arm.urdf")
    engine = make_simulated(description, description.hardware[0], scene)
    assert engine.motor("swing") is not None
    assert float(engine.model.body_mass.sum()) == pytest.approx(2.0)


class Spring:
    """A loop that notes what it is asked."""

    def __init__(self, gain):
        self.gain, self.errors, self.resets = gain, [], 0

    def compute(self, error, dt):
        self.errors.append((error, dt))
        return self.gain * error

    def reset(self):
        self.resets += 1


def test_a_loop_of_its_own_takes_the_place_of_the_servo_within_the_peak_torque():
    description = parse_description(ROBOT, "arm.urdf")
    weak, strong = Spring(1.0), Spring(1e6)
    loops = {"swing": {"position": weak, "velocity": strong}}
    engine = make_simulated(description, description.hardware[0], None, loops)
    motor = engine.motor("swing")
    motor.follow("position", 1.0, 0.02)
    engine.step(0.02)
    assert motor.effort == pytest.approx(weak.errors[-1][0])
    assert {dt for _, dt in weak.errors} == {0.001}
    motor.follow("velocity", 5.0, 0.02)
    engine.step(0.02)
    assert motor.effort == 60.0
    assert strong.resets == 1
    engine.reset("")
    assert strong.resets == 2
