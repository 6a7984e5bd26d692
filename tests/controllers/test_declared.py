from __future__ import annotations

import dataclasses
import math

import pytest

from canopen_control.controllers.base_params import BaseParams, MecanumParams, read_params
from canopen_control.controllers.broadcasters import read_params as read_battery
from canopen_control.controllers.controllers_file import ManagerParams
from canopen_control.controllers.declared import checked, declared_by, given_in
from canopen_control.controllers.gpio_command import GpioParams
from canopen_control.controllers.gripper import EffortGripperParams
from canopen_control.controllers.gripper import read_params as read_gripper_params
from canopen_control.controllers.params import BroadcasterParams, CommonParams, GroupParams, Params
from canopen_control.controllers.trajectory.params import read_params as read_trajectory_params
from canopen_control.controllers.types import TYPES, class_of
from canopen_control.errors import ControlError
from canopen_control.rpc.messages.parameters import ParameterValue
from canopen_control.yamlfile.convert import fields_of, help_of

WHEELS = {"left_wheel_names": ["l"], "right_wheel_names": "r", "wheel_separation": 0.4, "wheel_radius": 0.1}


def read_battery_params(params):
    return read_battery(params, "power")


def read_gripper(params):
    return read_gripper_params(params, "gripper", EffortGripperParams)


@pytest.fixture
def base():
    params = Params.of(WHEELS)
    read_params(params)
    return {item.name: item for item in declared_by(params.source, ("cmd_vel_timeout", "linear.x.*"))}


def test_names_types_values_and_bounds_are_those_of_the_class(base):
    timeout = base["cmd_vel_timeout"]
    assert (timeout.kind, timeout.value, timeout.low, timeout.high) == ("double", 0.5, 0.0, 1e9)
    assert (base["open_loop"].kind, base["open_loop"].value) == ("bool", False)
    assert (base["left_wheel_names"].kind, base["left_wheel_names"].value) == ("string_array", ["l"])
    assert (base["pose_covariance_diagonal"].kind, base["pose_covariance_diagonal"].value) == (
        "double_array",
        [0.0] * 6,
    )
    assert base["velocity_rolling_window_size"].kind == "integer"
    assert math.isnan(base["linear.x.max_velocity"].plain)
    assert list(base) == sorted(base)


def test_a_name_or_a_list_of_them_is_a_list_for_ros(base):
    assert (base["right_wheel_names"].kind, base["right_wheel_names"].plain) == ("string_array", ["r"])


def test_what_no_pattern_names_is_read_only(base):
    free = {name for name, each in base.items() if not each.read_only}
    assert {name for name in free if not name.startswith("linear.x.")} == {"cmd_vel_timeout"}
    assert "linear.x.max_jerk" in free


def test_keys_of_other_names_choices_and_values_that_are_not_set():
    rows = {item.name: item for item in declared_by(BroadcasterParams())}
    assert rows["map_interface_to_joint_state.effort"].value == "effort"
    unset = {item.name: item for item in declared_by(GroupParams())}["command_timeout"]
    assert (unset.kind, unset.plain) == ("double", None)


def test_the_gains_of_each_joint_have_its_name():
    params = Params.of(
        {"joints": ["a"], "command_interfaces": ["velocity"], "state_interfaces": ["position", "velocity"],
         "gains": {"a": {"p": 2.0}}}
    )  # fmt: skip
    read_trajectory_params(params, "arm")
    rows = {item.name: item for item in declared_by(params.source, ("gains.*",))}
    assert (rows["gains.a.p"].value, rows["gains.a.p"].read_only) == (2.0, False)
    assert rows["gains.a.i_clamp_max"].plain == math.inf
    assert "legacy" in rows["gains.a.antiwindup_strategy"].choices
    assert rows["constraints.a.goal"].read_only


def test_a_controller_without_a_rate_has_the_managers():
    rows = {item.name: item.value for item in declared_by(GroupParams(), update_rate=50)}
    assert (rows["update_rate"], rows["use_sim_time"]) == (50, False)


