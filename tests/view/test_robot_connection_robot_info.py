from support.pages import info, state

from canopen_control.view.robot_connection import pose_of


def test_the_pose_is_that_of_the_first_base_controller():
    found = state(samples={"base": {"kind": "odometry", "time": 1.0, "x": 1.0, "y": 2.0, "heading": 0.5}})
    assert pose_of(found) == (1.0, 2.0, 0.5)
    assert pose_of(state()) is None


def test_a_robot_with_another_shape_is_another_one():
    assert info().shape == info(state="fault").shape
    assert info().shape != info(joints={"other": {}}).shape


def test_a_page_begins_with_what_the_status_tells():
    found = info()
    assert (found.robot, found.joints, found.buses) == ("pair", ("left", "lift"), ("can",))
    assert found.nodes[0].channel == "local:x"
    assert (found.state.state, found.state.load) == ("running", {"can": 0.02})
