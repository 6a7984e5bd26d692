import math

import pytest
from support.pages import state

from canopen_control.rpc.messages.drive import WorldShape
from canopen_control.view.scene_tree import WorldView

BOX = WorldShape(name="box 0", kind="box", size=(1.0, 2.0, 3.0), position=(0.5, 0.0, 1.5))
DRAWN = {"shape": "box", "size": [1.0, 2.0, 3.0], "position": [0.5, 0.0, 1.5], "wxyz": [1.0, 0.0, 0.0, 0.0]}


def placed(x=0.0, y=0.0, turn=0.0):
    return state(true_pose={"time": 1.0, "x": 0.0, "y": 0.0, "heading": 0.0, "odom": [x, y, turn]})


def test_shapes_are_reported_once_and_again_where_they_have_moved():
    world = WorldView()
    reported = world.take((BOX,), placed())
    assert reported == {"place": [0.0, 0.0, 0.0], "shapes": [DRAWN | {"moves": False, "robot": "", "grip": 0.0}]}
    assert world.take((BOX,), placed()) is None
    assert world.take((), placed())["shapes"] == []
    assert world.document["shapes"] == []


def test_patches_and_other_robots_are_reported_as_such():
    patch = WorldShape(name="patch 0", kind="patch", size=(1.0, 2.0, 0.002), position=(0.0, 0.0, 0.0), grip=0.1)
    wheel = WorldShape(
        name="b/wheel", kind="ellipsoid", size=(1.0, 1.0, 0.2), position=(0.0, 0.0, 0.5), moves=True, robot="b"
    )
    reported = WorldView().take((patch, wheel), placed())["shapes"]
    assert [(item["shape"], item["robot"], item["grip"]) for item in reported] == [
        ("patch", "", 0.1),
        ("ellipsoid", "b", 0),
    ]


def test_the_world_is_shown_in_the_odometry_frame():
    x, y, turn = WorldView().take((BOX,), placed(2.0, 1.0, math.pi / 2))["place"]
    # what stands in the world where odometry began is at odometry's zero
    assert (x + math.cos(turn) * 2.0 - math.sin(turn) * 1.0) == pytest.approx(0.0, abs=1e-3)
    assert (y + math.sin(turn) * 2.0 + math.cos(turn) * 1.0) == pytest.approx(0.0, abs=1e-3)


def test_without_a_true_pose_or_a_thing_there_is_nothing_to_draw():
    world = WorldView()
    assert world.take((BOX,), state()) is None
    assert world.take((), placed()) is None
    assert world.document is None
