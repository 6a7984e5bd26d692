"""The jog of a pre-flight on virtual drives that are as they should be, and on some that are not; in virtual time."""

import contextlib

import pytest
from support.lockstep import lockstep
from support.onbus import GENERIC, TMCM, OnBus
from support.robots import copy_robby

from canopen_control.cli.preflight import Jog, jog_interfaces
from canopen_control.runtime.robot_files import find_robot
from canopen_control.runtime.setup import read_robot


@contextlib.contextmanager
def drives_on(channel, devices):
    with lockstep(), OnBus(channel, devices) as drives:
        yield drives


def results(found):
    return [(step.name, step.passed) for step in found]


def test_the_jog_measures_velocity_way_and_stop(private_folders):
    setup = read_robot(find_robot("robby"), can=["memory:jogged"])
    assert jog_interfaces(setup) == {"left_wheel_joint": "velocity", "right_wheel_joint": "velocity"}
    with drives_on("memory:jogged", dict.fromkeys((3, 2), TMCM)), Jog(setup, 0.5) as jog:
        found = [*map(jog.turn, jog.joints), jog.stop()]
    assert results(found) == [("jog", True), ("jog", True), ("STOP", True)], found
    assert jog.turned == ["left_wheel_joint", "right_wheel_joint"]


@pytest.mark.parametrize(
    ("edits", "words"),
    [
        ({"scale_vel_to_dev: -254.64790894703253": "scale_vel_to_dev: 254.64790894703253"}, "turns the other way"),
        (
            {"scale_vel_to_dev: -254.64790894703253": "scale_vel_to_dev: -2546.4790894703253"},
            "rad/s at a command of 0.5",
        ),
        ({"scale_pos_from_dev: -0.003926990816987242": "scale_pos_from_dev: -0.03926990816987242"}, "rad in"),
    ],
    ids=["sign", "velocity scale", "position scale"],
)
def test_a_wrong_scale_is_found_before_it_hurts(private_folders, tmp_path, edits, words):
    setup = read_robot(find_robot(str(copy_robby(tmp_path, bus=edits))), can=["memory:scales"])
    with drives_on("memory:scales", dict.fromkeys((3, 2), TMCM)), Jog(setup, 0.5) as jog:
        step = jog.turn("left_wheel_joint")
    assert (step.passed, jog.turned) == (False, [])
    assert words in step.text


def test_a_joint_that_has_a_position_only_is_led_by_it_and_back_for_stop(private_folders):
    setup = read_robot(find_robot("arm6"), can=["memory:jogged-arm"])
    assert set(jog_interfaces(setup).values()) == {"position"}
    with drives_on("memory:jogged-arm", dict.fromkeys(range(2, 8), GENERIC)) as drives, Jog(setup, 0.5) as jog:
        assert jog.no_room("joint_1") is None
        step = jog.turn("joint_1")
        assert step.passed, step
        way = drives.call(lambda: drives.nodes[2].get(0x6064)) / 1043037.8350470454
        assert 0.5 < way < 1.0, "forward"
        stop = jog.stop()
        assert stop.passed, stop
        assert drives.call(lambda: drives.nodes[2].get(0x6064)) / 1043037.8350470454 < way, "and back"
        others = [drives.call(lambda node=node: drives.nodes[node].get(0x6064)) for node in range(3, 8)]
    assert (others, jog.turned) == ([0] * 5, ["joint_1"])


def test_a_joint_without_room_before_its_limit_is_said_and_not_turned(private_folders):
    setup = read_robot(find_robot("arm6"), can=["memory:narrow-arm"])
    with drives_on("memory:narrow-arm", dict.fromkeys(range(2, 8), GENERIC)), Jog(setup, 1.0) as jog:
        assert jog.no_room("joint_2") is None, "2 rad are enough for two seconds"
        jog.speed = 1.2
        assert jog.no_room("joint_2") == ("it is at 0.000, 2.000 before its limit, and a jog at 1.2 rad/s needs 2.400")
