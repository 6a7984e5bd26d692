from canopen_control.controllers.trajectory.point import JointTrajectory, Point


def test_a_point_takes_the_values_of_another_in_its_own_lists():
    one, other = Point([0.0], time=1), Point([1.0, 2.0], [3.0, 4.0], time=5)
    positions = one.positions
    one.take(other)
    assert (one.positions, one.velocities, one.accelerations, one.time) == ([1.0, 2.0], [3.0, 4.0], [], 5)
    assert one.positions is positions
    other.positions[0] = 9.0
    assert one.positions == [1.0, 2.0]


def test_a_copy_has_lists_of_its_own():
    one = Point([1.0], [2.0], [3.0], [4.0], 5)
    copy = one.copy()
    one.positions[0] = one.effort[0] = 0.0
    assert (copy.positions, copy.velocities, copy.accelerations, copy.effort, copy.time) == (
        [1.0],
        [2.0],
        [3.0],
        [4.0],
        5,
    )


def test_a_trajectory_keeps_lists_of_its_own():
    names = ["a"]
    message = JointTrajectory(names, [Point([1.0])])
    names.append("b")
    assert (message.joint_names, message.stamp) == (["a"], 0)
