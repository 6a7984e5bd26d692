import pytest

from canopen_control.physics.physics_file import PhysicsError
from canopen_control.physics.scene_file import Patch, read_world_description
from canopen_control.rpc.messages.drive import AddPayload, BlockJoint, PushRobot, SetGrip

WORLD = """floor: {friction: 0.6}
start: {at: [1, 2], heading: 90}
patches: [{at: [1.5, 0], size: [1, 1], friction: 0.1}]
ramps: [{at: [3, 0], angle: 8, length: 2}]
boxes: [{at: [1, 1], size: [0.3, 0.3, 0.3], mass: 2}]
walls: [{from: [0, 2], to: [4, 2]}]
steps:
  - {at: 10s, block: left_wheel_joint, for: 2s}
  - {at: 5s, payload: {mass: 12, on: base_link, position: [0, 0, 0.1]}}
  - {at: 500ms, push: {force: [30, 0, 0]}}
  - {at: 15, friction: 0.2}
"""


def read(tmp_path, text=WORLD):
    path = tmp_path / "hall.yml"
    path.write_text(text)
    return read_world_description(path)


def test_what_happens_is_in_order_and_a_block_ends(tmp_path):
    assert read(tmp_path).timeline() == [
        (500_000_000, "", PushRobot(force=(30.0, 0.0, 0.0), seconds=0.2)),
        (5_000_000_000, "", AddPayload(mass=12.0, on="base_link", position=(0.0, 0.0, 0.1))),
        (10_000_000_000, "", BlockJoint(joint="left_wheel_joint")),
        (12_000_000_000, "", BlockJoint(joint="left_wheel_joint", on=False)),
        (15_000_000_000, "", SetGrip(friction=0.2)),
    ]


def test_what_stands_on_the_floor_has_its_sizes(tmp_path):
    world = read(tmp_path)
    assert (world.start.at, world.start.heading) == ((1.0, 2.0), 90.0)
    assert (world.ramps[0].width, world.boxes[0].above, world.walls[0].height) == (1.0, 0.0, 0.5)
    assert world.floor.friction == 0.6


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("friction: 0.1}", "fricton: 0.1}", "fricton"),
        ("friction: 0.1}", "fricton: 0.1}", "friction"),
        ("size: [1, 1]", "size: [1]", "size"),
        ("angle: 8", "angle: 80", "angle"),
        ("size: [0.3, 0.3, 0.3]", "size: [0.3, 0, 0.3]", "size: the three lengths of a box must be above 0"),
        ("to: [4, 2]", "to: [0, 2]", "a wall needs two different points"),
        ("at: 10s", "at: soon", "'soon' is not a time"),
        ("friction: 0.2}", "friction: 0.2, block: x}", "a step needs exactly one of payload, push, block and friction"),
        ("friction: 0.2}", "friction: 0.2, for: 1s}", "for: is possible only with block"),
    ],
)
def test_an_error_is_reported_with_its_line(tmp_path, old, new, message):
    with pytest.raises(PhysicsError) as caught:
        read(tmp_path, WORLD.replace(old, new))
    assert message in str(caught.value)
    lines = [number for number, line in enumerate(WORLD.splitlines(), 1) if old in line]
    assert f"hall.yml:{lines[0]}:" in str(caught.value)


def test_a_patch_covers_a_turned_rectangle():
    patch = Patch((1.0, 1.0), (2.0, 0.2), 0.1, heading=90.0)
    assert patch.covers(1.05, 1.9)
    assert not patch.covers(1.9, 1.05)


ROBOTS = """robots:
  - {name: a, robot: robby, at: [0, 0]}
  - {name: b, robot: diffbot_sim, at: [1, 0], heading: 90, arguments: {prefix: b}}
steps:
  - {at: 1s, robot: b, push: {force: [1, 0, 0]}}
  - {at: 2s, friction: 0.2}
"""


def test_robots_have_a_name_a_folder_and_a_place(tmp_path):
    world = read(tmp_path, ROBOTS)
    second = world.robots[1]
    assert (second.name, second.robot, second.at, second.heading) == ("b", "diffbot_sim", (1.0, 0.0), 90.0)
    assert [robot for _, robot, _ in world.timeline()] == ["b", ""]


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("name: b", "name: a", "hall.yml:3:5: robots.1.: a robot named a exists already"),
        ("name: b", "name: 2-b", "hall.yml:3:5: .*name: '2-b' is not valid"),
        ("name: b, ", "", "hall.yml:3:5: .*name"),
        ("robot: b,", "robot: bb,", "robot 'bb' is not in this file"),
        ("robot: b,", "", "robot: name the robot of this step: a, b"),
        ("robots:", "start: {at: [0, 0]}\nrobots:", "omit `start`"),
        ("heading: 90", "headnig: 90", "hall.yml:3:47: .*headnig.*did you mean.*heading"),
    ],
)
def test_errors_of_robots_are_reported_with_their_line(tmp_path, old, new, message):
    with pytest.raises(PhysicsError, match=message):
        read(tmp_path, ROBOTS.replace(old, new, 1))
