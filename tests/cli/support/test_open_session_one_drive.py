from types import SimpleNamespace

import pytest
from support.onbus import GENERIC

from canopen_control.cli.support.jog_robot import choose_jog
from canopen_control.cli.support.open_session import WarningPrinter, axis_of, with_counts
from canopen_control.cli.support.target import find_eds
from canopen_control.errors import ConfigError
from canopen_control.master.event_log import Event, Level
from canopen_control.od.eds import read_eds
from canopen_control.scaffold.new_robot import Device


@pytest.fixture
def robot(private_folders):
    device = Device(5, find_eds(GENERIC), read_eds(find_eds(GENERIC), 5).od)
    return choose_jog(device, "velocity", allow_unsupervised=False)


def test_an_axis_that_is_not_there_is_reported(robot):
    assert axis_of(robot, SimpleNamespace(axis=0, node="5")).number == 0
    with pytest.raises(ConfigError, match="node 5 has no axis 1; it has 1, counted from 0"):
        axis_of(robot, SimpleNamespace(axis=1, node="5"))


def test_counts_that_a_user_reports_are_those_of_joints_and_drives(robot):
    reported = with_counts(robot, 1600.0)
    assert {joint.axis.counts for joint in reported.joints} == {1600.0}
    assert {item.counts for item in reported.nodes[0].drive.axes} == {1600.0}
    assert with_counts(robot, None) is robot


def test_warnings_are_reported_and_the_rest_is_not(capsys):
    WarningPrinter().event(Event(0, "x", "", "all is well", Level.INFO))
    WarningPrinter().event(Event(0, "x", "", "something is wrong", Level.WARNING))
    assert capsys.readouterr().err.strip().endswith("something is wrong")
