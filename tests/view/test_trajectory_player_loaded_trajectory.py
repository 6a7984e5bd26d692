import json

import pytest

from canopen_control.errors import ConfigError
from canopen_control.rpc.messages.samples import TrajectoryPoint, TrajectorySample
from canopen_control.rpc.messages.state import ControllerReading
from canopen_control.view.trajectory_player import (
    LoadedTrajectory,
    active_trajectory_controllers,
    load,
    preview_table,
    progress_of,
)

POINTS = [TrajectoryPoint(positions=[0.5, 0.25], time_from_start=1.0), TrajectoryPoint(time_from_start=2.5)]
LOADED = LoadedTrajectory("wave.json", ["left", "<lift>"], POINTS)


def file(points):
    return json.dumps({"joint_names": ["left"], "points": points}).encode()


def sample(at, **how):
    empty = TrajectoryPoint()
    return TrajectorySample(
        time=1.0, joints=("left",), holding=False, reference=TrajectoryPoint(time_from_start=at), feedback=empty,
        error=empty, output=empty, **({"executing": True} | how),
    )  # fmt: skip


def test_a_file_is_read_as_the_shell_reads_it():
    loaded = load(file([{"positions": [1.0], "time_from_start": {"sec": 2}}]), "wave.json")
    assert (loaded.name, loaded.joints, loaded.duration) == ("wave.json", ["left"], 2.0)
    assert loaded.positions(0) == {"left": 1.0}


@pytest.mark.parametrize(
    ("data", "text"),
    [
        (file([{"position": [1.0]}]), "did you mean 'positions'"),
        (file([]), "wave.json: the trajectory has no points"),
        (b"joint_names:\n- \xff", "wave.json:2: the file is not UTF-8"),
        (b"\0", "wave.json:1:1"),
    ],
)
def test_what_cannot_be_read_is_reported_with_its_name(data, text):
    with pytest.raises(ConfigError) as refused:
        load(data, "wave.json")
    assert text in str(refused.value)


def test_a_point_that_places_no_joint_or_too_few_places_none():
    assert LOADED.positions(0) == {"left": 0.5, "<lift>": 0.25}
    assert LOADED.positions(1) == {}
    assert LoadedTrajectory("x", ["left", "lift"], [TrajectoryPoint(positions=[1.0])]).positions(0) == {}


def test_the_table_has_what_is_previewed_alongside_what_is():
    table = preview_table(LOADED, 0, {"left": 0.125}, frozenset({"<lift>"}))
    assert "<td>0.500<small>rad</small></td><td>0.125</td>" in table
    assert "&lt;lift&gt;</b></td><td>0.250<small>m</small></td><td>not a joint of this robot" in table
    assert "<td>-</td>" in preview_table(LOADED, 0, {"left": None}, frozenset())
    assert "no positions" in preview_table(LOADED, 1, {}, frozenset())


@pytest.mark.parametrize(
    ("reported", "duration", "done", "words"),
    [
        (None, 2.0, 0.0, "Playing."),
        (sample(1.0, executing=False), 2.0, 0.0, "Playing."),
        (sample(0.5), 2.0, 0.25, "Playing: 0.5 of 2.0 s."),
        (sample(9.0), 2.0, 1.0, "Playing: 2.0 of 2.0 s."),
        (sample(-1.0), 2.0, 0.0, "Playing: 0.0 of 2.0 s."),
        (sample(0.0), 0.0, 1.0, "Playing: 0.0 of 0.0 s."),
        (sample(1.0, speed_scaling_factor=0.1), 2.0, 0.5, "Playing: 1.0 of 2.0 s, at 10 % of its speed."),
    ],
)
def test_progress_is_what_the_controller_reports(reported, duration, done, words):
    assert progress_of(reported, duration) == (done, words)


def test_only_active_controllers_of_trajectories_take_them():
    def reading(name, state, tells):
        return ControllerReading(name=name, type="", state=state, tells=tells)

    result = [
        reading("a", "active", "trajectory"),
        reading("b", "inactive", "trajectory"),
        reading("c", "active", None),
    ]
    assert active_trajectory_controllers(result) == ["a"]