def test_before_they_are_read_they_are_those_of_the_file():
    reported = {
        item.name: (item.kind, item.value, item.read_only) for item in given_in(Params.of({**WHEELS, "type": "x/Y"}))
    }
    assert reported["wheel_radius"] == ("double", 0.1, True)
    assert reported["left_wheel_names"] == ("string_array", ["l"], True)
    assert "type" not in reported


@pytest.mark.parametrize(
    ("name", "kind", "value", "why"),
    [
        ("wheel_radius", "double", 0.2, "'wheel_radius' cannot be set because it is read-only"),
        ("cmd_vel_timout", "double", 0.2, "was not declared.*'cmd_vel_timeout'"),
        ("anything", "double", 0.2, "'anything' cannot be set because it was not declared$"),
        ("cmd_vel_timeout", "integer", 1, "'cmd_vel_timeout' is of type double, setting it to integer is not allowed"),
        ("cmd_vel_timeout", "double", True, "True is not a number"),
    ],
)
def test_what_cannot_be_set_is_refused_as_rclcpp_does(base, name, kind, value, why):
    with pytest.raises(ControlError, match=why):
        checked("base", list(base.values()), [ParameterValue(name=name, kind=kind, value=value)])


def test_a_section_whose_names_the_file_gives_is_one_parameter_for_each():
    outputs = {"gpios": ["io"], "command_interfaces": {"io": {"interfaces": ["lamp"]}}, "safe_values": {"io.lamp": 0.5}}
    rows = {item.name: item for item in declared_by(Params.of(outputs).read(GpioParams))}
    lists = rows["command_interfaces.io.interfaces"]
    assert (lists.kind, lists.plain, lists.read_only) == ("string_array", ["lamp"], True)
    assert (rows["safe_values.io.lamp"].kind, rows["safe_values.io.lamp"].plain) == ("double", 0.5)
    assert not any(name.startswith("state_interfaces") for name in rows)


@pytest.mark.parametrize(
    ("read", "inputs", "name", "plain"),
    [
        (read_battery_params, {"batteries": ["a"], "a": {"capacity": 2.0}}, "a.capacity", 2.0),
        (read_battery_params, {"batteries": ["a"], "interfaces": {"a": {"battery_current": True}}},
         "interfaces.a.battery_current", True),
        (read_gripper, {"joint": "finger", "gains": {"finger": {"p": 3.0}}}, "gains.finger.p", 3.0),
    ],
)  # fmt: skip
def test_sections_of_other_controllers_have_the_names_of_their_keys(read, inputs, name, plain):
    params = Params.of(inputs)
    read(params)
    rows = {item.name: item for item in declared_by(params.source)}
    assert rows[name].plain == plain


# Descriptions of all parameters; ROS gets the description of each declared parameter.


def test_an_overridden_default_keeps_the_help_text_of_the_base_class():
    params = MecanumParams()
    texts = {reading.name: reading.text for reading in declared_by(params)}
    assert texts["pose_covariance_diagonal"] == "diagonal of the covariance of the odometry's pose"
    assert params.pose_covariance_diagonal != BaseParams().pose_covariance_diagonal


@pytest.mark.parametrize("type_name", TYPES)
def test_a_type_declares_its_parameters_with_their_texts(type_name):
    kind = class_of(type_name)
    assert kind.title
    assert kind.reads is not CommonParams
    for section in kind.sections.values():
        assert [entry.name for entry, _ in fields_of(section) if not help_of(section, entry)] == []
    cls = kind.reads
    needed = {field.name for field in dataclasses.fields(cls) if field.default is field.default_factory}
    readings = declared_by(cls(**dict.fromkeys(needed)))
    assert [reading.name for reading in readings if not reading.text] == []


def test_the_manager_has_its_texts():
    assert [item.name for item in declared_by(ManagerParams()) if not item.text] == []


def test_names_that_the_file_gives_have_the_text_of_their_section():
    gpio_params = GpioParams(gpios=("io",), safe_values={"io.lamp": 1.0})
    texts = {item.name: item.text for item in declared_by(gpio_params)}
    assert (
        texts["safe_values.io.lamp"]
        == "`.GPIO.INTERFACE`: value of the output after commands have expired; absent: 0.0"
    )
