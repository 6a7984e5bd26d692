import mujoco
import pytest

from canopen_control.physics.ground_contact import Ground
from canopen_control.physics.motor_estimate import Described, estimated_motors
from canopen_control.physics.physics_file import AxisSettings

ARM = """<mujoco><worldbody><body><joint name="swing" axis="0 1 0"/>
<geom type="sphere" size="0.01" pos="0.5 0 0" mass="2"/></body></worldbody></mujoco>"""


def motor(effort=0.0, said=None, **settings):
    model = mujoco.MjModel.from_xml_string(ARM)
    return estimated_motors(
        model, {"swing": AxisSettings("swing", 1000.0, **settings)}, {"swing": said or Described(effort)}, Ground((), 0)
    )["swing"]


def test_a_joint_gets_twice_what_its_weight_and_an_acceleration_need():
    result = motor()
    weight, inertia = 2.0 * 9.81 * 0.5, 2.0 * 0.5**2
    assert result.rated_torque == pytest.approx(2.0 * (weight + 10.0 * inertia), rel=0.05)
    assert result.peak_torque == pytest.approx(2.0 * result.rated_torque)
    assert result.brake


def test_the_effort_of_the_description_is_the_peak_and_the_file_wins():
    assert (motor(effort=8.0).peak_torque, motor(effort=8.0).rated_torque) == (8.0, 4.0)
    assert motor(effort=8.0, rated_torque=3.0, peak_torque=9.0).peak_torque == 9.0
    assert motor(rotor_inertia=1e-4, gear=10.0).rotor == pytest.approx(1e-2)


def test_friction_and_damping_are_the_settings_else_those_of_the_description_else_the_motors():
    described = Described(8.0, friction=0.3, damping=0.0)
    assert (motor(said=described).friction, motor(said=described).damping) == (0.3, 0.0)
    assert (motor(said=described, friction=0.1).friction, motor(said=described, damping=0.2).damping) == (0.1, 0.2)
    result = motor(effort=8.0)
    assert (result.friction, result.damping) == (pytest.approx(0.02 * 4.0), pytest.approx(0.001 * 4.0))
