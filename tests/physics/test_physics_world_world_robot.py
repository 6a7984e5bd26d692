import pytest
from support.physicsbench import ROBBY, robby

from canopen_control.physics.physics_file import PhysicsError
from canopen_control.virtual.shaft import ShaftWorld

ENCODERS = ROBBY + 'encoders: {{"5": {{joint: left_wheel_joint, gear: 2, reversed: true}}}}\n'


def test_an_encoder_turns_with_the_joint_that_it_sits_on_behind_its_gear(tmp_path):
    axes = robby(tmp_path, ENCODERS)
    assert isinstance(axes.world, ShaftWorld)
    assert axes.world.has_shaft(5)
    assert not axes.world.has_shaft(6)
    axes.enable()
    for node in (3, 2):
        axes.cruise(node, 4.0)
    axes.go(1.0)
    wheel = -axes[3].plant.position / 254.64790894703253
    assert wheel > 1.0
    assert axes.world.shaft_position(5) == pytest.approx(-0.5 * wheel, abs=0.05)
    axes.world.publish()


def test_an_encoder_on_no_joint_is_reported_with_its_line(tmp_path):
    with pytest.raises(
        PhysicsError, match=r"physics\.yml:7:17: an encoder names the unknown joint 'left_weel_joint'.* \(did you mean"
    ):
        robby(tmp_path, ENCODERS.replace("{{joint: left_wheel_joint, gear", "{{joint: left_weel_joint, gear"))
    with pytest.raises(PhysicsError, match="'x' is not a node"):
        robby(tmp_path, ENCODERS.replace('"5"', '"x"'))
