import json

import pytest
from hypothesis import given
from hypothesis import strategies as st

from canopen_control.client.trajectory_file import parse_trajectory, read_trajectory, read_waypoints, write_trajectory
from canopen_control.errors import ConfigError, DiskFull
from canopen_control.rpc.messages.samples import TrajectoryPoint

WAVE = """\
joint_names: [a, b]
points:
  - {positions: [0, 1], time_from_start: 0.5}
  - positions: [1.0, 2.0]
    velocities: [0.0, 0.0]
    time_from_start: {sec: 1, nanosec: 500000000}
"""


def read(tmp_path, text):
    path = tmp_path / "wave.yaml"
    path.write_text(text)
    return read_trajectory(str(path))


def test_times_are_seconds_or_a_duration(tmp_path):
    joints, points = read(tmp_path, WAVE)
    assert joints == ["a", "b"]
    assert [point.time_from_start for point in points] == [0.5, 1.5]
    assert points[0].positions == [0.0, 1.0]
    assert points[1].velocities == [0.0, 0.0]


def test_a_goal_in_json_with_the_header_of_ros_is_read_too(tmp_path):
    trajectory = {
        "header": {"stamp": {"sec": 0, "nanosec": 0}, "frame_id": ""},
        "joint_names": ["a"],
        "points": [{"positions": [1.0], "time_from_start": {"sec": 2}}],
    }
    joints, points = read(tmp_path, json.dumps({"trajectory": trajectory}))
    assert (joints, points[0].time_from_start) == (["a"], 2.0)


@pytest.mark.parametrize(
    ("old", "new", "text"),
    [
        ("joint_names", "joint_name", "joint_name"),
        ("[0, 1]", "[0, fast]", "expected a number, got the text 'fast'"),
        ("[0, 1]", "[0, .nan]", "wave.yaml:3:21: "),
        ("[0, 1]", "[0, -.inf]", "-.inf is out of range"),
        ("start: 0.5", "start: .nan", ".nan is out of range"),
        ("velocities", "velocity", "unknown key 'velocity' (did you mean 'velocities'"),
        ("sec: 1", "second: 1", "unknown key 'second'"),
    ],
)
def test_an_error_is_reported_with_its_line(tmp_path, old, new, text):
    with pytest.raises(ConfigError) as refused:
        read(tmp_path, WAVE.replace(old, new, 1))
    assert text in str(refused.value)
    assert "wave.yaml:" in str(refused.value)


def test_a_file_that_is_not_there_is_named(tmp_path):
    with pytest.raises(ConfigError, match=r"none\.yaml"):
        read_trajectory(str(tmp_path / "none.yaml"))


def test_a_text_that_came_without_a_file_is_called_by_its_name():
    joints, points = parse_trajectory(WAVE, "wave.yaml")
    assert (joints, len(points)) == (["a", "b"], 2)
    with pytest.raises(ConfigError, match=r"sent\.yaml:1:1"):
        parse_trajectory("- 1", "sent.yaml")


NUMBERS = st.floats(-1e6, 1e6)
VECTORS = st.lists(NUMBERS, max_size=3)
POINTS = st.lists(
    st.builds(
        TrajectoryPoint,
        positions=VECTORS,
        velocities=VECTORS,
        accelerations=VECTORS,
        time_from_start=st.floats(0.0, 1e3),
    ),
    max_size=5,
)


@given(POINTS)
def test_what_is_written_is_read_as_it_was(tmp_path_factory, points):
    path = str(tmp_path_factory.getbasetemp() / "written.yaml")
    write_trajectory(path, ["a", "b"], points)
    if points:
        assert read_trajectory(path) == (["a", "b"], points)


def test_a_file_that_cannot_be_written_is_named(tmp_path):
    with pytest.raises(ConfigError, match="cannot be written: "):
        write_trajectory(str(tmp_path / "no" / "wave.yaml"), ["a"], [])
    with pytest.raises(DiskFull, match="/dev/full: No space left on device"):
        write_trajectory("/dev/full", ["a"], [])


def test_waypoints_rest_at_each_and_come_a_step_apart():
    points = read_waypoints("0.4, -0.3; 0 0", 2, 1.5)
    assert [(point.positions, point.time_from_start) for point in points] == [([0.4, -0.3], 1.5), ([0.0, 0.0], 3.0)]
    assert all(point.velocities == point.accelerations == [0.0, 0.0] for point in points)


@pytest.mark.parametrize("text", ["", "0.1", "0.1 fast", "0.1 nan", "0.1 0.2;", "0.1 0.2; 1 2 3", "1e99 0"])
def test_waypoints_that_are_none_are_reported_with_an_example(text):
    with pytest.raises(ConfigError, match=r"is not one position for each of the 2 joints; write it as in: .*0\.1 0\.1"):
        read_waypoints(text, 2, 1.0)


def test_a_file_of_too_many_points_is_refused_before_it_is_read(tmp_path):
    with pytest.raises(ConfigError, match="20001 points exceed the maximum of 20000 for a trajectory"):
        read(tmp_path, "time_from_start: [" * 20_001)
