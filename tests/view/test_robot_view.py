import dataclasses
import math

import pytest
from support.pages import info, robot, state

from canopen_control.view.robot_view import RobotView


def test_a_robot_that_returns_continues_and_another_one_does_not():
    view = robot()
    view.take(state())
    assert view.resume(info(state="starting"))
    assert view.state.state == "starting"
    assert view.history.rows()
    assert not view.resume(info(joints={"other": {}}))


def test_only_what_has_moved_is_sent():
    view = robot()
    assert set(view.take(state())) == {"angles", "tint"}
    assert view.take(state()) == {}
    moved = view.take(state(samples={"base": {"kind": "odometry", "time": 1.0, "x": 1.0, "y": 0.0, "heading": 0.0}}))
    assert moved == {"pose": [1.0, 0.0, 0.0]}
    assert list(view.trail.points) == [(1.0, 0.0)]


def test_the_true_pose_of_a_simulated_base_has_its_own_trail_in_the_odometry_frame():
    view = robot()
    odometry = {"base": {"kind": "odometry", "time": 1.0, "x": 1.0, "y": 0.0, "heading": 0.0}}
    view.take(state(samples=odometry))
    turned = {"time": 1.0, "x": 5.0, "y": 1.1, "heading": math.pi / 2, "odom": [5.0, 0.0, math.pi / 2]}
    assert view.take(state(samples=odometry, true_pose=turned)) == {"truth": [1.1, 0.0, 0.0]}
    assert (list(view.trail.points), list(view.true_trail.points)) == ([(1.0, 0.0)], [(1.1, 0.0)])
    unaligned = {"time": 1.0, "x": 5.0, "y": 1.1, "heading": 0.0}
    assert view.take(state(samples=odometry, true_pose=unaligned)) == {"truth": None}


@pytest.mark.parametrize("urdf", ["", "<robot", "<robot><link/><joint/></robot>"])
def test_a_description_that_cannot_be_read_is_a_note_and_no_error(urdf):
    view = RobotView(dataclasses.replace(info(), urdf=urdf), lambda _content, kind: f"/mesh/1.{kind}")
    assert view.scene.tree["joints"] == []
    (note,) = view.scene.notes
    assert note.startswith("the description cannot be drawn: <urdf>")
