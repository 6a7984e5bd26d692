import pytest

from canopen_control.controllers.controllers_file import read_controllers
from canopen_control.controllers.spawned_controllers import SpawnedControllers
from canopen_control.errors import ControlError, RobotConfigError
from canopen_control.rpc.messages.parameters import ParameterValue

FILE = """
controller_manager:
  ros__parameters:
    update_rate: 50
    forward:
      type: forward_command_controller/ForwardCommandController
forward:
  ros__parameters:
    joints: [l]
    interface_name: velocity
"""
KIND = "velocity_controllers/JointGroupVelocityController"


def text(name, value):
    return ParameterValue(name=name, kind="string", value=value)


def texts(name, *values):
    return ParameterValue(name=name, kind="string_array", value=list(values))


@pytest.fixture
def folder(tmp_path):
    (tmp_path / "ros2_controllers.yaml").write_text(FILE)
    (tmp_path / "new.yaml").write_text(f"new:\n  ros__parameters:\n    type: {KIND}\n    joints: [r]\n")
    (tmp_path / "more.yaml").write_text(
        "/**:\n  ros__parameters:\n    command_timeout: 0.25\nforward:\n  ros__parameters:\n    joints: [r]\n"
    )
    return tmp_path


@pytest.fixture
def control(folder):
    return read_controllers(folder / "ros2_controllers.yaml")


def test_a_controller_that_the_robots_file_has_not(control, folder):
    spawned = SpawnedControllers(control)
    spawned.set([texts("new.params_file", str(folder / "new.yaml"))])
    spawned.set([text("new.type", KIND)])
    new = control.controllers["new"]
    assert (new.type, new.params.flat.value["joints"]) == (KIND, ["r"])


def test_files_win_over_the_robots_own_and_the_last_over_those_before(control, folder):
    (folder / "last.yaml").write_text("forward:\n  ros__parameters:\n    command_timeout: 0.5\n")
    spawned = SpawnedControllers(control)
    spawned.set([texts("forward.params_file", str(folder / "more.yaml"), "last.yaml")])
    result = control.controllers["forward"].params.flat.value
    assert (result["joints"], result["command_timeout"], result["interface_name"]) == (["r"], 0.5, "velocity")
    spawned.set([text("forward.params_file", "more.yaml")])
    assert control.controllers["forward"].params.flat.value["command_timeout"] == 0.25


def test_fallbacks_are_controllers_that_are_known(control):
    spawned = SpawnedControllers(control)
    spawned.set([text("new.type", KIND), texts("new.fallback_controllers", "forward")])
    assert control.controllers["new"].fallbacks == ("forward",)
    with pytest.raises(ControlError, match=r"fallback_controllers of new: no controller 'foward'.*'forward'"):
        spawned.set([texts("new.fallback_controllers", "foward")])


@pytest.mark.parametrize(
    ("expected", "error", "why"),
    [
        (texts("new.params_file", "absent.yaml"), RobotConfigError, r"params_file: .*absent\.yaml"),
        (texts("other.params_file", "new.yaml"), RobotConfigError, r"new\.yaml has no parameters for other"),
        (ParameterValue(name="new.type", kind="integer", value=3), ControlError, "is of type string, setting it"),
        (texts("new.node_options_args", "-p", "a:=1"), ControlError, "'-p' is not a remapping; give -r FROM:=TO here"),
        (texts("new.node_options_args", "-r"), ControlError, "'' after -r is not a remapping"),
        (texts("new.colour", "red"), ControlError, "a controller has the parameters: type, params_file"),
    ],
)
def test_what_is_wrong_is_refused_and_changes_nothing(control, expected, error, why):
    spawned = SpawnedControllers(control)
    with pytest.raises(error, match=why):
        spawned.set([text("new.type", KIND), expected])
    assert (spawned.arguments, list(control.controllers)) == ({}, ["forward"])
