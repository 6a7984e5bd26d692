import mujoco
import pytest

from canopen_control.physics.physics_file import PhysicsError, SensorSettings
from canopen_control.physics.urdf_sensors import FORCE, IMU, INTERFACES, RANGE
from canopen_control.physics.world_sensors import SensorReader, WorldSensor, add_sensors

ARM = """<mujoco><option gravity="0 0 -10"/><worldbody>
  <geom name="wall" type="box" size="0.1 5 5" pos="3.1 0 0"/>
  <body name="base"><body name="tip" pos="1 0 0"><joint name="turn" axis="0 0 1"/>
    <geom type="sphere" size="0.1" mass="2"/></body></body></worldbody></mujoco>"""


def reader(*sensors, speed=0.0, steps=3, seed=0):
    spec = mujoco.MjSpec.from_string(ARM)
    add_sensors(spec, sensors, "robot.urdf")
    model = spec.compile()
    data = mujoco.MjData(model)
    data.qvel[0] = speed
    mujoco.mj_step(model, data, steps)
    return SensorReader(model, data, sensors, seed)


def test_an_imu_feels_gravity_and_turning():
    numbers = reader(WorldSensor("imu", SensorSettings(IMU, "tip")), speed=2.0, steps=1).read()["imu"]
    reported = dict(zip(INTERFACES[IMU], numbers, strict=True))
    assert reported["orientation.w"] == pytest.approx(1.0, abs=1e-3)
    assert reported["angular_velocity.z"] == pytest.approx(2.0, rel=1e-3)
    assert reported["linear_acceleration.z"] == pytest.approx(10.0, rel=1e-3)


def test_a_range_finder_looks_ahead_and_reports_when_there_is_nothing():
    near, far = (
        WorldSensor("near", SensorSettings(RANGE, "tip", reach=5.0)),
        WorldSensor("far", SensorSettings(RANGE, "tip", reach=5.0)),
    )
    assert reader(near).read()["near"] == (pytest.approx(2.0, abs=1e-3),)
    spec = mujoco.MjSpec.from_string(ARM.replace('pos="3.1 0 0"', 'pos="-9 0 0"'))
    add_sensors(spec, [far], "robot.urdf")
    model = spec.compile()
    data = mujoco.MjData(model)
    mujoco.mj_step(model, data)
    assert SensorReader(model, data, [far]).read()["far"] == (-1.0,)


def test_a_force_torque_sensor_carries_the_weight():
    reported = dict(
        zip(INTERFACES[FORCE], reader(WorldSensor("wrist", SensorSettings(FORCE, "tip"))).read()["wrist"], strict=True)
    )
    assert abs(reported["force.z"]) == pytest.approx(20.0, rel=1e-3)
    assert reported["torque.x"] == pytest.approx(0.0, abs=1e-6)


def test_a_link_that_is_not_there_is_reported():
    with pytest.raises(PhysicsError, match=r"sensor imu: no link 'tap' \(did you mean 'tip'\?\)"):
        reader(WorldSensor("imu", SensorSettings(IMU, "tap")))


GYRO = '<sensor><framequat name="my_quat" objtype="body" objname="tip"/><gyro name="my_gyro" site="here"/>{}</sensor>'
VELOCIMETER = '<velocimeter name="my_accel" site="here"/>'
ACCEL = '<accelerometer name="my_accel" site="here"/>'


def in_scene(parts, sensor):
    text = ARM.replace('<joint name="turn"', '<site name="here"/><joint name="turn"')
    spec = mujoco.MjSpec.from_string(text.replace("</mujoco>", GYRO.format(parts) + "</mujoco>"))
    add_sensors(spec, [sensor], "robot.urdf")
    model = spec.compile()
    data = mujoco.MjData(model)
    data.qvel[0] = 2.0
    mujoco.mj_step(model, data)
    return model.nsensor, SensorReader(model, data, [sensor]).read()[sensor.name]


def test_sensors_that_a_scene_has_are_read_by_their_names_and_none_is_added():
    imu = WorldSensor("imu", SensorSettings(IMU, "nowhere", scene="my"))
    count, numbers = in_scene(ACCEL, imu)
    assert count == 3
    assert numbers[6] == pytest.approx(2.0, rel=1e-3)
    assert numbers[9] == pytest.approx(10.0, rel=1e-3)


def test_where_the_scene_has_not_all_of_them_the_link_measures():
    assert in_scene("", WorldSensor("imu", SensorSettings(IMU, "tip", scene="my")))[0] == 5
    with pytest.raises(PhysicsError, match="sensor imu: no link 'nowhere'"):
        in_scene("", WorldSensor("imu", SensorSettings(IMU, "nowhere", scene="my")))


def test_another_sensor_of_that_name_is_reported():
    with pytest.raises(PhysicsError, match="sensor imu: my_accel of the scene is not of type accelerometer"):
        in_scene(
            '<velocimeter name="my_accel" site="here"/>', WorldSensor("imu", SensorSettings(IMU, "tip", scene="my"))
        )
