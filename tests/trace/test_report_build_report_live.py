"""Observation of a running robot: mock hardware here, a bus in the integration tests."""

import pytest
from support.mockrobot import running

from canopen_control.errors import ConfigError
from canopen_control.trace.report_build import watch


def test_samples_and_events_of_the_time_are_there():
    with running("watched"):
        file = watch("watched", 0.3)
    assert len(file.states) >= 5
    assert file.meta.robot == "watched"
    assert file.meta.status.boot == []
    assert any(event.kind == "running" for event in file.events)
    assert file.frames == []


def test_a_robot_that_ends_ends_the_watch():
    import threading

    with running("ending") as robot:
        timer = threading.Timer(0.2, robot.shutdown)
        timer.start()
        file = watch("ending", 60.0)
        timer.join()
    assert any(event.kind == "stopped" for event in file.events)


def test_without_a_robot_it_reports_this():
    with pytest.raises(ConfigError, match="no robot"):
        watch(None, 1.0)
