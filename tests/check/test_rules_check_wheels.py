"""Typical mistakes of wheels, inserted into each bundled robot on wheels, give the expected findings."""

import re

import pytest
from support.configs import BASES, changed, found, line_of

from canopen_control.check.checker import CheckOptions, check_robot
from canopen_control.od.issues import Severity


@pytest.mark.parametrize("name", BASES)
def test_a_jerk_limit_of_zero(name, tmp_path):
    base, place, indent = BASES[name]
    key = "max_jerk" if "ros1" in name else "linear.x.max_jerk"
    files = changed(tmp_path, name, controllers={place: f"{indent}{key}: 0.0\n{place}"})
    line = line_of(files, "controllers", "max_jerk")
    assert found(files) == [
        f"ros2_controllers.yaml:{line}: error: {base}: linear.x.max_jerk: 0 prevents any motion: "
        "the robot can neither start nor brake; remove it, or give linear.x.has_jerk_limits: false"
    ]


@pytest.mark.parametrize("name", BASES)
def test_an_odometry_frame_that_collides_with_a_fixed_joint(name, tmp_path):
    base = BASES[name][0]
    old = {"robby": "base_footprint ", "diffbot_sim": "base_link", "mobile_base_ros1": "base_footprint\n"}[name]
    new = {"robby": "base_link ", "diffbot_sim": "chassis", "mobile_base_ros1": "base_link\n"}[name]
    files = changed(tmp_path, name, controllers={f"base_frame_id: {old}": f"base_frame_id: {new}"})
    line = line_of(files, "controllers", "odom_frame_id" if name != "mobile_base_ros1" else "base_frame_id")
    root = old.strip()
    joint = "chassis_joint" if name == "diffbot_sim" else "base_joint"
    at = line_of(files, "description", f'"{joint}"')
    assert found(files) == [
        f"ros2_controllers.yaml:{line}: warning: {base}: {new.strip()} has two parents: odom by odometry, "
        f"and {root} by the fixed joint {joint} ({files.description.name}:{at}); "
        f"remove that joint and its parent, or set base_frame_id: {root}"
    ]


@pytest.mark.parametrize("name", ["robby", "diffbot_sim"])
def test_an_odometry_frame_that_is_a_link_already_and_a_base_that_is_none(name, tmp_path):
    files = changed(tmp_path / "1", name, controllers={"odom_frame_id: odom": "odom_frame_id: caster"})
    line, links = line_of(files, "controllers", "odom_frame_id"), files.description.name
    assert found(files) == [
        f"ros2_controllers.yaml:{line}: warning: {BASES[name][0]}: odom_frame_id 'caster' is already a link of "
        f"{links}; call it odom"
    ]
    right = "base_footprint" if name == "robby" else "base_link"
    files = changed(tmp_path / "2", name, controllers={f"base_frame_id: {right}": f"base_frame_id: {right[:-1]}"})
    line = line_of(files, "controllers", "base_frame_id")
    assert found(files) == [
        f"ros2_controllers.yaml:{line}: warning: {BASES[name][0]}: base_frame_id '{right[:-1]}' is not a link of "
        f"{links} (did you mean '{right}'?); use a link's name"
    ]


SIZES = {"robby": ("0.24 ", "0.035 "), "diffbot_sim": ("0.36 ", "0.1 ")}


@pytest.mark.parametrize("name", SIZES)
@pytest.mark.parametrize(("which", "key"), [(0, "wheel_separation"), (1, "wheel_radius")])
def test_a_wheel_size_that_is_not_the_descriptions(name, which, key, tmp_path):
    value = SIZES[name][which]
    files = changed(tmp_path, name, controllers={f"{key}: {value}": f"{key}: 0.16 "})
    line = line_of(files, "controllers", f"{key}: 0.16")
    assert found(files) == [
        f"ros2_controllers.yaml:{line}: warning: {BASES[name][0]}: {key} is 0.16 m, the description's wheels have "
        f"{value.strip()} m; measure the robot and correct the one that is wrong"
    ]


