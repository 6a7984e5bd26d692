"""Findings of `check` as lines and as data."""

import pytest

from canopen_control.check.finding import CheckedRobot, Finding, sorted_findings
from canopen_control.controllers.controllers_file import read_controllers
from canopen_control.od.issues import Severity
from canopen_control.runtime.robot_files import find_robot
from canopen_control.urdf.description import read_description


def test_a_finding_is_reported_with_its_place_its_weight_and_its_fix():
    assert str(Finding("bus.yml", 7, Severity.WARNING, "it is late", "start earlier")) == (
        "bus.yml:7: warning: it is late; start earlier"
    )
    assert str(Finding("bus.yml", 0, Severity.ERROR, "it is empty")) == "bus.yml: error: it is empty"
    placed = Finding("bus.yml", 7, Severity.NOTE, "odd", column=3, source="    a: b\n      ^")
    assert str(placed) == "bus.yml:7:3: note: odd\n    a: b\n      ^"


def test_findings_come_by_file_and_line_the_worst_first_and_each_once():
    note, error = Finding("a", 2, Severity.NOTE, "n"), Finding("a", 2, Severity.ERROR, "e")
    first, other = Finding("a", 1, Severity.NOTE, "n"), Finding("b", 1, Severity.ERROR, "e")
    assert sorted_findings([other, note, error, first, note]) == [first, error, note, other]


def test_wheels_and_controllers_are_those_of_the_files():
    files = find_robot("robby")
    robot = CheckedRobot(files, None, read_controllers(files.controllers), read_description(files.description))
    left, right = ["left_wheel_joint"], ["right_wheel_joint"]
    assert robot.geometry.radius(left + right) == pytest.approx(0.035)
    assert robot.geometry.separation(left, right) == pytest.approx(0.24)
    assert robot.config("robby_forward_controller").type == "forward_command_controller/ForwardCommandController"


def test_numbers_in_texts_are_sorted_as_numbers():
    texts = [f"RPDO {number} is in use" for number in (10, 2, 1)]
    found = sorted_findings([Finding("a", 1, Severity.NOTE, text) for text in texts])
    assert [finding.text for finding in found] == texts[::-1]
