from __future__ import annotations

import pytest

from canopen_control.controllers.base_params import BaseParams
from canopen_control.controllers.mobile_base import OdometryPublication
from canopen_control.controllers.planar_pose import PlanarPose

MS = 1_000_000


@pytest.mark.parametrize(("rate", "every"), [(0.0, 1), (100.0, 1), (50.0, 2), (10.0, 10)])
def test_it_is_due_at_its_rate_from_the_first_cycle_on(rate, every):
    told = OdometryPublication(2)
    told.set_rate(rate)
    due = [step for step in range(1, 101) if told.is_due(step * 10 * MS + step)]
    assert due[0] == 1
    assert len(due) == pytest.approx(100 / every, abs=1)
    assert told.count == len(due)


def test_after_a_pause_there_is_no_burst():
    told = OdometryPublication(2)
    told.set_rate(100.0)
    assert [told.is_due(at * MS) for at in (0, 1000, 1001, 1002, 1011)] == [True, True, True, False, True]


def test_it_stays_what_it_was_until_the_next_one():
    told, pose = OdometryPublication(2), PlanarPose()
    assert told.sample(1.0, BaseParams(), limited=False) is None
    told.is_due(1)
    pose.set_pose(1.0, 2.0, 3.0)
    told.take(pose, (0.1, 0.2, 0.3), [0.4, 0.5])
    pose.set_pose(9.0, 9.0, 9.0)
    sample = told.sample(1.0, BaseParams(odom_frame_id="map"), limited=True)
    assert (sample.x, sample.y, sample.heading, sample.frame_id) == (1.0, 2.0, 3.0, "map")
    assert (sample.linear, sample.lateral, sample.angular, sample.limited) == (0.1, 0.2, 0.3, (0.4, 0.5))
