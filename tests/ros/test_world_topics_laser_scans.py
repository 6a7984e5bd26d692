from __future__ import annotations

import itertools
from types import SimpleNamespace

import pytest

from canopen_control.ros.world_topics import LaserScans
from canopen_control.rpc.messages.simulation import LaserScanReading
from canopen_control.rpc.messages.state import StateSample

pytestmark = pytest.mark.ros
SCAN = LaserScanReading(
    name="lidar",
    topic="/front/scan",
    frame_id="laser",
    seconds=2.25,
    angle_min=-1.5,
    angle_max=1.5,
    angle_increment=1.5,
    range_min=0.5,
    range_max=8.0,
    scan_time=0.2,
    ranges=[-1.0, 2.5, 3.0],
)


class Asked:
    """What an endpoint is given, of which it makes nothing but publishers; `asked` are the times of questions."""

    def __init__(self, *scans):
        self.scans, self.asked, self.now, self.published = scans, [], 0.0, []
        publisher = SimpleNamespace(publish=self.published.append)
        self.node = SimpleNamespace(create_publisher=lambda *_: publisher, destroy_publisher=lambda _: None)
        self.endpoint = LaserScans(self)

    def frame(self, name):
        return name

    def ask(self, _request, answer):
        self.asked.append(self.now)
        answer(self.scans, None)

    def run(self, seconds, *, unix=0.0):
        for cycle in range(1, round(seconds / 0.02) + 1):
            self.now = round(cycle * 0.02, 2)
            self.endpoint.on_state(StateSample(time=self.now + unix, sim_time=self.now, sim_epoch=1.0))


def test_a_lidar_is_asked_at_its_rate_in_simulated_time():
    ros = Asked(SCAN)
    ros.run(1.0)
    assert ros.asked == [0.02, 0.2, 0.4, 0.6, 0.8, 1.0]
    for _ in range(100):  # paused
        ros.endpoint.on_state(StateSample(time=1.0, sim_time=1.0, sim_epoch=1.0))
    assert len(ros.asked) == 6


def test_a_robot_without_a_lidar_is_asked_once_and_a_real_one_never():
    ros = Asked()
    ros.run(2.0)
    assert ros.asked == [0.02]
    real = Asked(SCAN)
    real.endpoint.on_state(StateSample(time=1.0))
    assert real.asked == []


@pytest.mark.parametrize(("unix", "stamp"), [(0.0, 2.25), (1000.0, 1002.25)])
def test_the_message_has_the_time_of_its_scan_on_the_clock_of_the_bridge(unix, stamp):
    ros = Asked(SCAN)
    ros.run(0.02, unix=unix)
    (message,) = ros.published
    assert message.header.stamp.sec + message.header.stamp.nanosec / 1e9 == pytest.approx(stamp)
    assert (message.header.frame_id, list(message.ranges)) == ("laser", [-1.0, 2.5, 3.0])
    assert (message.range_max, message.angle_increment) == (8.0, 1.5)
    ros.endpoint.close()


def test_another_program_hears_it(fresh):
    fresh.robot.answers["laser_scans"] = [{field: getattr(SCAN, field) for field in SCAN.__struct_fields__}]
    fresh.peer.order("subscribe", topic="/front/scan", of="sensor_msgs/msg/LaserScan", qos="default")
    periods = itertools.count(1)

    def tell():
        fresh.robot.more = {"sim_time": next(periods) * SCAN.scan_time, "sim_epoch": fresh.robot.time}

    assert fresh.peer.hears("/front/scan", tell)["ranges"] == [-1.0, 2.5, 3.0]