@pytest.mark.parametrize(
    ("name", "key", "value"),
    [
        ("forklift", "traction_wheels_radius", "0.15"),
        ("forklift", "traction_track_width", "0.9"),
        ("mecanum", "kinematics.wheels_radius", "0.08"),
    ],
)
def test_the_sizes_of_every_base_are_held_against_the_description(name, key, value, tmp_path):
    files = changed(tmp_path, name, controllers={f"{key}: {value} ": f"{key}: 0.5 "})
    line = line_of(files, "controllers", f"{key}: 0.5")
    assert found(files) == [
        f"ros2_controllers.yaml:{line}: warning: {name}_base_controller: {key} is 0.5 m, the description's wheels have "
        f"{value} m; measure the robot and correct the one that is wrong"
    ]


def test_a_mecanum_base_whose_jerk_limit_freezes_it_has_no_switch_for_that(tmp_path):
    place = "    linear.y.max_velocity"
    files = changed(tmp_path, "mecanum", controllers={place: f"    linear.y.max_jerk: 0.0\n{place}"})
    (text,) = found(files)
    assert text.endswith("linear.y.max_jerk: 0 prevents any motion: the robot can neither start nor brake; remove it")


@pytest.mark.parametrize("name", SIZES)
def test_a_wheel_size_that_is_missing(name, tmp_path):
    value = SIZES[name][1]
    files = changed(tmp_path, name, controllers={f"wheel_radius: {value}": f"# {value}"})
    (text,) = found(files)
    assert re.fullmatch(
        rf"ros2_controllers\.yaml:\d+: warning: {BASES[name][0]}: wheel_radius is missing, which ROS 2 refuses; "
        rf"here the description's {value.strip()} m is used; write wheel_radius: {value.strip()}",
        text,
    )


@pytest.mark.parametrize("key", ["wheel_radius", "wheel_separation"])
def test_a_wheel_size_of_0_is_that_of_the_description_with_a_warning(key, tmp_path):
    value = {"wheel_radius": "0.035", "wheel_separation": "0.24"}[key]
    files = changed(tmp_path, "robby", controllers={f"{key}: {value}": f"{key}: 0.0"})
    line = line_of(files, "controllers", key)
    assert found(files) == [
        f"ros2_controllers.yaml:{line}: warning: robby_base_controller: {key} is 0, which "
        f"ROS 2 refuses; here the description's {value} m is used; write {key}: {value}"
    ]


def test_a_wheel_size_that_is_unknown_is_an_error(tmp_path):
    files = changed(tmp_path, "mobile_base_ros1")
    text = re.sub(r"<(visual|collision)>.*?</\1>", "", files.description.read_text(), flags=re.DOTALL)
    files.description.write_text(text)
    (reported,) = found(files)
    assert re.fullmatch(
        r"ros2_controllers\.yaml:\d+: error: mobile_base_controller: wheel_radius is missing or 0; give it in m",
        reported,
    )


SCALES = {
    "robby": ("left_drive", 3, "right_drive", 2),
    "mobile_base_ros1": ("left_wheel_motor", 2, "right_wheel_motor", 3),
}
SCALES["diffbot_sim"] = ("left_drive", 2, "right_drive", 3)


@pytest.mark.parametrize("name", SCALES)
def test_scales_of_the_same_sign_on_both_sides(name, tmp_path):
    files = changed(tmp_path, name)
    files.bus.write_text(re.sub(r"(scale_\w+: )-", r"\1", files.bus.read_text()))
    left, left_id, right, right_id = SCALES[name]
    (text,) = found(files)
    line = line_of(files, "bus", f"{left}:")
    assert text in (
        f"bus.yml:{at}: warning: nodes {left_id} ({left}) and {right_id} ({right}) drive wheels of both sides with "
        "scales of the same sign; motors that face each other then turn the robot on the spot; "
        f"if they do, make the scales of {left} negative"
        for at in (line, line + 1)
    )


