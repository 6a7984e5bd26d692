"""The arm that is measured: its files at another rate, and trajectories that rest at both ends."""

import pytest
from canopen_control_bench.arm import CONTROLLER, ENDS, JOINTS, POSITIONS, arm_at, edit, planned

from canopen_control.errors import CanopenError
from canopen_control.runtime.check import CheckOptions, check_robot
from canopen_control.runtime.check_data import Severity
from canopen_control.runtime.robot_files import find_robot
from canopen_control.runtime.setup import read_robot


@pytest.mark.parametrize(("trajectories", "controller"), [(True, CONTROLLER), (False, POSITIONS)])
def test_its_period_interpolation_and_controllers_are_of_one_rate(tmp_path, trajectories, controller):
    config = arm_at(tmp_path, 250, "\n  sync_order: first", trajectories=trajectories)
    files = find_robot(str(config))
    setup = read_robot(files, can=["memory:arm"])
    assert (setup.cycle_ns, setup.update_rate, setup.bus.master.sync_order) == (4_000_000, 250, "first")
    assert controller in setup.controllers.controllers
    assert not [each for each in check_robot(files, CheckOptions()).findings if each.severity is not Severity.NOTE]


def test_what_is_not_there_cannot_be_replaced(tmp_path):
    path = tmp_path / "bus.yml"
    path.write_text("sync_period: 1000\n")
    edit(path, {"1000": "2000"})
    with pytest.raises(CanopenError, match="no 'sync_period: 1000'"):
        edit(path, {"sync_period: 1000": ""})
    assert path.read_text() == "sync_period: 2000\n"


def test_a_plan_begins_and_ends_at_rest():
    plan = planned([0.0] * 6, ENDS, 2.0, 11)
    first, last = plan.points[0], plan.points[-1]
    assert plan.joint_names == JOINTS
    assert (first.positions, last.positions, last.time) == ([0.0] * 6, ENDS, 2_000_000_000)
    for end in (first, last):
        assert end.velocities == end.accelerations == [0.0] * 6
