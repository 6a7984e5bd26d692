import pytest

from canopen_control.physics.physics_file import PhysicsError, axis_address, read_physics_file

GOOD = """engine: mujoco
urdf: robot.urdf
axes:
  "3": {joint: left, scale_pos_to_dev: -10, peak_torque: 1.5}
  "3/1": {joint: right, scale_pos_to_dev: 10, brake: true}
"""


def read(tmp_path, text):
    path = tmp_path / "physics.yml"
    path.write_text(text)
    return read_physics_file(path)


def test_what_is_not_reported_is_none_or_the_default(tmp_path):
    file = read(tmp_path, GOOD)
    left = file.axes["3"]
    assert (left.joint, left.peak_torque, left.rated_torque, left.brake) == ("left", 1.5, None, None)
    assert (file.step_ms, file.base, file.floor.friction, file.floor.caster_friction) == (1.0, None, 0.8, 0.02)
    assert file.axes["3/1"].brake is True


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("urdf: robot.urdf", "urdf: a.urdf\nmjcf: b.xml", ":1:1: name the robot by either urdf: FILE or mjcf: FILE"),
        ('"3/1"', '"wheel"', ":5:"),
        ('"3/1"', '"3/9"', "is not an axis: write"),
        ("scale_pos_to_dev: -10", "scale_pos_to_dev: 0", ":4:"),
        ("joint: right", "joint: left", "axis 3 already moves joint left"),
        ("peak_torque", "peek_torque", "peak_torque"),
        ("peak_torque: 1.5", "peak_torque: much", ":4:"),
    ],
)
def test_an_error_is_reported_with_its_place(tmp_path, old, new, message):
    with pytest.raises(PhysicsError) as caught:
        read(tmp_path, GOOD.replace(old, new))
    assert message in str(caught.value)
    assert "physics.yml:" in str(caught.value)


def test_an_address_is_a_node_and_an_axis():
    assert [axis_address(text) for text in ("3", "127/7", "arm:4/1")] == [("", 3, 0), ("", 127, 7), ("arm", 4, 1)]
    for text in ("0", "128", "3/8", "three", "3/"):
        if text != "3/":
            with pytest.raises(ValueError, match=r".+"):
                axis_address(text)
