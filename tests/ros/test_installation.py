from __future__ import annotations

import importlib.machinery
import importlib.metadata
import importlib.util
import xml.etree.ElementTree as ET

import pytest

from canopen_control.errors import ConfigError
from canopen_control.ros import installation
from canopen_control.ros.installation import PROFILE, describe, prepare


def pretend(monkeypatch, folder, *, wheels=False):
    """Let rclpy be what is in `folder`; None is nowhere."""
    spec = None
    if folder is not None:
        spec = importlib.machinery.ModuleSpec("rclpy", None, is_package=True)
        spec.submodule_search_locations = [str(folder)]
    monkeypatch.setattr(importlib.util, "find_spec", lambda name: spec)

    class Wheel:
        def locate_file(self, name):
            return folder.parent / name

    def distribution(name):
        if not wheels:
            raise importlib.metadata.PackageNotFoundError(name)
        return Wheel()

    monkeypatch.setattr(importlib.metadata, "distribution", distribution)


@pytest.fixture
def rclpy(tmp_path):
    folder = tmp_path / "rclpy"
    folder.mkdir()
    (folder / f"_rclpy_pybind11{importlib.machinery.EXTENSION_SUFFIXES[0]}").touch()
    return folder


def test_without_rclpy_one_sentence_suggests_how_to_get_it(monkeypatch):
    pretend(monkeypatch, None)
    with pytest.raises(ConfigError, match=r"this Python has no rclpy; pip install \"canopen-control\[ros\]\""):
        installation.require_ros({})


def test_an_rclpy_of_another_python_is_reported_by_its_folder(monkeypatch, tmp_path):
    folder = tmp_path / "rclpy"
    folder.mkdir()
    (folder / "_rclpy_pybind11.cpython-27-vax.so").touch()
    pretend(monkeypatch, folder)
    with pytest.raises(ConfigError, match=f"the rclpy in {folder} was built for another Python"):
        installation.require_ros({})


def test_a_foreign_middleware_is_refused_before_rclpy_ends_the_process(monkeypatch, rclpy):
    pretend(monkeypatch, rclpy, wheels=True)
    with pytest.raises(ConfigError, match=r"RMW_IMPLEMENTATION is rmw_cyclonedds_cpp, .* unset it"):
        installation.require_ros({"RMW_IMPLEMENTATION": "rmw_cyclonedds_cpp"})


def test_a_sourced_ros_may_have_any_middleware(monkeypatch, rclpy):
    pretend(monkeypatch, rclpy, wheels=False)
    installation.require_ros({"RMW_IMPLEMENTATION": "rmw_cyclonedds_cpp"})
    assert not installation.from_wheels()


def test_wheels_alongside_a_sourced_ros_do_not_count_when_the_sourced_one_is_found_first(monkeypatch, rclpy, tmp_path):
    pretend(monkeypatch, rclpy, wheels=True)
    assert installation.from_wheels()
    monkeypatch.setattr(
        importlib.metadata.distribution("ros-rclpy").__class__,
        "locate_file",
        lambda self, name: tmp_path / "site" / name,
    )
    assert not installation.from_wheels()


@pytest.mark.ros
def test_the_installed_rclpy_is_found_without_importing_it(monkeypatch):
    import sys

    monkeypatch.delitem(sys.modules, "rclpy", raising=False)  # of another test in this process
    installation.require_ros({})
    assert "rclpy" not in sys.modules


RANGE, PROFILES = "ROS_AUTOMATIC_DISCOVERY_RANGE", "FASTRTPS_DEFAULT_PROFILES_FILE"


def prepared(wheels=True, **inputs):
    environment = dict(inputs)
    prepare(environment, wheels=wheels, prefix="/venv")
    return environment


def test_nothing_set_means_this_host_only():
    assert prepared() == {"AMENT_PREFIX_PATH": "/venv", RANGE: "LOCALHOST", PROFILES: str(PROFILE)}


def test_a_sourced_ros_keeps_its_own_prefix_path():
    assert "AMENT_PREFIX_PATH" not in prepared(wheels=False)
    assert prepared(AMENT_PREFIX_PATH="/opt/ros/jazzy")["AMENT_PREFIX_PATH"] == "/opt/ros/jazzy"


def test_a_wider_range_is_the_users_choice_and_gets_no_loopback_profile():
    assert prepared(**{RANGE: "SUBNET"}) == {"AMENT_PREFIX_PATH": "/venv", RANGE: "SUBNET"}


@pytest.mark.parametrize(
    "variable", [PROFILES, "FASTDDS_DEFAULT_PROFILES_FILE", "ROS_DISCOVERY_SERVER", "ROS_STATIC_PEERS"]
)
def test_a_user_defined_discovery_range_is_kept(variable):
    assert prepared(**{variable: "mine"}).get(PROFILES) == ("mine" if variable == PROFILES else None)


def test_another_middleware_needs_no_profile_of_fast_dds():
    assert PROFILES not in prepared(wheels=False, RMW_IMPLEMENTATION="rmw_cyclonedds_cpp")


def test_the_profile_binds_to_the_loopback_address_alone():
    root = ET.parse(PROFILE).getroot()
    space = {"d": "http://www.eprosima.com"}
    assert [item.text for item in root.findall(".//d:interfaceWhiteList/d:address", space)] == ["127.0.0.1"]
    assert root.find(".//d:useBuiltinTransports", space).text == "false"
    described = {item.text for item in root.findall(".//d:transport_descriptor/d:transport_id", space)}
    assert {item.text for item in root.findall(".//d:userTransports/d:transport_id", space)} == described


@pytest.mark.parametrize(
    ("environment", "words"),
    [
        ({RANGE: "LOCALHOST"}, "ROS domain 0, this host only"),
        ({RANGE: "SUBNET", "ROS_DOMAIN_ID": "7"}, "ROS domain 7, discovery range SUBNET"),
        ({"ROS_LOCALHOST_ONLY": "1"}, "ROS domain 0, this host only"),
        ({}, "ROS domain 0, discovery range SUBNET"),
    ],
)
def test_the_discovery_range_of_the_robot_is_reported(environment, words):
    assert describe(environment) == words
