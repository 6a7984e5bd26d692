from pathlib import Path

import pytest
from support.robots import Bench, copy_robby

from canopen_control.errors import ConfigError

FORWARD = "robby_forward_controller"


@pytest.mark.parametrize(
    ("old", "new", "sentence"),
    [
        ("type: forward_command_controller/Forward", "type: forward_command_controller/Foward", "did you mean"),
        ("- left_wheel_joint\n", "- leftwheel_joint\n", r"robby_forward_controller: no interface 'leftwheel_joint"),
        ("interface_name: velocity", "interface_name: effort", "no interface 'left_wheel_joint/effort'"),
        ("interface_name: velocity", "interface_nme: velocity", "did you mean 'interface_name'"),
        ("command_timeout: 2.0", "command_timeout: soon", r"ros2_controllers.yaml:\d+:\d+.*command_timeout"),
    ],
)
def test_a_controller_that_cannot_work_is_reported_before_the_first_frame(tmp_path, old, new, sentence):
    config = copy_robby(tmp_path, controllers={old: new})
    with pytest.raises(ConfigError, match=sentence) as caught:
        Bench("wanted", config=config, drives=())
    assert "ros2_controllers.yaml" in str(caught.value) or FORWARD in str(caught.value)


def test_two_controllers_that_claim_the_same_interface_are_reported_at_once():
    both = [FORWARD, "robby_base_controller"]  # as prbt's launch file spawns two
    with pytest.raises(ConfigError) as caught:
        Bench("both", controllers=both, drives=())
    place, _, text = str(caught.value).partition(": ")
    path, _, line = place.rpartition(":")
    assert "type: diff_drive" in Path(path).read_text().splitlines()[int(line) - 1]
    assert text == (
        f"robby_base_controller and {FORWARD} cannot be active together: both command left_wheel_joint/velocity; "
        f"choose one for the start, with --controller robby_base_controller or --controller {FORWARD}"
    )


def test_what_is_requested_is_ready_and_nothing_is_active_yet():
    bench = Bench("ready", drives=())
    states = {info.name: info.state for info in bench.robot.manager.list()}
    assert states == {"joint_state_broadcaster": "inactive", FORWARD: "inactive"}
    bench.close()