def test_wheels_on_the_wrong_side_and_axes_the_wrong_way_round(tmp_path):
    swapped = {"left_wheel_names: [left_wheel_joint]": "left_wheel_names: [right_wheel_joint]"}
    swapped["right_wheel_names: [right_wheel_joint]"] = "right_wheel_names: [left_wheel_joint]"
    files = changed(tmp_path / "1", "robby", controllers=swapped)
    line = line_of(files, "controllers", "left_wheel_names")
    assert found(files) == [
        f"ros2_controllers.yaml:{line}: warning: robby_base_controller: the left wheels are on the right side of the "
        "robot (-0.12 m and 0.12 m along y); swap left and right wheel names"
    ]
    files = changed(tmp_path / "2", "robby", description={'<axis xyz="0 1 0"/>': '<axis xyz="0 -1 0"/>'})
    texts = found(files)
    assert [re.sub(r":\d+:", ":N:", text) for text in texts] == [
        f"robby.urdf.xacro:N: warning: joint {side}_wheel_joint: its axis points to the right, so a positive velocity "
        "drives backwards; reverse its <axis>"
        for side in ("left", "right")
    ]
    files = changed(tmp_path / "3", "robby", description={'<axis xyz="0 1 0"/>': ""})  # the axis is then x (URDF)
    assert [re.sub(r":\d+:", ":N:", text) for text in found(files)] == [
        f"robby.urdf.xacro:N: warning: joint {side}_wheel_joint: its axis points forward, so that the wheel cannot "
        'roll forward; write <axis xyz="0 1 0"/>'
        for side in ("left", "right")
    ]


def test_a_misspelt_state_interface_is_reported_with_its_name(tmp_path):
    files = changed(
        tmp_path, "robby", description={'<state_interface name="velocity"/>': '<state_interface name="velocty"/>'}
    )
    assert [re.sub(r":\d+:", ":N:", text) for text in found(files)] == [
        f"robby.urdf.xacro:N: warning: joint {side}_wheel_joint has no state interface 'velocty' "
        "(did you mean 'velocity'?); correct its name"
        for side in ("left", "right")
    ]
    files = changed(
        tmp_path / "2", "robby", description={'<state_interface name="velocity"/>': '<state_interface name="heat"/>'}
    )
    assert found(files) == []


def test_scales_of_the_same_sign_are_found_for_joints_that_name_a_node_id(tmp_path):
    files = changed(tmp_path, "robby")
    files.bus.write_text(re.sub(r"(scale_\w+: )-", r"\1", files.bus.read_text()))
    (named,) = found(files)
    ids = '<param name="node_id">${3 if side == "left" else 2}</param>'
    text = files.description.read_text()
    files.description.write_text(text.replace('<param name="device_name">${side}_drive</param>', ids))
    assert found(files) == [named]


def test_a_deceleration_with_which_a_stop_takes_long_is_a_warning_with_its_line(tmp_path):
    place = "    linear.x.max_acceleration: 1.0"
    files = changed(tmp_path, "robby", controllers={place: "    linear.x.max_acceleration: 0.01"})
    line = line_of(files, "controllers", "linear.x.max_acceleration")
    (text,) = [item for item in found(files) if "s to stop" in item]
    assert f"ros2_controllers.yaml:{line}: warning: robby_base_controller: linear.x needs " in text
    assert text.endswith("raise the magnitude of linear.x.max_deceleration_reverse")


def test_an_infinite_velocity_limit_is_none(tmp_path):
    place = "    linear.x.max_velocity: 1.0"
    files = changed(tmp_path, "robby", controllers={place: "    linear.x.max_velocity: .inf"})
    assert found(files) == []


def test_a_controller_faster_than_the_manager_is_a_warning_with_its_line(tmp_path):
    place = "    open_loop: false"
    files = changed(tmp_path, "robby", controllers={place: f"    update_rate: 100\n{place}"})
    line = line_of(files, "controllers", "update_rate: 100")
    (text,) = found(files)
    assert f"ros2_controllers.yaml:{line}: warning: robby_base_controller: update_rate 100 Hz is above" in text


def test_an_error_without_a_line_names_its_own_file(tmp_path):
    files = changed(tmp_path, "robby")
    text = files.controllers.read_text()
    files.controllers.write_text(text[: text.index("    robby_forward_controller")])
    (finding,) = (item for item in check_robot(files, CheckOptions()).findings if item.severity is Severity.ERROR)
    assert (finding.path, finding.text[:26]) == (str(files.controllers), "it has only broadcasters, ")
