import math
from pathlib import Path

import pytest
from support.physicsbench import MS, ROBBY, Axes, robby, robby_urdf

from canopen_control.data_files import data_path
from canopen_control.physics.engine import make_shared
from canopen_control.physics.physics_file import PhysicsError
from canopen_control.rpc.messages.drive import BlockJoint, PushRobot

HALL = """robots:
  - {{name: left, robot: robby, at: [0, 0]}}
  - {{name: right, robot: robby, at: [{apart}, 0], heading: 180}}
"""


def shared(folder, text=HALL, plant=ROBBY, **numbers):
    """Return the world of two robots, and the axes of each."""
    (folder / "hall.yml").write_text(text.format(**{"apart": 1.0, **numbers}))
    (folder / "robot.urdf").write_text(robby_urdf())
    (folder / "physics.yml").write_text(plant.format(urdf=folder / "robot.urdf"))
    return make_shared(dict.fromkeys(("left", "right"), folder / "physics.yml"), folder / "hall.yml")


class Side(Axes):
    """The axes of one of several robots."""

    def __init__(self, world, name):
        super().__init__(world.side(name), (3, 0), (2, 0))


def both(world):
    return Side(world, "left"), Side(world, "right")


def go(sides, seconds):
    for _ in range(round(seconds / 0.02)):
        for side in sides:
            side.go(0.02)


def pose(side):
    base = side.world.describe().base
    return base.x, base.y, base.heading


def test_each_begins_where_the_file_specifies_and_drives_as_it_does_alone(tmp_path):
    left, right = both(shared(tmp_path))
    alone = robby(tmp_path)
    x, y, heading = pose(right)
    assert (x, y, abs(heading)) == pytest.approx((1.0, 0.0, math.pi), abs=1e-3)
    for side in (left, right, alone):
        side.enable()
        for node in (3, 2):
            side.cruise(node, 2.0)
    go((left, right, alone), 2.0)
    way = pose(alone)[0]
    assert way > 0.1
    assert pose(left)[0] == pytest.approx(way, abs=1e-4)
    assert pose(right)[0] == pytest.approx(1.0 - way, abs=1e-4)


@pytest.mark.rest
def test_one_pushes_the_other_away(tmp_path):
    left, right = both(shared(tmp_path, apart=0.4))
    left.enable()
    for node in (3, 2):
        left.cruise(node, 5.0)
    go((left, right), 4.0)
    assert pose(right)[0] > 0.5  # its wheels have no power and turn
    assert pose(left)[0] > 0.2


def test_what_happens_to_one_does_not_to_the_other(tmp_path):
    text = HALL + "steps: [{{at: 100ms, robot: right, push: {{force: [0, 60, 0], seconds: 0.3}}}}]\n"
    left, right = both(shared(tmp_path, text))
    for side in (left, right):
        side.enable()
    right.world.act(BlockJoint(joint="left_wheel_joint"))
    assert (left[3].plant.stalled, right[3].plant.stalled) == (False, True)
    go((left, right), 1.0)
    assert abs(pose(right)[1]) > 0.01
    assert pose(left) == pytest.approx((0.0, 0.0, 0.0), abs=1e-3)
    with pytest.raises(PhysicsError, match=r"hall\.yml:4:9: the robot has no link 'arm'"):
        shared(tmp_path, HALL + "steps: [{{at: 1s, robot: left, push: {{force: [1, 0, 0], on: arm}}}}]\n")


def test_a_range_finder_detects_the_other_robot(tmp_path):
    plant = ROBBY.replace("axes:", "sensors: {{front: {{kind: range, link: caster, reach: 3}}}}\naxes:")
    left, right = both(shared(tmp_path, plant=plant))
    observed = [side.world.describe().sensors["front"][0] for side in (left, right)]
    assert observed[0] == pytest.approx(observed[1], abs=1e-3)
    assert 0.5 < observed[0] < 1.0
    right.world.act(PushRobot(force=(0.0, 0.0, 1000.0), seconds=0.2))
    go((left, right), 0.3)
    assert left.world.describe().sensors["front"] == (-1.0,)


def test_the_other_robot_is_among_the_shapes(tmp_path):
    world = shared(tmp_path, HALL + "patches: [{{at: [1, 2], size: [1, 3], friction: 0.1, heading: 90}}]\n")
    shapes = world.side("left").shapes()
    assert {shape.robot for shape in shapes} == {"", "right"}
    assert {shape.kind for shape in shapes if shape.robot} >= {"ellipsoid"}
    patch = shapes[0]
    assert (patch.kind, patch.size[:2], patch.grip) == ("patch", (1.0, 3.0), 0.1)
    assert patch.rotation == pytest.approx((math.sqrt(0.5), 0, 0, math.sqrt(0.5)))


def test_robots_that_begin_inside_each_other_are_reported_with_the_line(tmp_path):
    with pytest.raises(PhysicsError, match=r"hall\.yml:3:5: right starts inside left, at x -?0\.\d+ m"):
        shared(tmp_path, apart=0.1)
    with pytest.raises(PhysicsError, match=r"hall\.yml:2:5: left starts inside box 0"):
        shared(tmp_path, HALL + "boxes: [{{at: [0, 0], size: [0.1, 0.1, 0.3]}}]\n")


def test_an_arm_is_bolted_down_where_it_begins(tmp_path):
    from canopen_control.urdf.description import read_description

    arm = read_description(data_path("config", "arm6/arm6.urdf"))
    joint = next(iter(arm.movable_joints))
    (tmp_path / "arm.urdf").write_text(arm.urdf_xml)
    (tmp_path / "arm.yml").write_text(
        f'engine: mujoco\nurdf: arm.urdf\naxes: {{"1": {{joint: {joint}, scale_pos_to_dev: 1000}}}}\n'
    )
    (tmp_path / "robot.urdf").write_text(robby_urdf())
    (tmp_path / "physics.yml").write_text(ROBBY.format(urdf="robot.urdf"))
    (tmp_path / "hall.yml").write_text(HALL.format(apart=2.0))
    world = make_shared({"left": tmp_path / "arm.yml", "right": tmp_path / "physics.yml"}, Path(tmp_path / "hall.yml"))
    assert world.side("left").describe().base is None
    assert world.model.joint(f"left/{joint}").range == pytest.approx(
        [arm.joints[joint].limits.lower, arm.joints[joint].limits.upper]
    )
    right = Side(world, "right")
    right.go(0.1, every=5 * MS)
    assert pose(right)[0] == pytest.approx(2.0, abs=1e-3)
