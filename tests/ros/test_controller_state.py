"""The publisher that `~/controller_state` of every controller shares; nothing is sent."""

from __future__ import annotations

import pytest

pytest.importorskip("std_msgs")

from support.endpoints import Ros, interface

from canopen_control.ros import controller_state
from canopen_control.ros.controller_state import ControllerStateTopic
from canopen_control.ros.qos import SYSTEM_DEFAULT
from canopen_control.rpc.messages.samples import DiagnosticsSample, PidSample
from canopen_control.rpc.messages.state import ControllerReading, StateSample

pytestmark = pytest.mark.ros


class Filled(ControllerStateTopic[PidSample]):
    def __init__(self, ros):
        loop = ControllerReading(name="loop", type="pid_controller/PidController", state="active")
        super().__init__(ros, loop, PidSample, "control_msgs/msg/MultiDOFStateStamped")
        self.filled = []

    def fill(self, message, sample):
        self.filled.append(sample.time)


def sample(time, name="loop"):
    return StateSample(samples={name: PidSample(time=time, dofs=[])})


@pytest.fixture
def ros(monkeypatch):
    monkeypatch.setattr(controller_state, "interface", interface)
    return Ros()


def test_each_sample_is_told_once_with_its_time(ros):
    state = Filled(ros)
    (publisher,) = ros.publishers
    assert (publisher.kind.__name__, publisher.topic) == ("MultiDOFStateStamped", "loop/controller_state")
    assert publisher.quality is SYSTEM_DEFAULT
    for time in (2.5, 2.5, 3.25):
        state.on_state(sample(time))
    assert [(each.header.stamp.sec, each.header.stamp.nanosec) for each in publisher.told] == [
        (2, 500_000_000),
        (3, 250_000_000),
    ]
    state.close()
    assert ros.left == [publisher]


def test_nothing_is_made_where_nobody_listens(ros):
    state = Filled(ros)
    ros.publishers[0].subscribers = 0
    state.on_state(sample(1.0))
    assert (state.filled, ros.publishers[0].told) == ([], [])


def test_samples_of_other_controllers_and_of_another_kind_are_not_its(ros):
    state = Filled(ros)
    state.on_state(sample(1.0, "other"))
    state.on_state(StateSample(samples={"loop": DiagnosticsSample(time=1.0, joints=[])}))
    assert ros.publishers[0].told == []
