import json

import pytest

from canopen_control.client.trajectory_file import parse_trajectory, read_trajectory
from canopen_control.errors import ConfigError

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
    assert [each.time_from_start for each in points] == [0.5, 1.5]
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
        ("velocities", "velocity", "unknown key 'velocity', did you mean 'velocities'"),
        ("sec: 1", "second: 1", "unknown key 'second'"),
    ],
)
def test_a_mistake_is_told_with_its_line(tmp_path, old, new, text):
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
