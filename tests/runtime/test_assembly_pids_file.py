"""The `pids_config_file` of mujoco_ros2_control: what it says, and what is wrong in it with its place."""

import pytest

from canopen_control.errors import RobotConfigError
from canopen_control.runtime.assembly import read_pids
from canopen_control.urdf.ros2_control import ControlJoint, Ros2ControlSystem

TAG = Ros2ControlSystem(
    "arm",
    "system",
    "mujoco_ros2_control/MujocoSystemInterface",
    joints=(
        ControlJoint("shoulder", {}, dict.fromkeys(["position", "velocity"])),
        ControlJoint("wheel", {}, dict.fromkeys(["velocity"])),
    ),
)
HEAD = "/**:\n  ros__parameters:\n    pid_gains:\n"


@pytest.fixture
def read(tmp_path):
    def read(text, head=HEAD):
        path = tmp_path / "pids.yaml"
        path.write_text(head + text)
        return read_pids(path, TAG)

    return read


def test_gains_are_those_of_each_joint_and_interface(read):
    loops = read(
        "      position:\n        shoulder: {p: 400.0, i: 20.0, d: 15.0, u_clamp_max: 80.0, u_clamp_min: -80.0}\n"
        "      velocity:\n        wheel: {p: 2, i_clamp_max: 3.0, i_clamp_min: -3.0}\n"
    )
    assert {joint: list(each) for joint, each in loops.items()} == {"shoulder": ["position"], "wheel": ["velocity"]}
    gains = loops["shoulder"]["position"].gains
    assert (gains.p, gains.i, gains.d, gains.u_max, gains.u_min) == (400.0, 20.0, 15.0, 80.0, -80.0)
    assert loops["wheel"]["velocity"].gains.i_max == 3.0
    assert loops["wheel"]["velocity"].compute(0.5, 0.001) == 1.0


def test_a_node_of_any_name_has_them(read):
    assert list(read("    pid_gains: {velocity: {wheel: {p: 1.0}}}\n", "mujoco_node:\n  ros__parameters:\n")) == [
        "wheel"
    ]


@pytest.mark.parametrize(
    ("text", "place", "said"),
    [
        ("      position: {sholder: {p: 1.0}}\n", "4:18", "no joint 'sholder' in the description's <ros2_control>"),
        ("      position: {wheel: {p: 1.0}}\n", "4:18", "joint wheel has no command interface 'position'; it has vel"),
        ("      positon: {shoulder: {p: 1.0}}\n", "4:7", "no gains of 'positon' are known, did you mean 'position'?"),
        ("      velocity: {wheel: {P: 1.0}}\n", "4:26", "P"),
        ("      velocity: {wheel: {p: much}}\n", "4:29", "much"),
        ("      velocity: {wheel: {p: .nan}}\n", "4:", "p is nan; give a finite number"),
        ("      velocity: {wheel: {u_clamp_min: 2, u_clamp_max: 1}}\n", "4:", "give u_min < u_max"),
        ("      velocity: {wheel: 3}\n", "4:25", "expected a mapping"),
        ("      velocity: 3\n", "4:17", "write gains by joints"),
        ("      - velocity\n", "4:7", "write position: and velocity:"),
        ("      velocity: {wheel: {p: 1.0}\n", "", "expected"),
    ],
)
def test_what_is_wrong_is_told_with_its_place(read, text, place, said):
    with pytest.raises(RobotConfigError) as told:
        read(text)
    assert f"pids.yaml:{place}" in str(told.value)
    assert said in str(told.value)


def test_a_file_without_gains_or_none_at_all_is_told(read, tmp_path):
    for text in ("", "controller: {ros__parameters: {update_rate: 50}}\n", "- 1\n", "3\n"):
        with pytest.raises(RobotConfigError, match=r"no pid_gains|mapping"):
            read(text, "")
    with pytest.raises(RobotConfigError, match=r"nothing\.yaml: cannot be read: No such file"):
        read_pids(tmp_path / "nothing.yaml", TAG)
