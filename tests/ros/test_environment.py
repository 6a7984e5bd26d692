from __future__ import annotations

import xml.etree.ElementTree as ET

import pytest

from canopen_control.ros.environment import PROFILE, describe, prepare

RANGE, PROFILES = "ROS_AUTOMATIC_DISCOVERY_RANGE", "FASTRTPS_DEFAULT_PROFILES_FILE"


def prepared(wheels=True, **given):
    environment = dict(given)
    prepare(environment, wheels=wheels, prefix="/venv")
    return environment


def test_nothing_set_means_this_host_only():
    assert prepared() == {"AMENT_PREFIX_PATH": "/venv", RANGE: "LOCALHOST", PROFILES: str(PROFILE)}


def test_a_sourced_ros_keeps_its_own_prefix_path():
    assert "AMENT_PREFIX_PATH" not in prepared(wheels=False)
    assert prepared(AMENT_PREFIX_PATH="/opt/ros/jazzy")["AMENT_PREFIX_PATH"] == "/opt/ros/jazzy"


def test_a_wider_range_is_the_users_choice_and_gets_no_loopback_profile():
    assert prepared(**{RANGE: "SUBNET"}) == {"AMENT_PREFIX_PATH": "/venv", RANGE: "SUBNET"}


def test_the_older_variable_for_the_local_host_is_obeyed():
    environment = prepared(ROS_LOCALHOST_ONLY="1")
    assert RANGE not in environment
    assert environment[PROFILES] == str(PROFILE)


@pytest.mark.parametrize(
    "variable", [PROFILES, "FASTDDS_DEFAULT_PROFILES_FILE", "ROS_DISCOVERY_SERVER", "ROS_STATIC_PEERS"]
)
def test_who_steers_discovery_himself_keeps_his_way(variable):
    assert prepared(**{variable: "mine"}).get(PROFILES) == ("mine" if variable == PROFILES else None)


def test_another_middleware_needs_no_profile_of_fast_dds():
    assert PROFILES not in prepared(wheels=False, RMW_IMPLEMENTATION="rmw_cyclonedds_cpp")


def test_the_profile_binds_to_the_loopback_address_alone():
    root = ET.parse(PROFILE).getroot()
    space = {"d": "http://www.eprosima.com"}
    assert [each.text for each in root.findall(".//d:interfaceWhiteList/d:address", space)] == ["127.0.0.1"]
    assert root.find(".//d:useBuiltinTransports", space).text == "false"
    described = {each.text for each in root.findall(".//d:transport_descriptor/d:transport_id", space)}
    assert {each.text for each in root.findall(".//d:userTransports/d:transport_id", space)} == described


@pytest.mark.parametrize(
    ("environment", "words"),
    [
        ({RANGE: "LOCALHOST"}, "ROS domain 0, this host only"),
        ({RANGE: "SUBNET", "ROS_DOMAIN_ID": "7"}, "ROS domain 7, discovery range SUBNET"),
        ({"ROS_LOCALHOST_ONLY": "1"}, "ROS domain 0, this host only"),
        ({}, "ROS domain 0, discovery range SUBNET"),
    ],
)
def test_who_can_see_the_robot_is_told(environment, words):
    assert describe(environment) == words
